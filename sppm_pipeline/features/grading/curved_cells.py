"""Bent cells: a lattice mapped to a tube, a shell or hexahedra."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.features.grading.numerics.hexahedral_mesh import outer_hexahedra
from sppm_pipeline.features.grading.numerics.hexahedral_places import (
    hexahedron_tree,
    places_in,
    points_and_volumes,
    points_in,
)
from sppm_pipeline.nouns.artifact import frozen
from sppm_pipeline.services.arrays import F64, I32, I64

if TYPE_CHECKING:
    from sppm_pipeline.features.grading.numerics.hexahedral_mesh import OuterHexahedra
    from sppm_pipeline.services.mesh.box_tree import BoxTree

MARGIN = 0.5
"""Distance beyond the outermost cells, in cells, up to which places are continued. A heuristic: surfaces need one voxel
of it, so that half as much would do from four samples a cell on; more only fills what is cut away."""

_STEP = 1e-5
"""Half the step of central differences, in cells: near the cube root of the rounding error, where they are best."""


class Places(NamedTuple):
    """Points in cells: numbers of the cells (n,), -1 outside of all, and places in these (n, 3), 0 to 1 along axes."""

    cell: I32
    within: F64


class Mapped(NamedTuple):
    """Points of a box of cells that was bent, (n, 3) mm, and the volume (n,) of a cell there relative to that of a
    cell of the box; not positive where the mapping turns inside out.
    """

    points: F64
    volume: F64


@dataclass(frozen=True, eq=False)
class CurvedCells(ABC):
    """Bent cells that fill a region, each the image of a unit cube.

    Implement `count`, `names`, `points`, `places`; `continued` for fields that are mapped.
    """

    @property
    def columns(self) -> tuple[str, ...]:
        """Meaning of the numbers in a name."""
        return ("i", "j", "k")

    @property
    @abstractmethod
    def count(self) -> int:
        """Number of cells."""

    @property
    @abstractmethod
    def names(self) -> I64:
        """Numbers that name each cell, (count, columns)."""

    @abstractmethod
    def points(self, cell: NDArray[np.integer], within: F64) -> F64:
        """Points (n, 3) mm at places in cells; those slightly beyond 0 to 1 are continued."""

    @abstractmethod
    def places(self, points: F64) -> Places:
        """The cells around points (n, 3) mm; those that follow each other should be near each other."""

    @abstractmethod
    def continued(self, points: F64) -> tuple[I32, F64]:
        """Cells of points, also those up to `MARGIN` outside, and places in the lattice that was bent, (n, 3); -1
        farther out.

        Where there was no lattice, as in a mesh of any shape, places are those in the cell.
        """

    def derivatives(self, cell: NDArray[np.integer], within: F64) -> F64:
        """Derivatives of `points`, (n, 3, 3) mm; column a is that along axis a."""
        steps = _STEP * np.eye(3)
        columns = [(self.points(cell, within + e) - self.points(cell, within - e)) / (2 * _STEP) for e in steps]
        return np.stack(columns, axis=2)

    def mapped_with_volume(self, cell: NDArray[np.integer], within: F64) -> tuple[F64, F64]:
        """Points (n, 3) mm at places in cells, and the volume of a unit there, (n,) mm^3."""
        return self.points(cell, within), np.abs(np.linalg.det(self.derivatives(cell, within)))

    def inner(self, per_axis: int, cells: NDArray[np.integer] | None = None) -> tuple[F64, F64]:
        """Points in all or some cells, (cells, per_axis^3, 3) mm, and volumes that they stand for, (cells,
        per_axis^3).
        """
        chosen = np.arange(self.count) if cells is None else cells
        t = (np.arange(per_axis) + 0.5) / per_axis
        within = np.stack(np.meshgrid(t, t, t, indexing="ij"), -1).reshape(-1, 3)
        points, volume = self.mapped_with_volume(np.repeat(chosen, len(within)), np.tile(within, (len(chosen), 1)))
        shape = (len(chosen), len(within))
        return points.reshape(*shape, 3), volume.reshape(shape) / len(within)

    @cached_property
    def centers(self) -> F64:
        """Middles of the cells, (count, 3) mm."""
        return frozen(self.points(np.arange(self.count), np.full((self.count, 3), 0.5)))

    @cached_property
    def frames(self) -> F64:
        """Derivatives in the middles, (count, 3, 3) mm."""
        return frozen(self.derivatives(np.arange(self.count), np.full((self.count, 3), 0.5)))

    @cached_property
    def volumes(self) -> F64:
        """Volumes of the cells, (count,) mm^3, by three points along each axis."""
        return frozen(self.inner(3)[1].sum(axis=1))

    @property
    def _along_an_edge(self) -> int:
        """Points along an edge of a cell between which it does not bulge."""
        return 2

    @cached_property
    def box(self) -> F64:
        """Low and high corner of what the cells fill, (2, 3) mm, by points on their edges and faces."""
        t = np.linspace(0, 1, self._along_an_edge)
        within = np.stack(np.meshgrid(t, t, t, indexing="ij"), -1).reshape(-1, 3)
        within = within[((within == 0) | (within == 1)).any(axis=1)]
        cell = np.repeat(np.arange(self.count), len(within))
        points = self.points(cell, np.tile(within, (self.count, 1)))
        return frozen(np.array([points.min(axis=0), points.max(axis=0)]))


@dataclass(frozen=True, eq=False)
class BentBox(CurvedCells):
    """A box of cells that a formula bends: implement `mapped` and `unmapped`."""

    shape: tuple[int, int, int]  # cells along each axis of the box
    edge: float  # size of a cell before, mm
    inner_radius: float  # mm
    around: float  # angle that the box fills around the axis, radians

    @abstractmethod
    def mapped(self, places: F64) -> Mapped:
        """Points at places (n, 3) of the box, in cell sizes from its low corner."""

    @abstractmethod
    def unmapped(self, points: F64) -> F64:
        """Places in the box (n, 3) of points (n, 3) mm."""

    @property
    def count(self) -> int:
        return math.prod(self.shape)

    @property
    def names(self) -> I64:
        return np.stack(np.unravel_index(np.arange(self.count), self.shape), axis=1).astype(np.int64)

    @property
    def turn(self) -> float:
        """Angle that a cell fills around the axis, radians."""
        return self.around / self.shape[0]

    _bulging: ClassVar[tuple[int, int, int]] = (1, 1, 0)  # axes along which points on an arc may be the outermost

    @property
    def _arc(self) -> float:
        """The largest angle that a cell fills, radians."""
        return self.turn

    @property
    def _along_an_edge(self) -> int:
        return 2 + math.ceil(64 * self._arc / math.pi)

    @cached_property
    def box(self) -> F64:
        """Low and high corner of what the cells fill, (2, 3) mm, and of what bulges between the points by which."""
        low, high = super().box
        radius = self.inner_radius + self.edge * self.shape[2]
        # sagitta: no place on a face is farther than half a diagonal of the grid of points from the nearest of them
        bulge = radius * (1 - math.cos(self._arc / (self._along_an_edge - 1) / math.sqrt(2))) * np.array(self._bulging)
        return frozen(np.array([low - bulge, high + bulge]))

    def points(self, cell: NDArray[np.integer], within: F64) -> F64:
        return self.mapped(np.stack(np.unravel_index(cell, self.shape), axis=1) + within)[0]

    def mapped_with_volume(self, cell: NDArray[np.integer], within: F64) -> tuple[F64, F64]:
        points, volume = self.mapped(np.stack(np.unravel_index(cell, self.shape), axis=1) + within)
        return points, volume * self.edge**3

    def places(self, points: F64) -> Places:
        place = self.unmapped(points)
        cell = self._cell_of(place, 0.0)
        site = np.stack(np.unravel_index(np.maximum(cell, 0), self.shape), axis=1)
        return Places(cell, np.clip(place - site, 0.0, 1.0))

    def continued(self, points: F64) -> tuple[I32, F64]:
        place = self.unmapped(points)
        return self._cell_of(place, MARGIN), place

    def _cell_of(self, place: F64, margin: float) -> I32:
        size = np.array(self.shape)
        inside = ((place >= -margin) & (place <= size + margin)).all(axis=1)
        site = np.clip(np.floor(place), 0, size - 1).astype(np.int64)
        return np.where(inside, np.ravel_multi_index(tuple(site.T), self.shape), -1).astype(np.int32)

    def _angle(self, points: F64) -> F64:
        """Angles around the axis; in the gap of what is no full turn those below zero belong to its nearer end."""
        # from -pi to pi; the far half of the gap belongs to the end of the box, beyond pi for more than half a turn
        angle = np.arctan2(points[:, 1], points[:, 0])
        gap = 2 * math.pi - self.around
        return np.where(angle < -gap / 2, angle + 2 * math.pi, angle)


@dataclass(frozen=True, eq=False)
class CylinderCells(BentBox):
    """A box bent to the wall of a tube around the z axis: x goes around, y along the axis, z outwards."""

    def mapped(self, places: F64) -> Mapped:
        angle, r = self.turn * places[:, 0], self.inner_radius + self.edge * places[:, 2]
        points = np.stack([r * np.cos(angle), r * np.sin(angle), self.edge * places[:, 1]], axis=1)
        # x, y, z of the box are around, upwards, outwards: a right-handed frame
        return Mapped(points, self.turn * r / self.edge)

    def unmapped(self, points: F64) -> F64:
        r = np.hypot(points[:, 0], points[:, 1])
        outwards = (r - self.inner_radius) / self.edge
        return np.stack([self._angle(points) / self.turn, points[:, 2] / self.edge, outwards], axis=1)


@dataclass(frozen=True, eq=False)
class SphereCells(BentBox):
    """A box bent to a zone of a shell around the origin: x goes along the equator, y to the north, z outwards."""

    south: float  # latitude at which it begins, radians
    climb: float  # angle that it fills to the north, radians
    _bulging: ClassVar[tuple[int, int, int]] = (1, 1, 1)

    @property
    def _arc(self) -> float:
        return max(self.turn, self.rise)

    @property
    def rise(self) -> float:
        """Angle that a cell fills to the north, radians."""
        return self.climb / self.shape[1]

    def mapped(self, places: F64) -> Mapped:
        turn, rise = self.turn, self.rise
        longitude = turn * places[:, 0]
        latitude = self.south + rise * places[:, 1]
        r = self.inner_radius + self.edge * places[:, 2]
        across = r * np.cos(latitude)
        points = np.stack([across * np.cos(longitude), across * np.sin(longitude), r * np.sin(latitude)], axis=1)
        return Mapped(points, turn * across * rise * r / self.edge**2)

    def unmapped(self, points: F64) -> F64:
        across = np.hypot(points[:, 0], points[:, 1])
        latitude, r = np.arctan2(points[:, 2], across), np.hypot(across, points[:, 2])
        return np.stack(
            [self._angle(points) / self.turn, (latitude - self.south) / self.rise,
             (r - self.inner_radius) / self.edge],
            axis=1,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class AffineCells(BentBox):
    """A box that is stretched and turned about its middle; where it repeats, its images fill a region."""

    matrix: F64  # (3, 3), of vectors
    middle: F64  # (3,) mm, where the middle of the box comes to lie
    region: F64 | None = None  # low and high corner, (2, 3) mm; None for the box alone

    def __post_init__(self) -> None:
        for name in ("matrix", "middle"):
            object.__setattr__(self, name, frozen(np.asarray(getattr(self, name), np.float64)))

    def mapped(self, places: F64) -> Mapped:
        moved = self.edge * (places - np.array(self.shape) / 2) @ self.matrix.T
        return Mapped(self.middle + moved, np.full(len(places), np.linalg.det(self.matrix)))

    def unmapped(self, points: F64) -> F64:
        back: F64 = (points - self.middle) @ np.linalg.inv(self.matrix).T
        return back / self.edge + np.array(self.shape) / 2

    @cached_property
    def box(self) -> F64:
        found: F64 = super().box if self.region is None else frozen(self.region)
        return found

    def continued(self, points: F64) -> tuple[I32, F64]:
        cell, place = super().continued(points)
        return (cell if self.region is None else np.zeros_like(cell)), place


@dataclass(frozen=True, eq=False)
class HexahedralCells(CurvedCells):
    """Trilinear hexahedra, or parts into which they were cut."""

    corners: F64  # (m, 2, 2, 2, 3) mm, nodes by x, y, z of each cell
    parts: int = 1  # how many cells a hexahedron of the mesh was cut into; they follow each other
    shape: tuple[int, int, int] | None = None  # of a block, whose cells are in C order; None for a mesh of any shape

    def __post_init__(self) -> None:
        object.__setattr__(self, "corners", frozen(np.asarray(self.corners, np.float64)))

    @property
    def count(self) -> int:
        return len(self.corners)

    @property
    def names(self) -> I64:
        number = np.arange(self.count)
        if self.shape is not None:
            return np.stack(np.unravel_index(number, self.shape), axis=1).astype(np.int64)
        return np.stack([number // self.parts, number % self.parts], axis=1)

    @property
    def columns(self) -> tuple[str, ...]:
        return ("i", "j", "k") if self.shape is not None else ("hexahedron", "part")

    def points(self, cell: NDArray[np.integer], within: F64) -> F64:
        return points_in(self.corners, cell, within)[0]

    def derivatives(self, cell: NDArray[np.integer], within: F64) -> F64:
        return points_in(self.corners, cell, within)[1]

    def mapped_with_volume(self, cell: NDArray[np.integer], within: F64) -> tuple[F64, F64]:
        return points_and_volumes(self.corners, cell, within)

    @cached_property
    def _tree(self) -> BoxTree:
        return hexahedron_tree(self.corners)

    @cached_property
    def outer(self) -> OuterHexahedra:
        """Hexahedra that continue the cells beyond the boundary of the mesh."""
        return outer_hexahedra(self.corners, MARGIN)

    def rim(self, per_axis: int = 5) -> tuple[F64, I32]:
        """Points on the faces at which the mesh ends, (n, 3) mm, and the cells to which these faces belong, (n,)."""
        t, outer = np.linspace(0, 1, per_axis), self.outer
        u, v = (a.ravel() for a in np.meshgrid(t, t, indexing="ij"))
        points, cells = [np.zeros((0, 3))], [np.zeros(0, np.int32)]
        for axis in range(3):
            for side in range(2):
                own = outer.cell[(outer.size[:, axis] < 1) & ((outer.low[:, axis] > 0) == bool(side))]
                within = np.empty((len(u), 3))
                within[:, axis], within[:, (axis + 1) % 3], within[:, (axis + 2) % 3] = side, u, v
                cell = np.repeat(own, len(u))
                points.append(self.points(cell, np.tile(within, (len(own), 1))))
                cells.append(cell)
        return np.concatenate(points), np.concatenate(cells)

    @cached_property
    def _every(self) -> tuple[BoxTree, F64]:
        """The cells, and behind them those that continue them: of several that hold a point the first one counts."""
        every = np.concatenate([self.corners, self.outer.corners])
        return hexahedron_tree(every), every

    def places(self, points: F64) -> Places:
        return Places(*places_in(self._tree, self.corners, points))

    def continued(self, points: F64) -> tuple[I32, F64]:
        cell, within = places_in(*self._every, points, apart=self.count)
        beyond = np.flatnonzero(cell >= self.count)
        number, outer = cell[beyond] - self.count, self.outer
        within[beyond] = outer.low[number] + within[beyond] * outer.size[number]
        cell[beyond] = outer.cell[number]
        if self.shape is not None:
            within += np.stack(np.unravel_index(np.maximum(cell, 0), self.shape), axis=1)
        return cell, within
