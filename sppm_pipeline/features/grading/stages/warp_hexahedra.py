"""``warp.hexahedra``: a box of cells fills a mesh of hexahedra."""

from __future__ import annotations

import itertools
from collections import deque
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from sppm_pipeline import ConfigError, Context, InputError, ScalarField, Tiling, options
from sppm_pipeline.features.grading.curved_cells import HexahedralCells, Mapped
from sppm_pipeline.features.grading.hexahedra_file import Hexahedra, read_hexahedra
from sppm_pipeline.features.grading.numerics.hexahedral_mesh import PLACES
from sppm_pipeline.features.grading.numerics.hexahedral_places import points_in
from sppm_pipeline.features.grading.stages.read_hexahedra import mesh_of, warn_of_order
from sppm_pipeline.features.grading.warped_field import has_cubic_symmetry
from sppm_pipeline.features.grading.warper import Warper
from sppm_pipeline.nouns.length import UNITS_IN_MM
from sppm_pipeline.services.arrays import F64, I64
from sppm_pipeline.services.formats.element_file import check_elements

if TYPE_CHECKING:
    from sppm_pipeline.features.grading.numerics.hexahedral_mesh import HexahedralMesh


def block_of(hexahedra: I64) -> I64:
    """The nodes (nx + 1, ny + 1, nz + 1) of hexahedra (m, 8) as a block, whose axes are those of the first element.

    Nodes are in VTK's order; each element may begin at any corner, wound either way. `ValueError` if the elements are
    no block of nx x ny x nz.
    """
    cubes = hexahedra[:, PLACES].reshape(-1, 2, 2, 2)
    owners: dict[frozenset[int], list[int]] = {}
    for number, cube in enumerate(cubes):
        for axis, side in itertools.product(range(3), range(2)):
            owners.setdefault(frozenset(cube.take(side, axis).ravel().tolist()), []).append(number)
    if any(len(found) > 2 for found in owners.values()):
        raise ValueError("three elements share a face")
    place: dict[int, tuple[int, int, int]] = {0: (0, 0, 0)}
    turned = {0: cubes[0]}
    # from element to element across their faces, each turned so that it fits the one it was reached from
    waiting = deque([0])
    while waiting:
        number = waiting.popleft()
        cube = turned[number]
        for axis, side in itertools.product(range(3), range(2)):
            face = cube.take(side, axis)
            others = [other for other in owners[frozenset(face.ravel().tolist())] if other != number]
            if not others:
                continue
            step = [0, 0, 0]
            step[axis] = 2 * side - 1
            there = (place[number][0] + step[0], place[number][1] + step[1], place[number][2] + step[2])
            if others[0] in place:
                if place[others[0]] != there:
                    raise ValueError(f"elements {number} and {others[0]} are neighbors in two ways")
                continue
            place[others[0]] = there
            turned[others[0]] = _fitted(cubes[others[0]], face, axis, side)
            waiting.append(others[0])
    if len(place) < len(cubes):
        raise ValueError("its elements are not all connected by faces")
    sites = np.array([place[number] for number in range(len(cubes))])
    sites -= sites.min(axis=0)
    size = sites.max(axis=0) + 1
    if len(np.unique(sites, axis=0)) != len(cubes) or np.prod(size) != len(cubes):
        raise ValueError(f"{len(cubes)} elements do not fill a block of {size[0]} x {size[1]} x {size[2]}")
    nodes = np.full(tuple(size + 1), -1, np.int64)
    for number, (i, j, k) in enumerate(sites.tolist()):
        own = nodes[i : i + 2, j : j + 2, k : k + 2]
        if ((own >= 0) & (own != turned[number])).any():
            raise ValueError(f"element {number} and its neighbors do not meet node by node")
        own[...] = turned[number]
    return nodes


def _fitted(cube: I64, face: I64, axis: int, side: int) -> I64:
    """A cube turned so that its far side along an axis is a face."""
    for order in itertools.permutations(range(3)):
        # all 48 ways, mirrored ones too, as elements may be wound either way
        for flips in itertools.product((1, -1), repeat=3):
            made = cube.transpose(order)[:: flips[0], :: flips[1], :: flips[2]]
            if np.array_equal(made.take(1 - side, axis), face):
                return made
    raise ValueError("two elements share four nodes, but no face")


def mapped_in_block(corners: F64, places: F64) -> tuple[F64, F64]:
    """Trilinear places in a block of hexahedra, and the determinant of the derivative; `places` (n, 3) count elements,
    and those beyond the block are continued from the element next to them.
    """
    size = np.array(corners.shape[:3]) - 1
    element = np.clip(np.floor(places), 0, size - 1).astype(np.int64)
    own = np.stack([corners[tuple((element + corner).T)] for corner in np.ndindex(2, 2, 2)], axis=1)
    points, derivative = points_in(own.reshape(-1, 2, 2, 2, 3), np.arange(len(places)), places - element)
    return points, np.linalg.det(derivative)


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
        check_elements(self.path)

    @cached_property
    def _read(self) -> Hexahedra:
        return read_hexahedra(self.path)

    @cached_property
    def _mesh(self) -> HexahedralMesh:
        return mesh_of(self._read, self.path, self.unit)

    @cached_property
    def _block(self) -> F64 | str:
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
    def _corners(self) -> F64:
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

    def mapped(self, field: ScalarField, places: F64) -> Mapped:
        size, cells = np.array(self._corners.shape[:3]) - 1, np.array(field.cells)
        self._check_cells(field.cells)
        points, det = mapped_in_block(self._corners, places * size / cells)
        return Mapped(points, det * float(np.prod(size / cells)) / field.physical_edge() ** 3)
