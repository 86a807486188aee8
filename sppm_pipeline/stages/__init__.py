"""The built-in stages; they register through the hook that plugins use, by name, so that none is imported early."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sppm_pipeline.hookspecs import hookimpl

if TYPE_CHECKING:
    from sppm_pipeline.stage import StageAlias

__all__ = ["BUILT_IN", "STAGE_ALIASES", "sppm_stage_aliases", "sppm_stages"]

BUILT_IN = {
    "read.mesh": "ReadMesh",
    "read.primitive": "ReadPrimitive",
    "read.voxels": "ReadVoxels",
    "read.volume_mesh": "ReadVolumeMesh",
    "sample.mirrored_faces": "MirroredFaces",
    "sample.dart_throwing": "DartThrowing",
    "sample.elimination": "Elimination",
    "connect.mst": "MinimumSpanningTree",
    "connect.mbdst": "BoundedDegreeSubgraph",
    "field.gaussian": "GaussianField",
    "tune.porosity": "TunePorosity",
    "tune.stiffness": "TuneStiffness",
    "tune.retry": "Retry",
    "tileset.wang_3color": "WangTileSet",
    "tileset.free_faces": "FreeFacesTileSet",
    "tileset.corner_colors": "CornerColorsTileSet",
    "tile.periodic": "PeriodicTiling",
    "tile.wang_3color": "WangTiling",
    "tile.free_faces": "FreeFacesTiling",
    "tile.corner_colors": "CornerColorsTiling",
    "tile.fresh": "FreshTiling",
    "fill.implicit": "ImplicitFill",
    "fill.boolean": "BooleanFill",
    "fill.combine": "Combine",
    "extract.marching_cubes": "MarchingCubes",
    "extract.voxels": "ExtractVoxels",
    "mesh.isosurface_stuffing": "IsosurfaceStuffing",
    "mesh.boundary": "Boundary",
    "homogenize.realizations": "HomogenizeRealizations",
    "homogenize.tet": "HomogenizeTet",
    "extract.unit_cell": "UnitCell",
    "extract.manifold_sdf": "ManifoldSdf",
    "check.connectivity": "CheckConnectivity",
    "check.mesh": "CheckMesh",
    "check.porosity": "CheckPorosity",
    "check.sizes": "CheckSizes",
    "check.residual_periodicity": "CheckResidualPeriodicity",
    "check.tiling": "CheckTiling",
    "check.volume_mesh": "CheckVolumeMesh",
    "homogenize.voxel": "HomogenizeVoxel",
    "homogenize.conductivity": "HomogenizeConductivity",
    "slice.field": "SliceField",
    "slice.mesh": "SliceMesh",
    "write.png": "WritePng",
    "write.stl": "WriteStl",
    "write.ply": "WritePly",
    "write.obj": "WriteObj",
    "write.npy": "WriteNpy",
    "write.tiff": "WriteTiff",
    "write.vti": "WriteVti",
    "write.stiffness": "WriteStiffness",
    "write.vtu": "WriteVtu",
    "write.inp": "WriteInp",
    "write.msh": "WriteMsh",
    "write.off": "WriteOff",
    "write.3mf": "WriteThreeMf",
    "write.glb": "WriteGlb",
    "write.graph": "WriteGraph",
    "write.picture": "WritePicture",
    "write.chart": "WriteChart",
    "write.bars": "WriteBars",
    "write.sheet": "WriteSheet",
    "write.table": "WriteTable",
}
"""Stage name -> class name; the file follows from the name."""

STAGE_ALIASES: dict[str, str | StageAlias] = {
    "homogenize.realisations": "homogenize.realizations",
}
"""Former stage name -> current name, or a `StageAlias` with the options that the former name implied."""


@hookimpl
def sppm_stages() -> dict[str, str]:
    """All built-in stages, by the place of their class."""
    return {name: f"sppm_pipeline.stages.{name}:{cls}" for name, cls in BUILT_IN.items()}


@hookimpl
def sppm_stage_aliases() -> dict[str, str | StageAlias]:
    """Former names of built-in stages."""
    return STAGE_ALIASES
