"""Primitive bodies as inside tests: which samples of a grid a box, ball, cylinder, torus or torus knot holds.

The tests are exact up to rounding (a torus knot is a tube around a fine polygon), in contrast to the meshes of
`primitive_meshes`, which are inscribed. Each takes any part of a grid, so that layers can be made slab by slab. The
surface counts as inside.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.compiled import kernel
from sppm_pipeline.numerics.grid import Grid

__all__ = ["inside_ball", "inside_box", "inside_cylinder", "inside_torus", "inside_torus_knot", "torus_knot_curve"]

Point = tuple[float, float, float]


def _offsets(
    grid: Grid, centre: Point
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.uint8]]:
    """Coordinates of the samples relative to a centre, along x, y, z, and an empty occupancy."""
    x, y, z = (grid.axis(a) - centre[a] for a in range(3))
    return x, y, z, np.zeros(grid.shape[::-1], dtype=np.uint8)


def _positive(**lengths: float) -> None:
    for name, value in lengths.items():
        if not 0 < value < math.inf:
            raise ValueError(f"{name} is a positive length, not {value}")


def inside_box(grid: Grid, centre: Point, size: Point) -> NDArray[np.uint8]:
    """Samples inside an axis-aligned box.

    Parameters
    ----------
    grid : Grid
    centre : 3 floats
    size : 3 floats
        Edge lengths.

    Returns
    -------
    (nz, ny, nx) uint8
    """
    _positive(width=size[0], depth=size[1], height=size[2])
    x, y, z, out = _offsets(grid, centre)
    x_in, y_in, z_in = (np.abs(v) <= edge / 2 for v, edge in zip((x, y, z), size, strict=True))
    np.logical_and((z_in[:, None] & y_in)[:, :, None], x_in, out=out.view(np.bool_))
    return out


def inside_ball(grid: Grid, centre: Point, radius: float) -> NDArray[np.uint8]:
    """Samples inside a ball, (nz, ny, nx) uint8."""
    _positive(radius=radius)
    x, y, z, out = _offsets(grid, centre)
    _ball(x * x, y * y, z * z, radius * radius, out)
    return out


def inside_cylinder(grid: Grid, centre: Point, radius: float, height: float) -> NDArray[np.uint8]:
    """Samples inside an upright cylinder, (nz, ny, nx) uint8; its axis is along z, `centre` is its middle."""
    _positive(radius=radius, height=height)
    x, y, z, out = _offsets(grid, centre)
    out[np.abs(z) <= height / 2] = (x * x)[None, :] + (y * y)[:, None] <= radius * radius
    return out


def inside_torus(grid: Grid, centre: Point, radius: float, tube: float) -> NDArray[np.uint8]:
    """Samples inside a torus around the z axis, (nz, ny, nx) uint8.

    Parameters
    ----------
    grid : Grid
    centre : 3 floats
    radius : float
        From the centre to the middle of the tube.
    tube : float
        Radius of the tube.
    """
    _positive(radius=radius, tube=tube)
    x, y, z, out = _offsets(grid, centre)
    from_ring = (np.sqrt((x * x)[None, :] + (y * y)[:, None]) - radius) ** 2
    _sheet(from_ring, z * z, tube * tube, out)
    return out


def torus_knot_curve(turns: tuple[int, int], radius: float, swing: float, points: int) -> NDArray[np.float64]:
    """A closed curve that winds `turns[0]` times around the z axis and `turns[1]` times around the torus' ring.

    Parameters
    ----------
    turns : (int, int)
        Without a common divisor, so that the curve is one.
    radius, swing : float
        Radii of the torus on which the curve lies: of the ring, and of the tube around it.
    points : int
        Number of points; the last is not the first again.

    Returns
    -------
    (points, 3) float64
        Around the origin.

    Raises
    ------
    ValueError
        If the turns have a common divisor or are not positive, or if there are fewer than 3 points.
    """
    around, through = turns
    if min(turns) < 1 or math.gcd(around, through) != 1:
        raise ValueError(f"a torus knot has two positive numbers of turns without a common divisor, not {turns}")
    if points < 3:
        raise ValueError(f"a closed curve has at least 3 points, not {points}")
    _positive(radius=radius, swing=swing)
    t = np.arange(points) * (2 * np.pi / points)
    r = radius + swing * np.cos(through * t)
    return np.stack([r * np.cos(around * t), r * np.sin(around * t), swing * np.sin(through * t)], axis=1)


def inside_torus_knot(
    grid: Grid,
    centre: Point,
    turns: tuple[int, int] = (2, 3),
    radius: float = 1.0,
    swing: float = 0.4,
    tube: float = 0.2,
    points: int = 512,
) -> NDArray[np.uint8]:
    """Samples within a distance of a torus knot, (nz, ny, nx) uint8.

    Parameters
    ----------
    grid : Grid
    centre : 3 floats
    turns, radius, swing, points
        The curve, see `torus_knot_curve`. It is taken as a polygon.
    tube : float
        Radius of the tube.
    """
    _positive(tube=tube)
    curve = torus_knot_curve(turns, radius, swing, points)
    x, y, z, out = _offsets(grid, centre)
    ends = np.stack([curve, np.roll(curve, -1, axis=0)])
    # the samples that a piece of the tube can hold: (points, 3) first and last + 1 along each axis
    axes = (x, y, z)
    first = np.stack([np.searchsorted(v, ends[..., a].min(axis=0) - tube) for a, v in enumerate(axes)], axis=1)
    last = np.stack([np.searchsorted(v, ends[..., a].max(axis=0) + tube, "right") for a, v in enumerate(axes)], axis=1)
    _tube(ends, x, y, z, tube, first, last, out)
    return out


@kernel
def _ball(
    xx: NDArray[np.float64], yy: NDArray[np.float64], zz: NDArray[np.float64], limit: float, out: NDArray[np.uint8]
) -> None:
    for k in range(zz.size):
        for j in range(yy.size):
            rest = zz[k] + yy[j]
            if rest <= limit:
                row = out[k, j]
                for i in range(xx.size):
                    row[i] = xx[i] + rest <= limit


@kernel
def _sheet(sheet: NDArray[np.float64], zz: NDArray[np.float64], limit: float, out: NDArray[np.uint8]) -> None:
    for k in range(zz.size):
        if zz[k] <= limit:
            for j in range(sheet.shape[0]):
                row = out[k, j]
                for i in range(sheet.shape[1]):
                    row[i] = sheet[j, i] + zz[k] <= limit


@kernel
def _tube(
    ends: NDArray[np.float64],
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    z: NDArray[np.float64],
    radius: float,
    first: NDArray[np.int64],
    last: NDArray[np.int64],
    out: NDArray[np.uint8],
) -> None:
    limit = radius * radius
    for s in range(ends.shape[1]):
        p = ends[0, s]
        q = ends[1, s]
        ex, ey, ez = q[0] - p[0], q[1] - p[1], q[2] - p[2]
        scale = 1.0 / (ex * ex + ey * ey + ez * ez)
        for k in range(first[s, 2], last[s, 2]):
            dz = z[k] - p[2]
            for j in range(first[s, 1], last[s, 1]):
                dy = y[j] - p[1]
                row = out[k, j]
                for i in range(first[s, 0], last[s, 0]):
                    dx = x[i] - p[0]
                    t = min(max((dx * ex + dy * ey + dz * ez) * scale, 0.0), 1.0)
                    a, b, c = dx - t * ex, dy - t * ey, dz - t * ez
                    row[i] |= np.uint8(a * a + b * b + c * c <= limit)
