"""The nouns: what passes between stages, what these are made of, and what hooks hand over.

A public sub-face of the package: names here stay, and are loaded when they are first used. What the engine
knows itself (artifacts, lengths, palettes, reports, sizes, tables) are modules of this package.
"""

from __future__ import annotations

from sppm_pipeline import lazily

__all__, __getattr__, __dir__ = lazily(__name__, __file__)
