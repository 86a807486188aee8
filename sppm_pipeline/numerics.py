"""Numerics to borrow: arrays in, arrays out; grids, compiled kernels, components, meshes, and the multigrid for voxels.

A public sub-face of `sppm_pipeline`: names here stay, and are loaded when they are first used.
"""

from __future__ import annotations

from sppm_pipeline import lazily

__all__, __getattr__, __dir__ = lazily(__name__, __file__)
