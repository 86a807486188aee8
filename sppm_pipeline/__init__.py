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

    from sppm_pipeline.engine.api.bound_stage import SppmWarning
    from sppm_pipeline.engine.api.functions import (
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
    from sppm_pipeline.engine.api.pipeline import Pipeline, load, run
    from sppm_pipeline.engine.api.run import Run
    from sppm_pipeline.engine.process import ArraySpec, NativeResult, notify, run_native
    from sppm_pipeline.engine.process.interruption import Stop
    from sppm_pipeline.engine.process.interruption import requested as stop_requested
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
    from sppm_pipeline.features.crushing.compression import CompressionCurve, CrushedBody
    from sppm_pipeline.features.flow.acoustics import AcousticReport
    from sppm_pipeline.features.flow.conductivity import ConductivityReport
    from sppm_pipeline.features.flow.numerics.acoustics import PoreParameters
    from sppm_pipeline.features.flow.permeability import PermeabilityReport
    from sppm_pipeline.features.grading.grader import Grader
    from sppm_pipeline.features.grading.grading import CellFrame, Grading, Law, Place
    from sppm_pipeline.features.tetrahedra.volume_mesh import VolumeMesh
    from sppm_pipeline.hookspecs import Command, Preset, StageEvent, hookimpl
    from sppm_pipeline.method.assembly.contents import PieceNumbers, Pieces, TilingArrays
    from sppm_pipeline.method.assembly.gather import Catalog, make_catalog, sample_exact
    from sppm_pipeline.method.families import options
    from sppm_pipeline.method.families.cloud import Cloud, Piece
    from sppm_pipeline.method.families.connector import Connector
    from sppm_pipeline.method.families.field_maker import FieldMaker, PartFieldMaker
    from sppm_pipeline.method.families.file_writer import MeshWriter
    from sppm_pipeline.method.families.homogenizer import Homogenizer, VoxelCell
    from sppm_pipeline.method.families.interiors import InteriorBox, Interiors
    from sppm_pipeline.method.families.layer_writer import EncodedLayers, LayerObserver, LayerWriter
    from sppm_pipeline.method.families.sampler import Sampler
    from sppm_pipeline.method.families.tiler import Lattice, Tiler, lattice_for
    from sppm_pipeline.method.families.tileset_maker import TileSetMaker
    from sppm_pipeline.method.fields.formula import CellCache, CellIndex, CellwiseField, FormulaField, PlacedField
    from sppm_pipeline.method.fields.microstructure import Microstructure, PeriodicTile
    from sppm_pipeline.method.fields.scalar_field import ScalarField, WrappedField
    from sppm_pipeline.method.fields.tileset import TileSet
    from sppm_pipeline.method.fields.tiling import Tiling
    from sppm_pipeline.method.kernels.kernels import Kernels
    from sppm_pipeline.method.kernels.profiles import TUNNEL_PROFILES, omega_from_radius
    from sppm_pipeline.method.nouns.mesh import RepeatedMesh, SurfaceMesh
    from sppm_pipeline.method.nouns.pores import PoreSet
    from sppm_pipeline.method.nouns.printer import Motion, Printer
    from sppm_pipeline.method.nouns.stiffness import StiffnessReport
    from sppm_pipeline.method.nouns.tunnels import TunnelGraph
    from sppm_pipeline.method.nouns.voxels import Voxels
    from sppm_pipeline.method.part.part import Part
    from sppm_pipeline.method.sampling.capacity import largest_spacing
    from sppm_pipeline.method.sampling.darts import throw as throw_darts
    from sppm_pipeline.method.sampling.many import Surrounding
    from sppm_pipeline.method.sampling.spacing import min_spacing as smallest_spacing
    from sppm_pipeline.method.slicing.slice_stack import Slab, Slabs, SliceStack
    from sppm_pipeline.method.tiling.corners import tile_corners
    from sppm_pipeline.method.tiling.hashed import tile_hashed
    from sppm_pipeline.method.tiling.lattice import Laid, hash_places
    from sppm_pipeline.nouns.artifact import Artifact, Surface, Viewable, frozen
    from sppm_pipeline.nouns.length import Cell, Length
    from sppm_pipeline.nouns.palette import Blocks, KeptPores, Palette
    from sppm_pipeline.nouns.report import Box, Chart, Curve, Number, Report, ReportSection, number, reports
    from sppm_pipeline.nouns.size import CellDesign, Geometry, RecipeSize, Size
    from sppm_pipeline.nouns.table import RunFile, Table
    from sppm_pipeline.nouns.viewers import Viewer
    from sppm_pipeline.services.elastic.bounds import Bounds, Interval
    from sppm_pipeline.services.grid import Grid, cell_centers, cell_nodes
    from sppm_pipeline.services.jit.compiled import inline_jit, jit
    from sppm_pipeline.services.mesh.measures import EdgeCounts, SurfaceMeasures
    from sppm_pipeline.services.mesh.measures import components as mesh_components
    from sppm_pipeline.services.mesh.measures import edge_counts as mesh_edges
    from sppm_pipeline.services.mesh.measures import measure_surface as mesh_measures
    from sppm_pipeline.services.mesh.measures import surface_area as mesh_area
    from sppm_pipeline.services.mesh.measures import volume as mesh_volume
    from sppm_pipeline.services.multigrid.solver import Solved
    from sppm_pipeline.stage import Context, Headline, Observed, Recipe, Rejected, Stage, StageAlias, option

_PLACES = {
    "engine.api.bound_stage": "SppmWarning",
    "engine.api.functions": "StageFunction check connect extract field fill grade homogenize measure mesh read "
    "sample slice step tile tileset tune warp write",
    "engine.api.pipeline": "Pipeline load run",
    "engine.api.run": "Run",
    "engine.process": "ArraySpec NativeResult notify run_native",
    "engine.process.interruption": "Stop stop_requested=requested",
    "errors": "ConfigError ConfigErrors DesignError InputError NativeCrash PluginError Position ResourceError "
    "SppmError WiringError",
    "features.crushing.compression": "CompressionCurve CrushedBody",
    "features.flow.acoustics": "AcousticReport",
    "features.flow.conductivity": "ConductivityReport",
    "features.flow.numerics.acoustics": "PoreParameters",
    "features.flow.permeability": "PermeabilityReport",
    "features.grading.grader": "Grader",
    "features.grading.grading": "CellFrame Grading Law Place",
    "features.tetrahedra.volume_mesh": "VolumeMesh",
    "hookspecs": "Command Preset StageEvent hookimpl",
    "method.assembly.contents": "PieceNumbers Pieces TilingArrays",
    "method.assembly.gather": "Catalog make_catalog sample_exact",
    "method.families": "options",
    "method.families.cloud": "Cloud Piece",
    "method.families.connector": "Connector",
    "method.families.field_maker": "FieldMaker PartFieldMaker",
    "method.families.file_writer": "MeshWriter",
    "method.families.homogenizer": "Homogenizer VoxelCell",
    "method.families.interiors": "InteriorBox Interiors",
    "method.families.layer_writer": "EncodedLayers LayerObserver LayerWriter",
    "method.families.sampler": "Sampler",
    "method.families.tiler": "Lattice Tiler lattice_for",
    "method.families.tileset_maker": "TileSetMaker",
    "method.fields.formula": "CellCache CellIndex CellwiseField FormulaField PlacedField",
    "method.fields.microstructure": "Microstructure PeriodicTile",
    "method.fields.scalar_field": "ScalarField WrappedField",
    "method.fields.tileset": "TileSet",
    "method.fields.tiling": "Tiling",
    "method.kernels.kernels": "Kernels",
    "method.kernels.profiles": "TUNNEL_PROFILES omega_from_radius",
    "method.nouns.mesh": "RepeatedMesh SurfaceMesh",
    "method.nouns.pores": "PoreSet",
    "method.nouns.printer": "Motion Printer",
    "method.nouns.stiffness": "StiffnessReport",
    "method.nouns.tunnels": "TunnelGraph",
    "method.nouns.voxels": "Voxels",
    "method.part.part": "Part",
    "method.sampling.capacity": "largest_spacing",
    "method.sampling.darts": "throw_darts=throw",
    "method.sampling.many": "Surrounding",
    "method.sampling.spacing": "smallest_spacing=min_spacing",
    "method.slicing.slice_stack": "Slab Slabs SliceStack",
    "method.tiling.corners": "tile_corners",
    "method.tiling.hashed": "tile_hashed",
    "method.tiling.lattice": "Laid hash_places",
    "nouns.artifact": "Artifact Surface Viewable frozen",
    "nouns.length": "Cell Length",
    "nouns.palette": "Blocks KeptPores Palette",
    "nouns.report": "Box Chart Curve Number Report ReportSection number reports",
    "nouns.size": "CellDesign Geometry RecipeSize Size",
    "nouns.table": "RunFile Table",
    "nouns.viewers": "Viewer",
    "services.elastic.bounds": "Bounds Interval",
    "services.grid": "Grid cell_centers cell_nodes",
    "services.jit.compiled": "inline_jit jit",
    "services.mesh.measures": "EdgeCounts SurfaceMeasures mesh_area=surface_area mesh_components=components "
    "mesh_edges=edge_counts mesh_measures=measure_surface mesh_volume=volume",
    "services.multigrid.solver": "Solved",
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
    "Box",
    "Catalog",
    "Cell",
    "CellCache",
    "CellDesign",
    "CellFrame",
    "CellIndex",
    "CellwiseField",
    "Chart",
    "Cloud",
    "Command",
    "CompressionCurve",
    "ConductivityReport",
    "ConfigError",
    "ConfigErrors",
    "Connector",
    "Context",
    "CrushedBody",
    "Curve",
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
    "Number",
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
    "Report",
    "ReportSection",
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
    "Surface",
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
    "Viewable",
    "Viewer",
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
    "number",
    "omega_from_radius",
    "option",
    "options",
    "read",
    "reports",
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
    found = import_module(f"{__name__}.{module}")
    if not hasattr(found, there):  # a module of a package
        import_module(f"{__name__}.{module}.{there}")
    value = globals()[name] = getattr(found, there)
    return value


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__", "testing"])
