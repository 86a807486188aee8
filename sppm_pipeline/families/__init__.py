"""Base classes of families of stages: a new sampler, connector, formula or tile rule is one method.

A sampler in a few lines::

    @dataclass(frozen=True, kw_only=True)
    class Uniform(Sampler):
        '''Independent uniform pores, a worst case for spacing.'''

        name: ClassVar[str] = "sample.uniform"
        count: int = option(help="number of pores in a cell", minimum=1)

        def throw(self, rng, box):
            return box.lower + rng.random((self.count, 3)) * (box.upper - box.lower)

and a formula of a periodic cell::

    @dataclass(frozen=True, kw_only=True)
    class Primitive(FieldMaker):
        '''The primitive surface of Schwarz: solid where the sum of three cosines lies below a value.'''

        name: ClassVar[str] = "field.primitive"
        isovalue: float = option(0.0, help="value of the sum at the surface", minimum=-3, maximum=3)

        def evaluate(self, x, y, z):
            return np.cos(2 * np.pi * x) + np.cos(2 * np.pi * y) + np.cos(2 * np.pi * z) - self.isovalue
"""

from __future__ import annotations

TYPE_CHECKING = False  # as type checkers understand it
if TYPE_CHECKING:  # the same names as in `_PLACES`, which a test compares
    from typing import Any

    from sppm_pipeline.families import options
    from sppm_pipeline.families.cloud import Cloud, Piece
    from sppm_pipeline.families.connector import Connector
    from sppm_pipeline.families.field_maker import FieldMaker, PartFieldMaker
    from sppm_pipeline.families.file_writer import MeshWriter
    from sppm_pipeline.families.grader import Grader
    from sppm_pipeline.families.homogenizer import Homogenizer
    from sppm_pipeline.families.interiors import InteriorBox, Interiors
    from sppm_pipeline.families.layer_writer import LayerWriter
    from sppm_pipeline.families.sampler import Sampler, design_of, start_of
    from sppm_pipeline.families.tiler import Lattice, Tiler, lattice_for, tiling_size
    from sppm_pipeline.families.tileset_maker import TileSetMaker

__all__ = [
    "Cloud",
    "Connector",
    "FieldMaker",
    "Grader",
    "Homogenizer",
    "InteriorBox",
    "Interiors",
    "Lattice",
    "LayerWriter",
    "MeshWriter",
    "PartFieldMaker",
    "Piece",
    "Sampler",
    "TileSetMaker",
    "Tiler",
    "design_of",
    "lattice_for",
    "options",
    "start_of",
    "tiling_size",
]

_PLACES = {
    "cloud": ("Cloud", "Piece"),
    "connector": ("Connector",),
    "field_maker": ("FieldMaker", "PartFieldMaker"),
    "file_writer": ("MeshWriter",),
    "grader": ("Grader",),
    "homogenizer": ("Homogenizer",),
    "interiors": ("InteriorBox", "Interiors"),
    "layer_writer": ("LayerWriter",),
    "sampler": ("Sampler", "design_of", "start_of"),
    "tiler": ("Lattice", "Tiler", "lattice_for", "tiling_size"),
    "tileset_maker": ("TileSetMaker",),
}
"""Module -> what it supplies; a stage loads its own family only."""

_PLACE_OF = {name: module for module, names in _PLACES.items() for name in names}


def __getattr__(name: str) -> Any:
    """Load a base class when it is first used."""
    from importlib import import_module

    if name == "options":
        return import_module(f"{__name__}.options")
    if name not in _PLACE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(f"{__name__}.{_PLACE_OF[name]}"), name)
    return value
