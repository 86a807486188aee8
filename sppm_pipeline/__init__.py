"""Design, verify, simulate and print stochastic porous microstructures.

The public face: what third-party stages, scripts and notebooks use is here, and in its sub-faces
`sppm_pipeline.nouns` (what passes between stages), `sppm_pipeline.numerics` (arrays in, arrays out),
`sppm_pipeline.pictures`, `sppm_pipeline.formats`, `sppm_pipeline.errors` and `sppm_pipeline.testing`. Names are loaded
when they are first used, so that the import costs next to nothing.

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
    from collections.abc import Callable, Mapping
    from typing import Any

    from sppm_pipeline import errors as errors
    from sppm_pipeline import formats as formats
    from sppm_pipeline import nouns as nouns
    from sppm_pipeline import numerics as numerics
    from sppm_pipeline import pictures as pictures
    from sppm_pipeline import testing as testing
    from sppm_pipeline.engine.api.functions import param as param
    from sppm_pipeline.engine.api.monitor import SppmWarning as SppmWarning
    from sppm_pipeline.engine.api.pipeline import Pipeline as Pipeline
    from sppm_pipeline.engine.api.pipeline import load as load
    from sppm_pipeline.engine.api.pipeline import run as run
    from sppm_pipeline.engine.api.registering import register as register
    from sppm_pipeline.engine.api.run import Run as Run
    from sppm_pipeline.engine.api.stages import check as check
    from sppm_pipeline.engine.api.stages import connect as connect
    from sppm_pipeline.engine.api.stages import crush as crush
    from sppm_pipeline.engine.api.stages import design as design
    from sppm_pipeline.engine.api.stages import extract as extract
    from sppm_pipeline.engine.api.stages import field as field
    from sppm_pipeline.engine.api.stages import fill as fill
    from sppm_pipeline.engine.api.stages import fix as fix
    from sppm_pipeline.engine.api.stages import grade as grade
    from sppm_pipeline.engine.api.stages import homogenize as homogenize
    from sppm_pipeline.engine.api.stages import measure as measure
    from sppm_pipeline.engine.api.stages import mesh as mesh
    from sppm_pipeline.engine.api.stages import read as read
    from sppm_pipeline.engine.api.stages import sample as sample
    from sppm_pipeline.engine.api.stages import slice as slice
    from sppm_pipeline.engine.api.stages import step as step
    from sppm_pipeline.engine.api.stages import tile as tile
    from sppm_pipeline.engine.api.stages import tileset as tileset
    from sppm_pipeline.engine.api.stages import tune as tune
    from sppm_pipeline.engine.api.stages import warp as warp
    from sppm_pipeline.engine.api.stages import write as write
    from sppm_pipeline.engine.process import notify as notify
    from sppm_pipeline.engine.process import run_native as run_native
    from sppm_pipeline.engine.process.interruption import requested as _stop_requested
    from sppm_pipeline.errors import ConfigError as ConfigError
    from sppm_pipeline.errors import DesignError as DesignError
    from sppm_pipeline.errors import InputError as InputError
    from sppm_pipeline.errors import PluginError as PluginError
    from sppm_pipeline.errors import ResourceError as ResourceError
    from sppm_pipeline.errors import SppmError as SppmError
    from sppm_pipeline.features.grading.grader import Grader as Grader
    from sppm_pipeline.features.tetrahedra.volume_mesh import VolumeMesh as VolumeMesh
    from sppm_pipeline.hookspecs import hookimpl as hookimpl
    from sppm_pipeline.method.families import options as options
    from sppm_pipeline.method.families.connector import Connector as Connector
    from sppm_pipeline.method.families.field_maker import FieldMaker as FieldMaker
    from sppm_pipeline.method.families.field_maker import PartFieldMaker as PartFieldMaker
    from sppm_pipeline.method.families.file_writer import MeshWriter as MeshWriter
    from sppm_pipeline.method.families.homogenizer import Homogenizer as Homogenizer
    from sppm_pipeline.method.families.layer_writer import LayerWriter as LayerWriter
    from sppm_pipeline.method.families.sampler import Sampler as Sampler
    from sppm_pipeline.method.families.tiler import Tiler as Tiler
    from sppm_pipeline.method.families.tileset_maker import TileSetMaker as TileSetMaker
    from sppm_pipeline.method.families.tuner import Tuner as Tuner
    from sppm_pipeline.method.fields.microstructure import Microstructure as Microstructure
    from sppm_pipeline.method.fields.scalar_field import ScalarField as ScalarField
    from sppm_pipeline.method.fields.tileset import TileSet as TileSet
    from sppm_pipeline.method.fields.tiling import Tiling as Tiling
    from sppm_pipeline.method.nouns.mesh import SurfaceMesh as SurfaceMesh
    from sppm_pipeline.method.nouns.pores import PoreSet as PoreSet
    from sppm_pipeline.method.nouns.tunnels import TunnelGraph as TunnelGraph
    from sppm_pipeline.method.nouns.voxels import Voxels as Voxels
    from sppm_pipeline.method.part.part import Part as Part
    from sppm_pipeline.method.presets import cell as cell
    from sppm_pipeline.method.slicing.slice_stack import SliceStack as SliceStack
    from sppm_pipeline.nouns.artifact import Artifact as Artifact
    from sppm_pipeline.nouns.artifact import Viewable as Viewable
    from sppm_pipeline.nouns.artifact import frozen as frozen
    from sppm_pipeline.nouns.length import Cell as Cell
    from sppm_pipeline.nouns.length import Length as Length
    from sppm_pipeline.nouns.palette import Palette as Palette
    from sppm_pipeline.nouns.report import Report as Report
    from sppm_pipeline.nouns.report import number as number
    from sppm_pipeline.nouns.report import reports as reports
    from sppm_pipeline.nouns.size import RecipeSize as RecipeSize
    from sppm_pipeline.nouns.size import Size as Size
    from sppm_pipeline.nouns.table import Table as Table
    from sppm_pipeline.stage import Context as Context
    from sppm_pipeline.stage import Headline as Headline
    from sppm_pipeline.stage import Recipe as Recipe
    from sppm_pipeline.stage import Rejected as Rejected
    from sppm_pipeline.stage import Stage as Stage
    from sppm_pipeline.stage import option as option

    stop_requested = _stop_requested
else:  # type checkers would take it for a promise of every name

    def __getattr__(name: str) -> Any:
        """Load a public name, a sub-face, or a family of stages of a plugin, when it is first used."""
        from importlib import import_module
        from importlib.util import find_spec

        if name in _SUBFACES:
            return import_module(f"{__name__}.{name}")
        try:
            return _load(name)
        except AttributeError:
            # modules are asked for here before they are looked for, and no family begins with a capital
            if not name.islower() or name.startswith("_") or find_spec(f"{__name__}.{name}"):
                raise
            functions = import_module(f"{__name__}.engine.api.functions")
            if name in functions.families():
                return functions.family_of(name)
            raise


_PLACES = {
    "engine.api.functions": "param",
    "engine.api.monitor": "SppmWarning",
    "engine.api.pipeline": "Pipeline load run",
    "engine.api.registering": "register",
    "engine.api.run": "Run",
    "engine.api.stages": "check connect crush design extract field fill fix grade homogenize measure mesh read sample "
    "slice step tile tileset tune warp write",
    "engine.process": "notify run_native",
    "engine.process.interruption": "stop_requested=requested",
    "errors": "ConfigError DesignError InputError PluginError ResourceError SppmError",
    "features.grading.grader": "Grader",
    "features.tetrahedra.volume_mesh": "VolumeMesh",
    "hookspecs": "hookimpl",
    "method.families": "options",
    "method.families.connector": "Connector",
    "method.families.field_maker": "FieldMaker PartFieldMaker",
    "method.families.file_writer": "MeshWriter",
    "method.families.homogenizer": "Homogenizer",
    "method.families.layer_writer": "LayerWriter",
    "method.families.sampler": "Sampler",
    "method.families.tiler": "Tiler",
    "method.families.tileset_maker": "TileSetMaker",
    "method.families.tuner": "Tuner",
    "method.fields.microstructure": "Microstructure",
    "method.fields.scalar_field": "ScalarField",
    "method.fields.tileset": "TileSet",
    "method.fields.tiling": "Tiling",
    "method.nouns.mesh": "SurfaceMesh",
    "method.nouns.pores": "PoreSet",
    "method.nouns.tunnels": "TunnelGraph",
    "method.nouns.voxels": "Voxels",
    "method.part.part": "Part",
    "method.presets": "cell",
    "method.slicing.slice_stack": "SliceStack",
    "nouns.artifact": "Artifact Viewable frozen",
    "nouns.length": "Cell Length",
    "nouns.palette": "Palette",
    "nouns.report": "Report number reports",
    "nouns.size": "RecipeSize Size",
    "nouns.table": "Table",
    "stage": "Context Headline Recipe Rejected Stage option",
}
"""Modules below this package, and what the public face takes from each: ``name``, or ``public name=name there``."""

_SUBFACES = ("errors", "formats", "nouns", "numerics", "pictures", "testing")


def lazily(face: str, places: Mapping[str, str]) -> tuple[list[str], Callable[[str], Any], Callable[[], list[str]]]:
    """``__all__``, ``__getattr__`` and ``__dir__`` of a module that loads its names when they are first used.

    Parameters
    ----------
    face : str
        The module.
    places : mapping of module below this package to names
        ``name``, or ``public name=name there``, separated by blanks.
    """
    place_of = {
        public: (module, there or public)
        for module, names in places.items()
        for public, _, there in (entry.partition("=") for entry in names.split())
    }

    def load(name: str) -> Any:
        import sys
        from importlib import import_module

        if name not in place_of:
            message = f"module {face!r} has no attribute {name!r}"
            if not name.startswith("_"):
                message += _hint(name, sorted(place_of))
            raise AttributeError(message)
        module, there = place_of[name]
        found = import_module(f"sppm_pipeline.{module}")
        if not hasattr(found, there):  # a module of a package
            import_module(f"sppm_pipeline.{module}.{there}")
        value = getattr(found, there)
        setattr(sys.modules[face], name, value)
        return value

    return sorted(place_of), load, lambda: sorted(place_of)


def _hint(name: str, names: list[str]) -> str:
    """Hint: the face that has a name, or a name that is nearly the same."""
    from difflib import get_close_matches
    from importlib import import_module

    for other in _SUBFACES:
        if name in getattr(import_module(f"sppm_pipeline.{other}"), "__all__", ()):
            return f"; it is sppm_pipeline.{other}.{name}"
    near = get_close_matches(name, names, 1)
    return f"; did you mean {near[0]!r}?" if near else ""


__all__, _load, _ = lazily(__name__, _PLACES)


def __dir__() -> list[str]:
    return sorted([*__all__, *_SUBFACES, "__version__"])
