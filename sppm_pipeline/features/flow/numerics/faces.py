"""Which faces of voxels a fluid passes, how near its walls are, and what of it is closed off.

On the staggered grid of Harlow and Welch (1965) the velocity along an axis lives on the faces across that axis, the
pressure in the voxels. Face (i, j, k) of family d is the low face of voxel (i, j, k) along d.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics import Grid, solid_fractions

_MARGIN = 3
"""Mirror images of so many voxels beyond each side, so that the two neighbors of a face are there, and theirs."""

_NEAREST = 0.05
"""Least distance between a face and a wall in edges of a voxel; nearer walls would only spoil the condition."""


class Faces(NamedTuple):
    """Faces that a fluid passes; arrays (nz, ny, nx), one for each of the families x, y, z.

    `walls` is the drag of the walls on active faces: the sum over neighbors of the same family beyond a wall, in edges
    h of a voxel, of ``1 / (theta h^2)``, the wall being ``theta h`` away. By `weights` a face counts in means and
    forces: 1 away from walls, 0 where it is not active. Of a cell between mirrors each family has one more face along
    its axis, that at the far side.
    """

    active: tuple[NDArray[np.bool_], ...]
    walls: tuple[NDArray[np.float32], ...]
    weights: tuple[NDArray[np.float32], ...]
    edges: tuple[float, float, float]
    porosity: float  # fraction of the cell that is fluid
    surface: float | None  # area of the walls over the volume of the cell; None for whole voxels' stairs
    mirrored: bool = False  # between mirrors at all sides
    ends: tuple[bool, ...] = (False, False, False)  # across which sides, of x, y, z, nothing is a neighbor

    def voxels(self) -> NDArray[np.bool_]:
        """Voxels with an active face, (nz, ny, nx)."""
        held: Any = False
        for d, active in enumerate(self.active):
            # the low face of a voxel, and that of the next one
            both = active | np.roll(active, -1, 2 - d)
            held |= np.delete(both, -1, 2 - d) if self.mirrored else both
        return np.asarray(held)

    def driven(self, d: int) -> Faces:
        """Of a cell between mirrors, and its image behind the one across axis `d`, which repeat along this axis.

        A flow along it does not pass the mirrors beside it, which have no drag: faces there are not active, and the
        other families end half a voxel before them, where nothing changes.
        """
        active, walls, weights = (list[NDArray[Any]]() for _ in range(3))
        for e in range(3):
            for made, given in zip((active, walls, weights), (self.active, self.walls, self.weights), strict=True):
                there = np.moveaxis(given[e], 2 - d, 0)
                there = np.concatenate((there, there[-2:0:-1] if e == d else there[::-1]))
                made.append(np.moveaxis(there, 0, 2 - d))
            if e == d:
                continue
            passed, drag, weight = (np.moveaxis(of[e], 2 - e, 0) for of in (active, walls, weights))
            passed, drag, weight = (of[:-1].copy() for of in (passed, drag, weight))
            ends = np.moveaxis(active[e], 2 - e, 0)
            for end, beside in ((0, 1), (-1, -1)):  # zero at the mirror, a voxel away
                if len(drag) > 1:
                    drag[beside] += (ends[end] & passed[beside]) * np.float32(1 / self.edges[e] ** 2)
            passed[0], drag[0], weight[0] = False, 0, 0
            active[e], walls[e], weights[e] = (
                np.ascontiguousarray(np.moveaxis(of, 0, 2 - e)) for of in (passed, drag, weight)
            )
        return self._replace(
            active=tuple(active), walls=tuple(walls), weights=tuple(weights), mirrored=False,
            ends=tuple(axis != d for axis in range(3)),
        )  # fmt: skip


def _with_images(values: NDArray[Any], faces_along: int | None = None) -> NDArray[Any]:
    """Cells, or faces of a family with those of both sides, and some of their mirror images."""
    for axis in range(3):
        along = faces_along == 2 - axis
        margin = [(0, 0)] * axis + [(_MARGIN, _MARGIN - along)] + [(0, 0)] * (2 - axis)
        values = np.pad(values, margin, mode="reflect" if along else "symmetric")
    return values


def _inside(shape: tuple[int, ...], faces_along: int | None = None) -> tuple[slice, ...]:
    """What of cells or faces with images is theirs, for (nz, ny, nx) of all of them."""
    return tuple(slice(_MARGIN, n - _MARGIN + (faces_along == axis)) for axis, n in zip((2, 1, 0), shape, strict=True))


def faces_of_field(
    sample: Callable[[Grid], NDArray[np.float32]], shape: tuple[int, int, int], spacing: float, mirrored: bool = False
) -> Faces:
    """Faces of a field that is positive in the fluid, the walls where it is zero on the way from a face to the next.

    `sample` gives values of the field on a grid, (nz, ny, nx); `shape` are voxels (nx, ny, nz), `spacing` their edge
    in the field's coordinates; that of the result is 1. `mirrored` fields have mirrors at their sides.
    """

    def theta(here: NDArray[Any], there: NDArray[Any], bend: NDArray[Any], along: bool) -> NDArray[Any]:
        fall = here - there
        # the zero of the line between both values, and the first correction by their second difference
        linear = here / fall
        return np.asarray(np.clip(linear - bend * linear * (1 - linear) / (2 * fall), 0, 1))

    levels = []
    for d in range(3):
        # centers of the low faces along d
        x, y, z = (0.0 if axis == d else spacing / 2 for axis in range(3))
        nx, ny, nz = (n + (mirrored and axis == d) for axis, n in enumerate(shape))
        level = sample(Grid((x, y, z), (spacing,) * 3, (nx, ny, nz)))
        levels.append(_with_images(level, d) if mirrored else level)
    edges = (1.0, 1.0, 1.0)
    surface = sum(_surface(level, d, edges, mirrored) for d, level in enumerate(levels))
    # by planes in eighths of voxels: counted points err by up to 0.6 % at 24^3 where walls repeat in step with the grid
    solid = solid_fractions(lambda grid, start, stop: sample(grid.layers(start, stop)), shape, round(1 / spacing))
    return _faces(levels, theta, edges, 1 - float(solid.mean(dtype=np.float64)), surface, mirrored)


def faces_of_fractions(solid: NDArray[Any], edges: tuple[float, float, float], mirrored: bool = False) -> Faces:
    """Faces between voxels of which a part is solid, (nz, ny, nx); exact for walls along the axes.

    The mean f of two voxels belongs to the face between them, which is active below 1/2; the wall between two faces is
    3/2 less their sum away, where a plane across has them.
    """

    def theta(here: NDArray[Any], there: NDArray[Any], bend: NDArray[Any], along: bool) -> NDArray[Any]:
        return np.asarray(np.minimum(here + there + np.float32(0.5), np.float32(1)))

    fraction = np.asarray(solid, np.float32)
    there = _with_images(fraction) if mirrored else fraction
    levels = [_half_less(there, d) for d in range(3)]
    surface = sum(_surface(level, d, edges, mirrored) for d, level in enumerate(levels))
    return _faces(levels, theta, edges, 1 - float(fraction.mean(dtype=np.float64)), surface, mirrored)


def _half_less(fraction: NDArray[np.float32], d: int) -> NDArray[np.float32]:
    """1/2 less the fraction of the faces of a family: positive in the fluid."""
    mean: NDArray[np.float32] = (fraction + np.roll(fraction, 1, 2 - d)) * np.float32(0.5)
    return np.subtract(np.float32(0.5), mean, out=mean)


def faces_of_voxels(void: NDArray[Any], edges: tuple[float, float, float], mirrored: bool = False) -> Faces:
    """Faces between two voxels of the void, (nz, ny, nx): walls are a face away across, half of one beside."""

    def theta(here: NDArray[Any], there: NDArray[Any], bend: NDArray[Any], along: bool) -> NDArray[Any]:
        return np.full_like(here, 1.0 if along else 0.5)

    there = _with_images(void) if mirrored else void
    levels = [np.where(there & np.roll(there, 1, 2 - d), np.float32(1), np.float32(-1)) for d in range(3)]
    return _faces(levels, theta, edges, float(np.count_nonzero(void)) / void.size, None, mirrored)


def _surface(level: NDArray[np.float32], d: int, edges: tuple[float, float, float], mirrored: bool) -> float:
    """The share of axis d of the area of the zeros of a field over the volume.

    A wall of area A and unit normal n meets ``A |n_d|`` lines along d in each unit of area across, and the three
    ``n_d^2`` sum to 1; so each crossing of a line counts ``|n_d|``, as the slopes on both sides of it have it.
    """
    slopes = [(np.roll(level, -1, 2 - axis) - np.roll(level, 1, 2 - axis)) / 2 for axis in range(3)]
    # a line crosses the wall where the sign changes; the mean of both slopes is that at the wall to second order
    crossed = (level > 0) != (np.roll(level, -1, 2 - d) > 0)
    size = crossed.size
    if mirrored:
        inside = np.zeros_like(crossed)
        inside[_inside(crossed.shape)] = True
        crossed, size = crossed & inside, np.count_nonzero(inside)
    at_wall = [(slope[crossed] + np.roll(slope, -1, 2 - d)[crossed]) / np.float32(h)
               for slope, h in zip(slopes, edges, strict=True)]  # fmt: skip
    length = np.sqrt(at_wall[0] ** 2 + at_wall[1] ** 2 + at_wall[2] ** 2)
    normal = np.divide(np.abs(at_wall[d]), length, out=np.zeros_like(length), where=length > 0)
    return float(normal.sum(dtype=np.float64) / size / edges[d])


def _faces(
    levels: list[NDArray[np.float32]], theta: Callable[..., NDArray[Any]], edges: tuple[float, float, float],
    porosity: float, surface: float | None, mirrored: bool,
) -> Faces:  # fmt: skip
    """Neighbors, walls and weights of the faces of each family.

    Of a face beside a wall, whose unit normal is n and which cuts the way to a neighbor along axis a at ``theta h``,
    the balance of forces holds for the share ``1 - n_a^2 (1 - theta) / 2`` of a voxel, where flow is quadratic across.
    A mean over the fluid wants ``1 - n_a^2 ((1 - theta) / 2 - 1 / (12 theta))`` of it: beside the volume, each voxel
    misses 1/24 of the drag on it, which adds up to that of the walls. As all stays symmetric, and so do errors, with
    one weight for both, their mean, errors of second order at walls cancel.
    """
    active, walls, weights = [], [], []
    for d, here in enumerate(levels):
        passed = here > 0
        drag, weight = np.zeros(here.size, np.float32), passed.ravel().astype(np.float32)
        beyond = [[np.roll(here, step, 2 - axis) for step in (1, -1)] for axis in range(3)]
        # only faces beside a wall need distances: a thin layer, so arrays of indices are cheaper than whole grids
        near = np.flatnonzero(passed & ~np.all([there > 0 for pair in beyond for there in pair], axis=0))
        own = here.ravel()[near]
        ways = [[there.ravel()[near] for there in pair] for pair in beyond]
        slopes = [np.maximum(*(np.abs(own - there) for there in pair)) / h for pair, h in zip(ways, edges, strict=True)]
        steepest = slopes[0] ** 2 + slopes[1] ** 2 + slopes[2] ** 2
        for axis, pair in enumerate(ways):
            h = np.float32(edges[axis])
            for step, there, back in zip((1, -1), pair, reversed(pair), strict=True):
                wall = ~(there > 0)
                far = _shifted(here, near[wall], 2 - axis, -2 * step)
                bend = _smaller(back[wall] - 2 * own[wall] + there[wall], own[wall] - 2 * there[wall] + far)
                distance = np.maximum(theta(own[wall], there[wall], bend, axis == d), np.float32(_NEAREST))
                drag[near[wall]] += 1 / h**2 / distance
                across = ((own[wall] - there[wall]) / h) ** 2 / steepest[wall]
                weight[near[wall]] -= across * ((1 - distance) / 2 - 1 / (24 * distance))
        inside = _inside(here.shape, d) if mirrored else (...,)
        active.append(passed[inside])
        walls.append(drag.reshape(here.shape)[inside])
        weights.append(weight.reshape(here.shape)[inside])
    return Faces(tuple(active), tuple(walls), tuple(weights), edges, porosity, surface, mirrored)


def _shifted(values: NDArray[Any], at: NDArray[np.int64], axis: int, step: int) -> NDArray[Any]:
    """Values of a periodic grid, some steps along an axis from flat places."""
    places = list(np.unravel_index(at, values.shape))
    places[axis] = (places[axis] + step) % values.shape[axis]
    return np.asarray(values[tuple(places)])


def _smaller(a: NDArray[Any], b: NDArray[Any]) -> NDArray[Any]:
    """The one nearer to 0 of two curvatures, 0 if their signs differ: at a kink, the field is taken as linear."""
    return np.where(a * b > 0, np.where(np.abs(a) < np.abs(b), a, b), np.float32(0))


class Percolation(NamedTuple):
    """The part of a fluid that flows."""

    faces: Faces  # without pockets, the parts that wrap along no axis
    wraps: tuple[bool, bool, bool]  # along x, y, z: something is connected to its own periodic image
    pockets: int
    pocket_share: float  # share of the fluid's voxels and faces that is in pockets


def percolating(faces: Faces) -> Percolation:
    """Leave out pockets: a pressure balances whatever drives the fluid in them."""
    from sppm_pipeline.numerics import find_components, paint_runs

    voxels, mirrored = faces.voxels(), faces.mirrored
    nz, ny, nx = (2 * n + mirrored for n in voxels.shape)
    # voxels and the faces between them on one grid, where neighbors are connected
    joined = np.zeros((nz, ny, nx), np.uint8)
    # even places along an axis are its faces, odd ones in all three are voxels
    odd = slice(1, None, 2)
    joined[odd, odd, odd] = voxels
    places = [tuple(slice(0, None, 2) if axis == d else odd for axis in (2, 1, 0)) for d in range(3)]
    for place, active in zip(places, faces.active, strict=True):
        joined[place] = active
    found = find_components(joined, (not mirrored,) * 3)
    # what reaches two opposite mirrors meets its image behind each
    wraps = found.faces[:, 0::2] & found.faces[:, 1::2] if mirrored else found.wraps
    flows = np.asarray(wraps.any(axis=1))
    x, y, z = np.asarray(wraps.any(axis=0)).tolist()
    lost = 0.0
    if not flows.all():
        kept = np.zeros(joined.shape, np.int32)
        paint_runs(found.runs.rows, found.runs.bounds, flows[found.of_run].astype(np.int32), kept)
        flowing = tuple(kept[place] > 0 for place in places)
        walls, weights = (
            tuple(np.where(a, w, np.float32(0)) for a, w in zip(flowing, of, strict=True))
            for of in (faces.walls, faces.weights)
        )
        faces = faces._replace(active=flowing, walls=walls, weights=weights)
        lost = _counted(joined, mirrored) - _counted(kept, mirrored)
    share = lost / max(1.0, _counted(joined, mirrored))
    return Percolation(faces, (x, y, z), int((~flows).sum()), share)


def _counted(joined: NDArray[Any], mirrored: bool) -> float:
    """Voxels and faces, half of those that lie in mirrors."""
    if not mirrored:
        return float(np.count_nonzero(joined))
    ends = sum(np.count_nonzero(np.take(joined, (0, -1), axis)) for axis in range(3))
    return np.count_nonzero(joined) - 0.5 * ends
