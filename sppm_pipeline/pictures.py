"""Pictures and charts for reports, notebooks and files: renderers, sheets, and the style of charts.

A public sub-face of `sppm_pipeline`: names here stay, and are loaded when they are first used.
"""

from __future__ import annotations

from sppm_pipeline import lazily

__all__, __getattr__, __dir__ = lazily(__name__, __file__)
