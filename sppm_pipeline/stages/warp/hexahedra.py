"""``warp.hexahedra``: a box of cells fills a mesh of hexahedra."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.data.length import UNITS_IN_MM
from sppm_pipeline.errors import ConfigError, InputError
from sppm_pipeline.families import options
from sppm_pipeline.families.warper import Mapped, Warper
from sppm_pipeline.fields.tiling import Tiling
from sppm_pipeline.formats.input_file import library, require_file, third_party_reader
from sppm_pipeline.stages.read.volume_mesh import LARGEST_FILE, READERS

MOST_ELEMENTS = 100_000


@dataclass(frozen=True, kw_only=True)
class WarpHexahedra(Warper):
    """Fill the elements of a mesh of hexahedra with the cells of a box, one in each, or a whole number along each axis.

    The mesh (VTU, VTK, INP or MSH, read by meshio) has to be a block: rows, columns and layers of elements, bent as you
    like. Its first element says which way x, y and z go.
    """

    name: ClassVar[str] = "warp.hexahedra"
    reported: ClassVar[tuple[str, ...]] = ("volume_min", "volume_max")

    path: Path = options.read_path(note="a mesh of hexahedra: .vtu, .vtk, .inp or .msh")
    unit: str = options.unit("mm", note="of the nodes")

    def check_options(self) -> None:
        if self.path.suffix.lower() not in READERS:
            raise ConfigError(f"`path` is {str(self.path)!r}; known are {', '.join(READERS)}")

    @cached_property
    def _corners(self) -> NDArray[np.float64]:
        """Nodes of the block, (nx + 1, ny + 1, nz + 1, 3) mm."""
        from sppm_pipeline.numerics.grading.hexahedra import block_of, mapped_in_block

        require_file(self.path, LARGEST_FILE)
        reader = library(f"meshio.{READERS[self.path.suffix.lower()]}", "volume")
        with third_party_reader("meshio", self.path.name, "write the mesh again, perhaps as VTU"):
            read = reader.read(self.path)
        blocks = [np.asarray(block.data, np.int64) for block in read.cells if block.type.startswith("hexahedron")]
        points = np.asarray(read.points, np.float64)
        if not blocks or points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
            raise InputError(f"{self.path.name} holds no hexahedra in space")
        elements = np.concatenate([block[:, :8] for block in blocks])
        if len(elements) > MOST_ELEMENTS:
            raise InputError(f"{self.path.name} has {len(elements)} elements; the limit is {MOST_ELEMENTS}")
        if elements.min() < 0 or elements.max() >= len(points):
            raise InputError(f"{self.path.name}: an element names a node that does not exist")
        try:
            nodes = block_of(elements)
        except ValueError as error:
            raise InputError(
                f"{self.path.name} is no block of hexahedra: {error}",
                hint="cut it into blocks, or fill the part by `tile.scattered`",
            ) from None
        corners = points[nodes] * UNITS_IN_MM[self.unit]
        size = np.array(nodes.shape) - 1
        site = np.stack(np.meshgrid(*(np.arange(n) for n in size), indexing="ij"), -1).reshape(-1, 3)
        for corner in np.ndindex(2, 2, 2):
            # just inside, as a corner belongs to several elements
            inner = site + 1e-9 + np.array(corner) * (1 - 2e-9)
            det = mapped_in_block(corners, inner)[1]
            if (det <= 0).any():
                bad = site[int(np.argmax(det <= 0))].tolist()
                raise InputError(
                    f"{self.path.name}: element {bad} of the block is inside out or flat at a corner",
                    hint="repair the mesh; if all elements are, exchange their lower and upper nodes",
                )
        return corners

    def mapped(self, tiling: Tiling, places: NDArray[np.float64]) -> Mapped:
        from sppm_pipeline.numerics.grading.hexahedra import mapped_in_block

        size, cells = np.array(self._corners.shape[:3]) - 1, np.array(tiling.cells)
        if (cells % size).any():
            raise ConfigError(
                f"{cells.tolist()} cells do not fit into {size.tolist()} elements",
                hint=f"lay as many cells as elements, `cells: {size.tolist()}`, or a multiple along each axis",
            )
        points, det = mapped_in_block(self._corners, places * size / cells)
        return Mapped(points, det * float(np.prod(size / cells)) / tiling.physical_edge() ** 3)
