"""``warp.hexahedra``: a box of cells fills a mesh of hexahedra."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.data.curved_cells import HexahedralCells
from sppm_pipeline.data.length import UNITS_IN_MM
from sppm_pipeline.errors import ConfigError, InputError
from sppm_pipeline.families import options
from sppm_pipeline.families.hexahedra import cells_of_mesh, check_path
from sppm_pipeline.families.warper import Mapped, Warper
from sppm_pipeline.fields.scalar_field import ScalarField
from sppm_pipeline.fields.tiling import Tiling
from sppm_pipeline.fields.warped_field import looks_alike_from_all_sides
from sppm_pipeline.formats.hexahedra_file import Hexahedra, read_hexahedra


@dataclass(frozen=True, kw_only=True)
class WarpHexahedra(Warper):
    """Fill the elements of a mesh of hexahedra with the cells of a box, one in each, or a whole number along each axis.

    The mesh (VTU, VTK, INP or MSH, read by meshio) has to be a block: rows, columns and layers of elements, bent as you
    like. Its first element says which way x, y and z go. A field that repeats and looks alike from all sides of its
    cell, such as a Schwarz P surface or struts along the axes, may fill a mesh of any shape, one cell in each element;
    `tile.hexahedra` scatters pores in such a mesh.
    """

    name: ClassVar[str] = "warp.hexahedra"
    reported: ClassVar[tuple[str, ...]] = ("volume_min", "volume_max")

    path: Path = options.read_path(note="a mesh of hexahedra: .vtu, .vtk, .inp or .msh")
    unit: str = options.unit("mm", note="of the nodes")

    def check_options(self) -> None:
        check_path(self.path)

    @cached_property
    def _read(self) -> Hexahedra:
        return read_hexahedra(self.path)

    @cached_property
    def _corners(self) -> NDArray[np.float64]:
        """Nodes of the block, (nx + 1, ny + 1, nz + 1, 3) mm."""
        from sppm_pipeline.numerics.grading.hexahedra import block_of, mapped_in_block

        try:
            nodes = block_of(self._read.elements)
        except ValueError as error:
            raise InputError(
                f"{self.path.name} is no block of hexahedra: {error}",
                hint="scatter pores in it by `tile.hexahedra`, or cut it into blocks",
            ) from None
        corners = self._read.points[nodes] * UNITS_IN_MM[self.unit]
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

    def _cells(self, field: ScalarField) -> tuple[int, int, int]:
        """Cells of the box; those of a lone cell that repeats are as many as the elements."""
        nx, ny, nz = (n - 1 for n in self._corners.shape[:3])
        return (nx, ny, nz) if field.periodic and tuple(field.cells) == (1, 1, 1) else field.cells

    def curved(self, tiling: ScalarField) -> HexahedralCells:
        from sppm_pipeline.numerics.grading.hexahedra import block_of, mapped_in_block

        if not isinstance(tiling, Tiling) and tiling.periodic:
            try:
                block_of(self._read.elements)
            except ValueError as error:
                if not looks_alike_from_all_sides(tiling):
                    raise InputError(
                        f"{self.path.name} is no block of hexahedra ({error}), and the cell of the field looks "
                        "different from its sides, so that cells would not fit each other",
                        hint="take a block, or a field with the symmetry of a cube, such as a Schwarz P surface",
                    ) from None
                return cells_of_mesh(self._read, self.path, self.unit, 1)
        shape = self._cells(tiling)
        self._check_cells(shape)
        size = np.array(self._corners.shape[:3]) - 1
        axes = [np.arange(n + 1) * s / n for n, s in zip(shape, size.tolist(), strict=True)]
        places = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
        nodes = mapped_in_block(self._corners, places.reshape(-1, 3))[0].reshape(places.shape)
        corners = np.empty((*shape, 2, 2, 2, 3))
        for i, j, k in np.ndindex(2, 2, 2):
            corners[:, :, :, i, j, k] = nodes[i : i + shape[0], j : j + shape[1], k : k + shape[2]]
        return HexahedralCells(corners.reshape(-1, 2, 2, 2, 3), 1, shape)

    def _check_cells(self, cells: tuple[int, int, int]) -> None:
        size = np.array(self._corners.shape[:3]) - 1
        if (np.array(cells) % size).any():
            raise ConfigError(
                f"{list(cells)} cells do not fit into {size.tolist()} elements",
                hint=f"lay as many cells as elements, `cells: {size.tolist()}`, or a multiple along each axis",
            )

    def mapped(self, tiling: ScalarField, places: NDArray[np.float64]) -> Mapped:
        from sppm_pipeline.numerics.grading.hexahedra import mapped_in_block

        size, cells = np.array(self._corners.shape[:3]) - 1, np.array(tiling.cells)
        self._check_cells(tiling.cells)
        points, det = mapped_in_block(self._corners, places * size / cells)
        return Mapped(points, det * float(np.prod(size / cells)) / tiling.physical_edge() ** 3)
