"""Design, verify, simulate and print stochastic porous microstructures.

The public face: everything that third-party stages, scripts and notebooks use is here, and in `sppm_pipeline.testing`.
Names are loaded when they are first used, so that the import costs next to nothing.

Run a configuration, or call its stages as functions::

    import sppm_pipeline as sppm

    run = sppm.run("cell.yaml", params={"porosity": 0.6}, seed=3)
    run["field.gaussian"], run.numbers["tune.porosity.porosity"]

    pores = sppm.sample.dart_throwing(total=66, share=0.55, seed=1)
    graph = sppm.connect.mbdst(pores, seed=1)
    cell = sppm.field.gaussian(pore_radius=0.13, tunnel_radius=0.04)(graph)
    cell.sample(64), sppm.homogenize.voxel(resolution=64)(cell).C

Write a stage::

    @dataclass(frozen=True, kw_only=True)
    class Shrink(sppm.Stage):
        '''Make a mesh smaller.'''

        name: ClassVar[str] = "mesh.shrink"
        factor: float = sppm.option(0.99, help="what lengths are multiplied by", above=0, maximum=1)

        def run(self, context: sppm.Context, mesh: sppm.SurfaceMesh) -> sppm.SurfaceMesh:
            return sppm.SurfaceMesh(self.factor * mesh.vertices, mesh.faces)
"""

from __future__ import annotations

__version__ = "0.1.0"

TYPE_CHECKING = False  # as type checkers understand it; importing `typing` would take longer than all else here
if TYPE_CHECKING:  # the same names as in `_PLACES`, which a test compares
    from typing import Any

    from sppm_pipeline.api.bound_stage import SppmWarning
    from sppm_pipeline.api.functions import (
        StageFunction,
        check,
        connect,
        extract,
        field,
        fill,
        grade,
        homogenize,
        measure,
        mesh,
        read,
        sample,
        slice,
        step,
        tile,
        tileset,
        tune,
        warp,
        write,
    )
    from sppm_pipeline.api.pipeline import Pipeline, load, run
    from sppm_pipeline.api.run import Run
    from sppm_pipeline.data.acoustics import AcousticReport
    from sppm_pipeline.data.artifact import Artifact, frozen
    from sppm_pipeline.data.compression import CompressionCurve, CrushedBody
    from sppm_pipeline.data.conductivity import ConductivityReport
    from sppm_pipeline.data.grading import CellFrame, Grading, Law, Place
    from sppm_pipeline.data.length import Cell, Length
    from sppm_pipeline.data.mesh import RepeatedMesh, SurfaceMesh
    from sppm_pipeline.data.palette import Blocks, KeptPores, Palette
    from sppm_pipeline.data.permeability import PermeabilityReport
    from sppm_pipeline.data.pores import PoreSet
    from sppm_pipeline.data.printer import Motion, Printer
    from sppm_pipeline.data.size import CellDesign, Geometry, RecipeSize, Size
    from sppm_pipeline.data.stiffness import StiffnessReport
    from sppm_pipeline.data.table import RunFile, Table
    from sppm_pipeline.data.tunnels import TunnelGraph
    from sppm_pipeline.data.volume_mesh import VolumeMesh
    from sppm_pipeline.data.voxels import Voxels
    from sppm_pipeline.errors import (
        ConfigError,
        ConfigErrors,
        DesignError,
        InputError,
        NativeCrash,
        PluginError,
        Position,
        ResourceError,
        SppmError,
        WiringError,
    )
    from sppm_pipeline.families import (
        Cloud,
        Connector,
        FieldMaker,
        Grader,
        Homogenizer,
        InteriorBox,
        Interiors,
        Lattice,
        LayerWriter,
        MeshWriter,
        PartFieldMaker,
        Piece,
        Sampler,
        Tiler,
        TileSetMaker,
        lattice_for,
        options,
    )
    from sppm_pipeline.families.homogenizer import VoxelCell
    from sppm_pipeline.families.layer_writer import EncodedLayers, LayerObserver
    from sppm_pipeline.fields.formula import CellCache, CellIndex, CellwiseField, FormulaField, PlacedField
    from sppm_pipeline.fields.microstructure import Microstructure, PeriodicTile
    from sppm_pipeline.fields.part import Part
    from sppm_pipeline.fields.scalar_field import ScalarField
    from sppm_pipeline.fields.slice_stack import Slab, Slabs, SliceStack
    from sppm_pipeline.fields.tileset import TileSet
    from sppm_pipeline.fields.tiling import Tiling
    from sppm_pipeline.fields.wrapped import WrappedField
    from sppm_pipeline.hookspecs import Command, Preset, StageEvent, hookimpl
    from sppm_pipeline.numerics.assembly.contents import PieceNumbers, Pieces, TilingArrays
    from sppm_pipeline.numerics.assembly.gather import Catalog, make_catalog, sample_exact
    from sppm_pipeline.numerics.compiled import inline_jit, jit
    from sppm_pipeline.numerics.flow.acoustics import PoreParameters
    from sppm_pipeline.numerics.grid import Grid, cell_centers, cell_nodes
    from sppm_pipeline.numerics.homogenization.multigrid.solver import Solved
    from sppm_pipeline.numerics.homogenization.stiffness.bounds import Bounds, Interval
    from sppm_pipeline.numerics.kernels.kernels import Kernels
    from sppm_pipeline.numerics.kernels.profiles import TUNNEL_PROFILES, omega_from_radius
    from sppm_pipeline.numerics.meshcheck.measures import EdgeCounts, SurfaceMeasures
    from sppm_pipeline.numerics.meshcheck.measures import components as mesh_components
    from sppm_pipeline.numerics.meshcheck.measures import edge_counts as mesh_edges
    from sppm_pipeline.numerics.meshcheck.measures import measure_surface as mesh_measures
    from sppm_pipeline.numerics.meshcheck.measures import surface_area as mesh_area
    from sppm_pipeline.numerics.meshcheck.measures import volume as mesh_volume
    from sppm_pipeline.numerics.sampling.capacity import largest_spacing
    from sppm_pipeline.numerics.sampling.darts import throw as throw_darts
    from sppm_pipeline.numerics.sampling.many import Surrounding
    from sppm_pipeline.numerics.sampling.spacing import min_spacing as smallest_spacing
    from sppm_pipeline.numerics.tiling.corners import tile_corners
    from sppm_pipeline.numerics.tiling.hashed import tile_hashed
    from sppm_pipeline.numerics.tiling.lattice import Laid, hash_places
    from sppm_pipeline.process import ArraySpec, NativeResult, notify, run_native
    from sppm_pipeline.process.interruption import Stop
    from sppm_pipeline.process.interruption import requested as stop_requested
    from sppm_pipeline.stage import Context, Headline, Observed, Recipe, Rejected, Stage, StageAlias, option

