"""The method of the paper: pores, tunnels, kernels, tiles, parts, layers; in the order of its folders."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from sppm_pipeline.hookspecs import Comparison, Preset, hookimpl

STAGES = {
    "read.primitive": "ReadPrimitive",
    "sample.mirrored_faces": "MirroredFaces",
    "sample.dart_throwing": "DartThrowing",
    "sample.elimination": "Elimination",
    "sample.hyperuniform": "Hyperuniform",
    "connect.mst": "MinimumSpanningTree",
    "connect.mbdst": "BoundedDegreeSubgraph",
    "connect.relative_neighbors": "RelativeNeighbors",
    "field.gaussian": "GaussianField",
    "tune.porosity": "TunePorosity",
    "tune.property": "TuneProperty",
    "tune.retry": "Retry",
    "tileset.wang_3color": "WangTileSet",
    "tileset.free_faces": "FreeFacesTileSet",
    "tileset.corner_colors": "CornerColorsTileSet",
    "tile.periodic": "PeriodicTiling",
    "tile.wang_3color": "WangTiling",
    "tile.free_faces": "FreeFacesTiling",
    "tile.corner_colors": "CornerColorsTiling",
    "tile.fresh": "FreshTiling",
    "tile.scattered": "ScatteredTiling",
    "fill.implicit": "ImplicitFill",
    "extract.voxels": "ExtractVoxels",
    "extract.phases": "ExtractPhases",
    "check.connectivity": "CheckConnectivity",
    "check.porosity": "CheckPorosity",
    "check.residual_periodicity": "CheckResidualPeriodicity",
    "check.tiling": "CheckTiling",
    "slice.field": "SliceField",
    "slice.mesh": "SliceMesh",
    "write.png": "WritePng",
    "write.graph": "WriteGraph",
}
"""Stage name -> class; the module is `stages`, with an underscore for the dot."""


@hookimpl
def sppm_stages() -> dict[str, str]:
    """The stages of this feature."""
    return {name: f"{__name__}.stages.{name.replace('.', '_')}:{cls}" for name, cls in STAGES.items()}


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
