"""Rigid registration of two surfaces given by samples of fields: iterated nearest points, distances to planes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

MAX_POINTS = 20_000
"""Points that decide the motion; more do not change it beyond a hundredth of a voxel."""

MAX_ROUNDS = 60


class Surface(NamedTuple):
    """Points (n, 3), their outward normals (n, 3), and the area that each stands for (n,), in any unit."""

    points: F64
    normals: F64
    areas: F64


def surface_of(values: NDArray[np.float32], crossings: F64) -> Surface:
    """The surface of samples (z, y, x) at the points where lines of the grid cross it, (n, 3) x, y, z in its steps."""
    from scipy.ndimage import map_coordinates

    at = crossings[:, ::-1].T
    slopes = [map_coordinates(part, at, order=1, mode="nearest") for part in np.gradient(values.astype(np.float64))]
    normals = np.stack(slopes[::-1], 1)
    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
    # lines of the grid cross a surface as often as its normal leans towards all axes
    return Surface(crossings, normals, 1 / np.maximum(np.abs(normals).sum(1), 1e-9))


class Motion(NamedTuple):
    """``x -> turn (x - middle) + middle + shift``.

    Attributes
    ----------
    turn : (3, 3)
    shift, middle : (3,)
    """

    turn: F64
    shift: F64
    middle: F64

    def of(self, points: F64) -> F64:
        """Points (n, 3), moved."""
        return np.asarray((points - self.middle) @ self.turn.T + self.middle + self.shift)

    @property
    def angle(self) -> float:
        """Of the turn, degrees."""
        return float(np.degrees(np.arccos(np.clip((np.trace(self.turn) - 1) / 2, -1, 1))))


def registered(scan: Surface, design: Surface, far: float, threads: int = 1) -> tuple[Motion, F64, F64]:
    """The motion that lays the surface of a scan onto that of its design, distances afterwards, and their areas.

    Each round finds the nearest points of the design and moves the scan so that its distances to the planes there have
    the least squares about a common distance (Chen and Medioni 1992), as surfaces that grew everywhere are no motion.
    Distances (m,) are positive outside of the design, of up to `far`, in the unit of the points.
    """
    from scipy.spatial import cKDTree

    tree = cKDTree(design.points)
    middle = scan.points.mean(0)
    motion = Motion(np.eye(3), np.zeros(3), middle)
    step = max(1, len(scan.points) // MAX_POINTS)
    points, areas = scan.points[::step], scan.areas[::step]
    normals = scan.normals[::step]
    for _ in range(MAX_ROUNDS):
        moved = motion.of(points)
        away, plane, fits = _distances(tree, design, moved, normals @ motion.turn.T, far, threads)
        w = np.sqrt(areas[fits])
        arm = moved[fits] - (middle + motion.shift)
        system = np.hstack([plane, np.cross(arm, plane), -np.ones((len(plane), 1))])
        found = np.linalg.lstsq(system * w[:, None], -away * w, rcond=None)[0]
        motion = Motion(_turn(found[3:6]) @ motion.turn, motion.shift + found[:3], middle)
        if np.linalg.norm(found[:3]) + np.linalg.norm(found[3:6]) * far < 1e-5 * far:
            break
    away, _, fits = _distances(tree, design, motion.of(scan.points), scan.normals @ motion.turn.T, far, threads)
    return motion, away, scan.areas[fits]


def _distances(
    tree: object, design: Surface, points: F64, normals: F64, far: float, threads: int
) -> tuple[F64, F64, NDArray[np.bool_]]:
    """Distances to the planes at the nearest points, these planes' normals, and which points have any that fits."""
    away, nearest = tree.query(points, workers=threads)  # type: ignore[attr-defined]
    planes = design.normals[nearest]
    # another side of a thin wall is no partner
    fits = (away < far) & ((planes * normals).sum(1) > 0.5)
    along = ((points - design.points[nearest]) * planes).sum(1)
    return along[fits], planes[fits], fits


def _turn(vector: F64) -> F64:
    """The rotation by a vector (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross)