_PLACES = {
    "api.bound_stage": "SppmWarning",
    "api.functions": "StageFunction check connect extract field fill grade homogenize measure mesh read sample "
    "slice step tile tileset tune warp write",
    "api.pipeline": "Pipeline load run",
    "api.run": "Run",
    "data.acoustics": "AcousticReport",
    "data.artifact": "Artifact frozen",
    "data.compression": "CompressionCurve CrushedBody",
    "data.conductivity": "ConductivityReport",
    "data.grading": "CellFrame Grading Law Place",
    "data.length": "Cell Length",
    "data.mesh": "RepeatedMesh SurfaceMesh",
    "data.palette": "Blocks KeptPores Palette",
    "data.permeability": "PermeabilityReport",
    "data.pores": "PoreSet",
    "data.printer": "Motion Printer",
    "data.size": "CellDesign Geometry RecipeSize Size",
    "data.stiffness": "StiffnessReport",
    "data.table": "RunFile Table",
    "data.tunnels": "TunnelGraph",
    "data.volume_mesh": "VolumeMesh",
    "data.voxels": "Voxels",
    "errors": "ConfigError ConfigErrors DesignError InputError NativeCrash PluginError Position ResourceError "
    "SppmError WiringError",
    "families": "Cloud Connector FieldMaker Grader Homogenizer InteriorBox Interiors Lattice LayerWriter MeshWriter "
    "PartFieldMaker Piece Sampler TileSetMaker Tiler lattice_for options",
    "families.homogenizer": "VoxelCell",
    "families.layer_writer": "EncodedLayers LayerObserver",
    "fields.formula": "CellCache CellIndex CellwiseField FormulaField PlacedField",
    "fields.microstructure": "Microstructure PeriodicTile",
    "fields.part": "Part",
    "fields.scalar_field": "ScalarField",
    "fields.slice_stack": "Slab Slabs SliceStack",
    "fields.tileset": "TileSet",
    "fields.tiling": "Tiling",
    "fields.wrapped": "WrappedField",
    "hookspecs": "Command Preset StageEvent hookimpl",
    "numerics.assembly.contents": "PieceNumbers Pieces TilingArrays",
    "numerics.assembly.gather": "Catalog make_catalog sample_exact",
    "numerics.compiled": "inline_jit jit",
    "numerics.flow.acoustics": "PoreParameters",
    "numerics.grid": "Grid cell_centers cell_nodes",
    "numerics.homogenization.multigrid.solver": "Solved",
    "numerics.homogenization.stiffness.bounds": "Bounds Interval",
    "numerics.kernels.kernels": "Kernels",
    "numerics.kernels.profiles": "TUNNEL_PROFILES omega_from_radius",
    "numerics.meshcheck.measures": "EdgeCounts SurfaceMeasures mesh_area=surface_area mesh_components=components "
    "mesh_edges=edge_counts mesh_measures=measure_surface mesh_volume=volume",
    "numerics.sampling.capacity": "largest_spacing",
    "numerics.sampling.darts": "throw_darts=throw",
    "numerics.sampling.many": "Surrounding",
    "numerics.sampling.spacing": "smallest_spacing=min_spacing",
    "numerics.tiling.corners": "tile_corners",
    "numerics.tiling.hashed": "tile_hashed",
    "numerics.tiling.lattice": "Laid hash_places",
    "process": "ArraySpec NativeResult notify run_native",
    "process.interruption": "Stop stop_requested=requested",
    "stage": "Context Headline Observed Recipe Rejected Stage StageAlias option",
}
"""Modules below this package, and what the public face takes from each: ``name``, or ``public name=name there``."""

