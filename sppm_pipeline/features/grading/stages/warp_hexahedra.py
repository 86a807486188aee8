"""``warp.hexahedra``: a box of cells fills a mesh of hexahedra."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import ConfigError, Context, InputError, ScalarField, Tiling, options
from sppm_pipeline.features.grading.curved_cells import HexahedralCells, Mapped
from sppm_pipeline.features.grading.hexahedra import check_path, mesh_of, warn_of_order
from sppm_pipeline.features.grading.numerics.hexahedra import block_of, mapped_in_block
from sppm_pipeline.features.grading.warped_field import has_cubic_symmetry
from sppm_pipeline.features.grading.warper import Warper
from sppm_pipeline.nouns.length import UNITS_IN_MM
from sppm_pipeline.services.formats.hexahedra_file import Hexahedra, read_hexahedra

if TYPE_CHECKING:
    from sppm_pipeline.features.grading.numerics.hexahedral_mesh import HexahedralMesh


@dataclass(frozen=True, kw_only=True)
class WarpHexahedra(Warper):
    """Fill the elements of a mesh of hexahedra with the cells of a box, one in each, or a whole number along each axis.

    The mesh (VTU, VTK, INP or MSH, read by meshio) has to be a block: rows, columns and layers of elements, bent as you
    like. Its first element says which way x, y and z go. It is checked as by `read.hexahedra`; a block whose ends touch
    stays open there if the file lists their nodes twice. A field that repeats and has the symmetry of a cube,
    such as a Schwarz P surface or struts along the axes, may fill a mesh of any shape, one cell in each element;
    `tile.hexahedra` scatters pores in such a mesh.
    """

    name: ClassVar[str] = "warp.hexahedra"
    libraries: ClassVar[tuple[str, ...]] = ("meshio",)
    reported: ClassVar[tuple[str, ...]] = ("volume_min", "volume_max")

    path: Path = options.read_path(note="a mesh of hexahedra: .vtu, .vtk, .inp or .msh")
    unit: str = options.unit("mm", note="of the nodes")

    def check_options(self) -> None:
        check_path(self.path)

    @cached_property
    def _read(self) -> Hexahedra:
        return read_hexahedra(self.path)

    @cached_property
    def _mesh(self) -> HexahedralMesh:
        return mesh_of(self._read, self.path, self.unit)

    @cached_property
    def _block(self) -> NDArray[np.float64] | str:
        """Nodes of the block, (nx + 1, ny + 1, nz + 1, 3) mm, or why the mesh is none."""
        mesh = self._mesh
        try:
            return mesh.nodes[block_of(mesh.hexahedra)]
        except ValueError as error:
            reason = str(error)
        # ends of a block that touch, as those of a ring, stay apart where the file lists their nodes twice
        try:
            return self._read.points[block_of(mesh.listed)] * UNITS_IN_MM[self.unit]
        except ValueError:
            return reason

    @property
    def _corners(self) -> NDArray[np.float64]:
        if isinstance(self._block, str):
            raise InputError(
                f"{self.path.name} is no block of hexahedra: {self._block}",
                hint="scatter pores in it by `tile.hexahedra`, or cut it into blocks",
            )
        return self._block

    def run(self, context: Context, field: ScalarField) -> ScalarField:
        """Read and check the mesh, then map the graph or the field."""
        warn_of_order(self._mesh, self.path, context)
        return super().run(context, field)

    def _cells(self, field: ScalarField) -> tuple[int, int, int]:
        """Cells of the box; those of a single periodic cell are as many as the elements."""
        nx, ny, nz = (n - 1 for n in self._corners.shape[:3])
        return (nx, ny, nz) if field.periodic and tuple(field.cells) == (1, 1, 1) else field.cells

    def curved(self, field: ScalarField) -> HexahedralCells:
        if not isinstance(field, Tiling) and field.periodic and isinstance(self._block, str):
            if not has_cubic_symmetry(field):
                raise InputError(
                    f"{self.path.name} is no block of hexahedra ({self._block}), and the cell of the field looks "
                    "different from its sides, so that cells would not fit each other",
                    hint="take a block, or a field with the symmetry of a cube, such as a Schwarz P surface",
                )
            return HexahedralCells(self._mesh.corners)
        shape = self._cells(field)
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

    def mapped(self, field: ScalarField, places: NDArray[np.float64]) -> Mapped:
        size, cells = np.array(self._corners.shape[:3]) - 1, np.array(field.cells)
        self._check_cells(field.cells)
        points, det = mapped_in_block(self._corners, places * size / cells)
        return Mapped(points, det * float(np.prod(size / cells)) / field.physical_edge() ** 3)
