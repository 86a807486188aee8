"""The method of the paper: pores, tunnels, kernels, tiles, parts, layers; in the order of its folders."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from sppm_pipeline.hookspecs import Comparison, Preset, hookimpl, stages_in

sppm_stages = stages_in(__name__)

GROUPS = {
    "": "paper",
    **dict.fromkeys(("read", "fill", "slice", "write", "tile.scattered", "tune.porosity"), "everyday"),
}
"""Stage or family -> where ``sppm stages`` lists it; all others are behind the empty name."""


@hookimpl
def sppm_presets() -> dict[str, Preset]:
    """Recipes for what users ask most."""
    from sppm_pipeline.method.presets import PRESETS

    return PRESETS


@hookimpl
def sppm_audit(record: Mapping[str, Any]) -> list[Comparison]:
    """Volumes, islands and porosity of a part."""
    from sppm_pipeline.method.audit import comparisons

    return list(comparisons(record))
