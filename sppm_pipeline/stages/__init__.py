"""The built-in stages; they register through the hook that plugins use, by name, so that none is imported early."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sppm_pipeline.hookspecs import hookimpl

if TYPE_CHECKING:
    from collections.abc import Mapping

    from sppm_pipeline.hookspecs import Preset
    from sppm_pipeline.stage import StageAlias

__all__ = ["BUILT_IN", "STAGE_ALIASES", "sppm_presets", "sppm_stage_aliases", "sppm_stages"]

BUILT_IN = {
    "read.mesh": "ReadMesh",
    "read.primitive": "ReadPrimitive",
    "read.voxels": "ReadVoxels",
    "read.volume_mesh": "ReadVolumeMesh",
    "read.hexahedra": "ReadHexahedra",
    "grade.formula": "GradeFormula",
    "grade.table": "GradeTable",
    "grade.image": "GradeImage",
    "grade.points": "GradePoints",
    "grade.nodes": "GradeNodes",
    "grade.distance": "GradeDistance",
    "grade.stiffness": "GradeStiffness",
    "read.compression": "ReadCompression",
    "sample.mirrored_faces": "MirroredFaces",
    "sample.dart_throwing": "DartThrowing",
    "sample.elimination": "Elimination",
    "sample.hyperuniform": "Hyperuniform",
    "connect.mst": "MinimumSpanningTree",
    "connect.mbdst": "BoundedDegreeSubgraph",
    "connect.relative_neighbors": "RelativeNeighbors",
    "field.gaussian": "GaussianField",
    "field.walls": "WallsField",
    "field.blend": "BlendFields",
    "tune.porosity": "TunePorosity",
    "tune.property": "TuneProperty",
    "tune.stiffness": "TuneStiffness",
    "tune.plateau": "TunePlateau",
    "tune.local_porosity": "TuneLocalPorosity",
    "tune.retry": "Retry",
    "tune.orientation": "TuneOrientation",
    "tileset.wang_3color": "WangTileSet",
    "tileset.free_faces": "FreeFacesTileSet",
    "tileset.corner_colors": "CornerColorsTileSet",
    "tileset.join": "JoinTileSets",
    "tile.periodic": "PeriodicTiling",
    "tile.wang_3color": "WangTiling",
    "tile.free_faces": "FreeFacesTiling",
    "tile.corner_colors": "CornerColorsTiling",
    "tile.fresh": "FreshTiling",
    "tile.graded": "GradedTiling",
    "tile.scattered": "ScatteredTiling",
    "tile.joined": "JoinedTiling",
    "tile.hexahedra": "HexahedralTiling",
    "warp.cylinder": "WarpCylinder",
    "warp.sphere": "WarpSphere",
    "warp.hexahedra": "WarpHexahedra",
    "fill.implicit": "ImplicitFill",
    "fill.boolean": "BooleanFill",
    "fill.combine": "Combine",
    "fix.drains": "FixDrains",
    "fix.fill": "FixFill",
    "extract.marching_cubes": "MarchingCubes",
    "extract.voxels": "ExtractVoxels",
    "extract.phases": "ExtractPhases",
    "mesh.isosurface_stuffing": "IsosurfaceStuffing",
    "mesh.boundary": "Boundary",
    "homogenize.realizations": "HomogenizeRealizations",
    "homogenize.tet": "HomogenizeTet",
    "extract.unit_cell": "UnitCell",
    "extract.manifold_sdf": "ManifoldSdf",
    "check.connectivity": "CheckConnectivity",
    "check.mesh": "CheckMesh",
    "check.local_porosity": "CheckLocalPorosity",
    "check.porosity": "CheckPorosity",
    "check.print": "CheckPrint",
    "check.sizes": "CheckSizes",
    "check.residual_periodicity": "CheckResidualPeriodicity",
    "check.tiling": "CheckTiling",
    "check.volume_mesh": "CheckVolumeMesh",
    "homogenize.voxel": "HomogenizeVoxel",
    "measure.compression": "MeasureCompression",
    "homogenize.conductivity": "HomogenizeConductivity",
    "crush.voxel": "CrushVoxel",
    "homogenize.permeability": "HomogenizePermeability",
    "homogenize.acoustics": "HomogenizeAcoustics",
    "slice.field": "SliceField",
    "slice.mesh": "SliceMesh",
    "slice.plate": "SlicePlate",
    "write.png": "WritePng",
    "write.sl1": "WriteSl1",
    "write.goo": "WriteGoo",
    "write.nanodlp": "WriteNanodlp",
    "write.mesh": "WriteMesh",
    "write.volume_mesh": "WriteVolumeMesh",
    "write.voxels": "WriteVoxels",
    "write.stiffness": "WriteStiffness",
    "write.flow": "WriteFlow",
    "write.absorption": "WriteAbsorption",
    "write.graph": "WriteGraph",
    "write.network": "WriteNetwork",
    "write.picture": "WritePicture",
    "write.view": "WriteView",
    "write.chart": "WriteChart",
    "write.bars": "WriteBars",
    "write.curves": "WriteCurves",
    "write.frames": "WriteFrames",
    "write.sheet": "WriteSheet",
    "write.table": "WriteTable",
}
"""Stage name -> class name; the file follows from the name."""

STAGE_ALIASES: dict[str, str] = {
    "homogenize.realisations": "homogenize.realizations",
    "write.stl": "write.mesh",
    "write.ply": "write.mesh",
    "write.obj": "write.mesh",
    "write.off": "write.mesh",
    "write.3mf": "write.mesh",
    "write.glb": "write.mesh",
    "write.vtu": "write.volume_mesh",
    "write.inp": "write.volume_mesh",
    "write.msh": "write.volume_mesh",
    "write.npy": "write.voxels",
    "write.tiff": "write.voxels",
    "write.vti": "write.voxels",
}
"""Former stage name -> current name."""


@hookimpl
def sppm_stages() -> dict[str, str]:
    """All built-in stages, by the place of their class."""
    return {name: f"sppm_pipeline.stages.{name}:{cls}" for name, cls in BUILT_IN.items()}


@hookimpl
def sppm_stage_aliases() -> dict[str, str | StageAlias]:
    """Former names of built-in stages; writers that were named after a format keep that format by default."""
    from sppm_pipeline.errors import ConfigError
    from sppm_pipeline.stage import StageAlias

    def alias(former: str, name: str) -> str | StageAlias:
        if not former.startswith("write."):
            return name
        suffix = f".{former.removeprefix('write.')}"
        allowed = {".tiff": (".tif", ".tiff"), ".vtu": (".vtu", ".vtk")}.get(suffix, (suffix,))
        default = f"{'voxels' if name == 'write.voxels' else 'mesh'}{suffix}"

        def implied(written: Mapping[str, Any]) -> dict[str, Any]:
            path = written.get("path", default)
            if isinstance(path, str) and not path.lower().endswith(allowed):
                raise ConfigError(
                    f"{former} writes {' or '.join(allowed)}, and `path` is {path!r}",
                    hint=f"say `stage: {name}`: the ending of the file chooses the format",
                )
            return {"path": path}

        return StageAlias(name, implied)

    return {former: alias(former, name) for former, name in STAGE_ALIASES.items()}


@hookimpl
def sppm_presets() -> dict[str, Preset]:
    """Recipes for what users ask most."""
    from sppm_pipeline.stages.presets import PRESETS

    return PRESETS
