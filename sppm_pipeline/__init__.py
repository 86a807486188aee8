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

    from sppm_pipeline.api.functions import (
        StageFunction,
        check,
        connect,
        extract,
        field,
        fill,
        homogenize,
        mesh,
        read,
        sample,
        slice,
        step,
        tile,
        tileset,
        tune,
        write,
    )
    from sppm_pipeline.api.pipeline import Pipeline, Run, load, run
    from sppm_pipeline.data.artifact import Artifact, frozen
    from sppm_pipeline.data.conductivity import ConductivityReport
    from sppm_pipeline.data.length import Cell, Length
    from sppm_pipeline.data.mesh import RepeatedMesh, SurfaceMesh
    from sppm_pipeline.data.palette import Palette
    from sppm_pipeline.data.pores import PoreSet
    from sppm_pipeline.data.stiffness import StiffnessReport
    from sppm_pipeline.data.table import Table
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
        ResourceError,
        SppmError,
        WiringError,
    )
    from sppm_pipeline.families import (
        Connector,
        InteriorBox,
        Lattice,
        MeshWriter,
        Piece,
        Sampler,
        Tiler,
        TileSetMaker,
        VoxelHomogenizer,
        lattice_for,
    )
    from sppm_pipeline.fields.microstructure import Microstructure
    from sppm_pipeline.fields.part import Part
    from sppm_pipeline.fields.scalar_field import ScalarField
    from sppm_pipeline.fields.slice_stack import SliceStack
    from sppm_pipeline.fields.tileset import TileSet
    from sppm_pipeline.fields.tiling import Tiling
    from sppm_pipeline.fields.wrapped import WrappedField
    from sppm_pipeline.hookspecs import hookimpl
    from sppm_pipeline.numerics.compiled import inline_jit, jit
    from sppm_pipeline.numerics.grid import Grid, cell_centers, cell_nodes
    from sppm_pipeline.process import ArraySpec, NativeResult, run_native
    from sppm_pipeline.stage import Context, Recipe, Rejected, Stage, option

_PLACES = {
    "api.functions": "StageFunction check connect extract field fill homogenize mesh read sample slice step tile "
    "tileset tune write",
    "api.pipeline": "Pipeline Run load run",
    "data.artifact": "Artifact frozen",
    "data.conductivity": "ConductivityReport",
    "data.length": "Cell Length",
    "data.mesh": "RepeatedMesh SurfaceMesh",
    "data.palette": "Palette",
    "data.pores": "PoreSet",
    "data.stiffness": "StiffnessReport",
    "data.table": "Table",
    "data.tunnels": "TunnelGraph",
    "data.volume_mesh": "VolumeMesh",
    "data.voxels": "Voxels",
    "errors": "ConfigError ConfigErrors DesignError InputError NativeCrash PluginError ResourceError SppmError "
    "WiringError",
    "families": "Connector InteriorBox Lattice MeshWriter Piece Sampler TileSetMaker Tiler VoxelHomogenizer "
    "lattice_for",
    "fields.microstructure": "Microstructure",
    "fields.part": "Part",
    "fields.scalar_field": "ScalarField",
    "fields.slice_stack": "SliceStack",
    "fields.tileset": "TileSet",
    "fields.tiling": "Tiling",
    "fields.wrapped": "WrappedField",
    "hookspecs": "hookimpl",
    "numerics.compiled": "inline_jit jit",
    "numerics.grid": "Grid cell_centers cell_nodes",
    "process": "ArraySpec NativeResult run_native",
    "stage": "Context Recipe Rejected Stage option",
}
"""Modules below this package, and what the public face takes from each."""

_MODULE_OF = {name: module for module, names in _PLACES.items() for name in names.split()}

__all__ = [
    "ArraySpec",
    "Artifact",
    "Cell",
    "ConductivityReport",
    "ConfigError",
    "ConfigErrors",
    "Connector",
    "Context",
    "DesignError",
    "Grid",
    "InputError",
    "InteriorBox",
    "Lattice",
    "Length",
    "MeshWriter",
    "Microstructure",
    "NativeCrash",
    "NativeResult",
    "Palette",
    "Part",
    "Piece",
    "Pipeline",
    "PluginError",
    "PoreSet",
    "Recipe",
    "Rejected",
    "RepeatedMesh",
    "ResourceError",
    "Run",
    "Sampler",
    "ScalarField",
    "SliceStack",
    "SppmError",
    "Stage",
    "StageFunction",
    "StiffnessReport",
    "SurfaceMesh",
    "Table",
    "TileSet",
    "TileSetMaker",
    "Tiler",
    "Tiling",
    "TunnelGraph",
    "VolumeMesh",
    "VoxelHomogenizer",
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
    "homogenize",
    "hookimpl",
    "inline_jit",
    "jit",
    "lattice_for",
    "load",
    "mesh",
    "option",
    "read",
    "run",
    "run_native",
    "sample",
    "slice",
    "step",
    "tile",
    "tileset",
    "tune",
    "write",
]


def __getattr__(name: str) -> Any:
    """Load a public name when it is first used."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    value = globals()[name] = getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
    return value


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__", "testing"])
