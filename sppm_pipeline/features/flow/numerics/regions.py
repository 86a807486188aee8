"""The pore network of an image: its void is parted by a watershed of the distance to the walls (SNOW: Gostick 2017)."""

from __future__ import annotations

from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics import inline_jit, jit

SMOOTHED = 0.4
"""Standard deviation, in voxels, of the Gaussian that makes less of the steps of distances, as in SNOW."""

REACH = 4
"""Voxels around a pore without a larger distance, as in SNOW."""


class Regions(NamedTuple):
    """Pores, their throats, and the openings of the image, which are pores, too; lengths in the unit of the spacing."""

    coords: NDArray[np.float64]  # (n, 3), from the corner of the image: where a ball is largest; openings come last
    radius: NDArray[np.float64]  # of this ball, (n,)
    volume: NDArray[np.float64]  # (n,), 0 of openings
    conns: NDArray[np.int64]  # (t, 2), the lower index first
    throat: NDArray[np.float64]  # radius of the largest ball in each, (t,)
    size_factor: NDArray[np.float64]  # flux times viscosity over the drop of pressure, (t,): pi / 8 / integral ds / r^4


def parted(void: NDArray[np.bool_], spacing: tuple[float, ...]) -> tuple[NDArray[np.int32], NDArray[Any]]:
    """Regions (x, y, z) of the void from 1 on, one of each pore, and distances to the solid.

    Pores are where the distance is largest within `REACH` voxels, unless that is nearer to a larger one than to a wall.
    """
    from scipy.ndimage import center_of_mass, distance_transform_edt, gaussian_filter, label, maximum_filter
    from scipy.spatial import KDTree

    distance = distance_transform_edt(void, sampling=spacing)
    smooth = gaussian_filter(distance, SMOOTHED) * void
    around = np.indices((2 * REACH + 1,) * 3) - REACH
    peaks = (smooth == maximum_filter(smooth, footprint=(around**2).sum(axis=0) <= REACH**2)) & void
    labels, count = label(peaks, np.ones((3, 3, 3)))
    places = np.array(center_of_mass(peaks, labels, np.arange(1, count + 1))).reshape(-1, 3)
    size = distance[tuple(places.astype(int).T)] + 1e-6 * np.arange(count) * min(spacing)
    if count > 1:
        far, near = KDTree(places * spacing).query(places * spacing, k=2)
        close = np.flatnonzero(far[:, 1] <= size)
        smaller = np.where(size[close] < size[near[close, 1]], close, near[close, 1])
        labels[np.isin(labels, smaller + 1)] = 0
    markers, _ = label(labels > 0, np.ones((3, 3, 3)))
    order = np.argsort(-distance, axis=None, kind="stable")[: np.count_nonzero(void)]
    regions = np.zeros(void.shape, np.int32)
    join_down(order, distance, markers.astype(np.int32), regions)
    return regions, distance


@inline_jit
def _root(parent: NDArray[np.int32], at: int) -> int:
    while parent[at] != at:
        parent[at] = parent[parent[at]]
        at = parent[at]
    return at


@jit
def join_down(
    order: NDArray[np.int64], distance: NDArray[np.float64], markers: NDArray[np.int32], out: NDArray[np.int32]
) -> None:
    """A watershed: of voxels (flat, from the largest distance down) each joins its deepest neighbor's region.

    What no marker lies in becomes part of the first region that it meets; all arrays but `order` are (x, y, z).
    """
    nx, ny, nz = distance.shape
    deep, label = distance.ravel(), markers.ravel().copy()
    parent = np.full(deep.size, -1, np.int32)
    for at in order:
        i, j, k = at // (ny * nz), at // nz % ny, at % nz
        parent[at] = at
        steps = ((i > 0, -ny * nz), (i < nx - 1, ny * nz), (j > 0, -nz), (j < ny - 1, nz), (k > 0, -1), (k < nz - 1, 1))
        for _ in range(6):
            best, depth = -1, -1.0
            for there, step in steps:  # the deepest first, of which the root is not its own yet
                if there and parent[at + step] >= 0 and deep[at + step] > depth:
                    a, b = _root(parent, at), _root(parent, at + step)
                    if a != b and (label[a] == 0 or label[b] == 0):
                        best, depth = at + step, deep[at + step]
            if best < 0:
                break
            a, b = _root(parent, at), _root(parent, best)
            label[b] = max(label[a], label[b])
            parent[a] = b
    flat = out.ravel()
    for at in order:
        flat[at] = label[_root(parent, at)]


