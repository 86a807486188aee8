"""Crushing: blocks of voxels compressed to large strains, and compression tests read, measured and compared.

What its stages pass on, `CompressionCurve` and `CrushedBody`, is loaded when it is first used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sppm_pipeline.nouns import stages_in

if TYPE_CHECKING:
    from sppm_crushing.compression import CompressionCurve, CrushedBody

__all__ = ["CompressionCurve", "CrushedBody", "sppm_stages"]

SPPM_API_VERSION = 1  # a program where `sppm_pipeline.API` is another number refuses this plugin

sppm_stages = stages_in(__name__)


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from sppm_crushing import compression

    return getattr(compression, name)
