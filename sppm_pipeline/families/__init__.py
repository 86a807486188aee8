"""Base classes of the families whose members share work: a new sampler, connector or tile rule is one method.

A sampler in a few lines::

    @dataclass(frozen=True, kw_only=True)
    class Uniform(Sampler):
        '''Independent uniform pores, a worst case for spacing.'''

        name: ClassVar[str] = "sample.uniform"
        count: int = option(help="number of pores in a cell", minimum=1)

        def throw(self, rng, box):
            return box.lower + rng.random((self.count, 3)) * (box.upper - box.lower)
"""

from __future__ import annotations

from sppm_pipeline.families.connector import Connector, Piece
from sppm_pipeline.families.homogenizer import VoxelHomogenizer
from sppm_pipeline.families.layer_writer import LayerWriter
from sppm_pipeline.families.mesh_writer import MeshWriter
from sppm_pipeline.families.sampler import InteriorBox, Sampler, design_of, start_of
from sppm_pipeline.families.tiler import Lattice, Tiler, lattice_for, tiling_size
from sppm_pipeline.families.tileset_maker import TileSetMaker
from sppm_pipeline.families.volume_mesh_writer import VolumeMeshWriter
from sppm_pipeline.families.voxel_writer import VoxelWriter

__all__ = [
    "Connector",
    "InteriorBox",
    "Lattice",
    "LayerWriter",
    "MeshWriter",
    "Piece",
    "Sampler",
    "TileSetMaker",
    "Tiler",
    "VolumeMeshWriter",
    "VoxelHomogenizer",
    "VoxelWriter",
    "design_of",
    "lattice_for",
    "start_of",
    "tiling_size",
]