def regions_of(void: NDArray[np.bool_], spacing: tuple[float, ...]) -> Regions:
    """The network of the void (x, y, z) of an image of voxels of these edges; its sides are open."""
    from scipy.ndimage import map_coordinates, maximum_position

    regions, distance = parted(void, spacing)
    count, h = int(regions.max(initial=0)), np.array(spacing)
    centers = np.array(maximum_position(distance, regions, np.arange(1, count + 1))).reshape(-1, 3)
    radius, number = distance[tuple(centers.astype(int).T)], np.bincount(regions.ravel(), minlength=count + 1)[1:]
    found = []  # both regions, the place of the face between them, and the distance there
    for axis in range(3):
        low, high = (np.moveaxis(regions, axis, 0)[part] for part in (slice(-1), slice(1, None)))
        deep = np.moveaxis(distance, axis, 0)
        at = np.nonzero((low != high) & (low > 0) & (high > 0))
        place = np.stack(at, 1).astype(np.float64)
        place[:, 0] += 0.5
        order = [[0, 1, 2], [1, 0, 2], [1, 2, 0]][axis]
        found.append((np.sort(np.stack([low[at], high[at]], 1) - 1, axis=1), place[:, order],
                      (deep[:-1][at] + deep[1:][at]) / 2))  # fmt: skip
    openings: list[NDArray[Any]] = []
    touched: list[tuple[Any, ...]] = []
    for axis, side in product(range(3), (0, -1)):
        face, deep = (np.moveaxis(of, axis, 0)[side] for of in (regions, distance))
        own = np.unique(face[face > 0])
        for region, (a, b) in zip(own, maximum_position(deep, face, own) if len(own) else (), strict=True):
            openings.append(np.insert([float(a), float(b)], axis, -0.5 if side == 0 else void.shape[axis] - 0.5))
            touched.append((region - 1, count + len(touched), deep[a, b]))
    pairs, places, depths = (np.concatenate(part) for part in zip(*found, strict=True))
    first_of = np.lexsort((-depths, pairs[:, 1], pairs[:, 0]))  # the largest ball of each pair first
    conns, first = np.unique(pairs[first_of], axis=0, return_index=True)
    ends = np.array(openings).reshape(-1, 3)
    sides = np.array(touched).reshape(-1, 3)
    nodes, middle = np.concatenate([centers, ends]), np.concatenate([places[first_of][first], ends])
    conns = np.concatenate([conns, sides[:, :2].astype(np.int64)]).astype(np.int64)
    throat = np.concatenate([depths[first_of][first], sides[:, 2]])
    resistance = np.zeros(len(conns))
    for end in range(2):  # from a pore to the throat, by the balls on the way, none smaller than the throat's
        step = middle - nodes[conns[:, end]]
        length = np.linalg.norm(step * h, axis=1)
        slices = np.maximum(1, np.ceil(2 * length / h.min())).astype(np.int64)
        of = np.repeat(np.arange(len(slices)), slices)
        share = (np.arange(slices.sum()) - (np.cumsum(slices) - slices)[of] + 0.5) / slices[of]
        there = nodes[conns[of, end]] + share[:, None] * step[of]
        ball = np.maximum(map_coordinates(distance, there.T, order=1, mode="nearest"), throat[of])
        resistance += np.bincount(of, ball**-4.0, len(slices)) * length / slices
    return Regions(
        (nodes + 0.5) * h, np.concatenate([radius, sides[:, 2]]),
        np.concatenate([number * h.prod(), np.zeros(len(ends))]), conns, throat,
        np.pi / 8 / resistance,
    )  # fmt: skip