_PLACE_OF = {
    public: (module, name or public)
    for module, names in _PLACES.items()
    for public, _, name in (entry.partition("=") for entry in names.split())
}

__all__ = [
    "TUNNEL_PROFILES",
    "AcousticReport",
    "ArraySpec",
    "Artifact",
    "Blocks",
    "Bounds",
    "Catalog",
    "Cell",
    "CellCache",
    "CellDesign",
    "CellFrame",
    "CellIndex",
    "CellwiseField",
    "Cloud",
    "Command",
    "CompressionCurve",
    "ConductivityReport",
    "ConfigError",
    "ConfigErrors",
    "Connector",
    "Context",
    "CrushedBody",
    "DesignError",
    "EdgeCounts",
    "EncodedLayers",
    "FieldMaker",
    "FormulaField",
    "Geometry",
    "Grader",
    "Grading",
    "Grid",
    "Headline",
    "Homogenizer",
    "InputError",
    "InteriorBox",
    "Interiors",
    "Interval",
    "KeptPores",
    "Kernels",
    "Laid",
    "Lattice",
    "Law",
    "LayerObserver",
    "LayerWriter",
    "Length",
    "MeshWriter",
    "Microstructure",
    "Motion",
    "NativeCrash",
    "NativeResult",
    "Observed",
    "Palette",
    "Part",
    "PartFieldMaker",
    "PeriodicTile",
    "PermeabilityReport",
    "Piece",
    "PieceNumbers",
    "Pieces",
    "Pipeline",
    "Place",
    "PlacedField",
    "PluginError",
    "PoreParameters",
    "PoreSet",
    "Position",
    "Preset",
    "Printer",
    "Recipe",
    "RecipeSize",
    "Rejected",
    "RepeatedMesh",
    "ResourceError",
    "Run",
    "RunFile",
    "Sampler",
    "ScalarField",
    "Size",
    "Slab",
    "Slabs",
    "SliceStack",
    "Solved",
    "SppmError",
    "SppmWarning",
    "Stage",
    "StageAlias",
    "StageEvent",
    "StageFunction",
    "StiffnessReport",
    "Stop",
    "SurfaceMeasures",
    "SurfaceMesh",
    "Surrounding",
    "Table",
    "TileSet",
    "TileSetMaker",
    "Tiler",
    "Tiling",
    "TilingArrays",
    "TunnelGraph",
    "VolumeMesh",
    "VoxelCell",
    "Voxels",
    "WiringError",
    "WrappedField",
    "cell_centers",
    "cell_nodes",
    "check",
    "connect",
    "extract",
    "field",
    "fill",
    "frozen",
    "grade",
    "hash_places",
    "homogenize",
    "hookimpl",
    "inline_jit",
    "jit",
    "largest_spacing",
    "lattice_for",
    "load",
    "make_catalog",
    "measure",
    "mesh",
    "mesh_area",
    "mesh_components",
    "mesh_edges",
    "mesh_measures",
    "mesh_volume",
    "notify",
    "omega_from_radius",
    "option",
    "options",
    "read",
    "run",
    "run_native",
    "sample",
    "sample_exact",
    "slice",
    "smallest_spacing",
    "step",
    "stop_requested",
    "throw_darts",
    "tile",
    "tile_corners",
    "tile_hashed",
    "tileset",
    "tune",
    "warp",
    "write",
]


def __getattr__(name: str) -> Any:
    """Load a public name when it is first used."""
    if name not in _PLACE_OF:
        message = f"module {__name__!r} has no attribute {name!r}"
        if not name.startswith("_"):
            from difflib import get_close_matches

            if near := get_close_matches(name, __all__, 1):
                message += f"; did you mean {near[0]!r}?"
        raise AttributeError(message)
    from importlib import import_module

    module, there = _PLACE_OF[name]
    value = globals()[name] = getattr(import_module(f"{__name__}.{module}"), there)
    return value


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__", "testing"])
