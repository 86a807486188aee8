"""Statistics of the two phases of an image: two-point curves, chords, lineal path, Minkowski numbers and fabric.

What can be is counted from the runs of the image along x, y and z: a pair of runs is the source of a trapezoid of pairs
of points over their distance, so that curves along the axes take no longer than one look at each voxel.
"""

from __future__ import annotations

import math
from functools import cache
from itertools import pairwise, product
from typing import Any, NamedTuple

import numpy as np

from sppm_pipeline.numerics import inline_jit, jit
from sppm_pipeline.services.arrays import F64, I32, I64, Bools
from sppm_pipeline.services.union_find import find_root

DIRECTIONS = ((1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, -1, 0), (1, 0, 1), (1, 0, -1), (0, 1, 1), (0, 1, -1),
              (1, 1, 1), (1, 1, -1), (1, -1, 1), (1, -1, -1))  # fmt: skip
"""The thirteen directions from a voxel to its neighbors."""


TILE = 16
"""Edge of the squares by which planes are transposed: a line of the cache has so many labels."""


class Lines(NamedTuple):
    """Curves (m,) along an axis over distances 0, 1, 2 ... voxels, and chords (n + 1,)."""

    pairs: F64  # two-point probability S2: both ends lie in the phase
    cluster: F64  # both ends lie in one connected part of it
    path: F64  # lineal path: the whole line lies in it
    chords: F64  # number of runs by length, those that a side cuts off left out


def along_axis(labels: I32, axis: int, distances: int, wraps: bool) -> Lines:
    """Curves along an axis of a phase with labels (z, y, x), 0 outside; `wraps` says whether opposite sides meet."""
    rows = labels
    if axis:
        planes = labels if axis == 1 else np.moveaxis(labels, 1, 0)
        rows = np.empty((len(planes), planes.shape[2], planes.shape[1]), np.int32)
        _transpose(planes, rows)
    n = rows.shape[2]
    counts, chords = np.zeros((3, distances + 3)), np.zeros(n + 1)
    _count_lines(rows.reshape(-1, n), distances, wraps, counts, chords)
    # second differences of trapezoids were noted
    curves = np.cumsum(np.cumsum(counts, axis=1), axis=1)[:, : distances + 1]
    places = rows.size / n * (np.full(distances + 1, float(n)) if wraps else n - np.arange(distances + 1.0))
    pairs, cluster, path = curves / np.maximum(places, 1)
    return Lines(pairs, cluster, path, chords)


@jit
def _transpose(planes: I32, rows: I32) -> None:
    """Transpose each plane (m, n) into rows (n, m), by squares that fit the processor's cache."""
    count, m, n = planes.shape
    for k in range(count):
        for j in range(0, m, TILE):
            for i in range(0, n, TILE):
                for b in range(i, min(i + TILE, n)):
                    for a in range(j, min(j + TILE, m)):
                        rows[k, b, a] = planes[k, a, b]


@inline_jit
def _trapezoid(counts: F64, a: int, b: int, c: int, d: int) -> None:
    """Note the pairs of a point in [a, b) and one in [c, d) by their distance, of which none is negative.

    Their number rises by one for each distance from c - b + 1 on, stays, and falls again.
    """
    last = len(counts) - 1
    for at, sign in ((c - b, 1.0), (c - a, -1.0), (d - b, -1.0), (d - a, 1.0)):
        # the number at distance r is the sum of max(0, r - at) over these; it shows one later
        if at + 1 <= last:
            counts[at + 1] += sign


@inline_jit
def _half(counts: F64, length: int) -> None:
    """Note the pairs of a point of a run and one that is not before it: length - r of them at the distance r."""
    counts[0] += length
    counts[1] -= length + 1
    if length + 1 < len(counts):
        counts[length + 1] += 1.0


@jit
def _count_lines(rows: I32, distances: int, wraps: bool, counts: F64, chords: F64) -> None:
    n = rows.shape[1]
    starts, ends, of = np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n, np.int32)
    for row in rows:
        found = 0
        for i in range(n):
            label = row[i]
            if label != 0:
                if i == 0 or row[i - 1] != label:
                    starts[found], of[found] = i, label
                    found += 1
                ends[found - 1] = i + 1
        if found == 0:
            continue
        whole = found == 1 and ends[0] - starts[0] == n
        if whole and wraps:
            for r in range(3):  # the same at all distances
                counts[r, 0] += n
                counts[r, 1] -= n
            continue
        joined = wraps and starts[0] == 0 and ends[found - 1] == n and of[0] == of[found - 1]
        for a in range(found):
            length = ends[a] - starts[a]
            if not (joined and a == 0):
                longer = length + ends[0] if joined and a == found - 1 else length
                if wraps or (starts[a] > 0 and ends[a] < n):
                    chords[longer] += 1
                _half(counts[2], longer)
            _half(counts[0], length)
            _half(counts[1], length)
            for b in range(a + 1, found):
                if starts[b] - ends[a] >= distances:
                    break
                _trapezoid(counts[0], starts[a], ends[a], starts[b], ends[b])
                if of[a] == of[b]:
                    _trapezoid(counts[1], starts[a], ends[a], starts[b], ends[b])
            if wraps:
                # the runs of the next period, as far as they are not too far away
                for b in range(found):
                    if starts[b] + n - ends[a] >= distances:
                        break
                    _trapezoid(counts[0], starts[a], ends[a], starts[b] + n, ends[b] + n)
                    if of[a] == of[b]:
                        _trapezoid(counts[1], starts[a], ends[a], starts[b] + n, ends[b] + n)


def radial_pairs(phase: Bools, distances: int, wraps: bool) -> tuple[F64, F64, F64]:
    """S2 in all directions: mean distances of shells at 0, 1, 2 ... voxels, its mean over each, and that of the rest.

    By the Fourier transform, padded where nothing wraps. Both ends lie in the rest unless one is in the phase.
    """
    from scipy.fft import irfftn, next_fast_len, rfftn

    reach = [distances if n > 1 else 0 for n in phase.shape]
    shape = phase.shape if wraps else tuple(next_fast_len(n + r, True) for n, r in zip(phase.shape, reach, strict=True))
    image = np.zeros(shape, np.float32)
    image[tuple(slice(n) for n in phase.shape)] = phase
    spectrum = rfftn(image, overwrite_x=True)
    del image
    np.multiply(spectrum, spectrum.conj(), out=spectrum)
    pairs = irfftn(spectrum, shape, overwrite_x=True)
    del spectrum
    offsets = [np.r_[0 : r + 1, -r:0] for r in reach]
    ends = _ends(phase, offsets, wraps)
    ends = (ends + ends[np.ix_(*(-at % len(at) for at in offsets))])[: reach[0] + 1]
    # a step and the way back are one pair: half of all offsets will do
    offsets[0] = offsets[0][: reach[0] + 1]
    near = pairs[np.ix_(*offsets)]
    sizes = zip(offsets, phase.shape, strict=True)
    places = [np.full(len(at), n, float) if wraps else n - np.abs(at) for at, n in sizes]
    squares = [at.astype(np.float64) ** 2 for at in offsets]
    length = np.sqrt(squares[0][:, None, None] + squares[1][:, None] + squares[2])
    count = places[0][:, None, None] * places[1][:, None] * places[2]
    probability = near / count
    # shares of two shells, so that the curve has no steps
    shell = np.floor(length).astype(np.int64)
    inside = shell < distances
    rest = 1 + probability - ends / count
    number, share = shell[inside], (length - shell)[inside]
    twice = np.broadcast_to(np.where(offsets[0] > 0, 2.0, 1.0)[:, None, None], shell.shape)[inside]
    sums = np.zeros((4, distances + 1))
    for add, part in ((0, twice * (1 - share)), (1, twice * share)):
        for row, value in enumerate((1.0, length[inside], probability[inside], rest[inside])):
            sums[row] += np.bincount(number + add, part * value, distances + 1)
    _, at, own, other = sums / np.maximum(sums[0], 1e-300)
    return at, own, other


def _ends(phase: Bools, offsets: list[I64], wraps: bool) -> F64:
    """Voxels of the phase from which a step by each offset ends in the image."""
    if wraps:
        return np.full([len(at) for at in offsets], float(np.count_nonzero(phase)))
    ends = [(np.maximum(0, -at), n - np.maximum(0, at)) for at, n in zip(offsets, phase.shape, strict=True)]
    sums: Any = phase.T
    for axis, pair in enumerate(ends):  # sums up to the ends of steps alone
        used, places = np.unique(np.concatenate(pair), return_inverse=True)
        layers = np.moveaxis(sums, 2 - axis, 0)
        below = np.zeros((len(used), *layers.shape[1:]), np.int32)
        for number, (low, high) in enumerate(pairwise([0, *used.tolist()])):
            below[number] = below[number - 1] + layers[low:high].sum(axis=0, dtype=np.int32)
        sums = np.moveaxis(below, 0, 2 - axis)
        ends[axis] = (places[: len(pair[0])], places[len(pair[0]) :])
    sums = sums.T
    found = np.zeros([len(at) for at in offsets])
    for at in np.ndindex(2, 2, 2):
        found += (1 if sum(at) % 2 else -1) * sums[np.ix_(*(end[i] for end, i in zip(ends, at, strict=True)))]
    return found


def configurations(phase: Bools, wraps: bool) -> I64:
    """How often each pattern of 2 x 2 x 2 voxels occurs, (256,); bit i + 2 j + 4 k is the voxel at (i, j, k).

    Without `wraps`, patterns lie inside of the image (x, y, z), of which x is contiguous at best.
    """
    if wraps:
        phase = np.asfortranarray(np.pad(phase, ((0, 1),) * 3, mode="wrap"))
    nx, ny, nz = (n - 1 for n in phase.shape)
    found = np.zeros(256, np.int64)
    bits = phase.T.view(np.uint8)
    for start in range(0, nz, 16):
        stop = min(start + 16, nz)
        code = np.zeros((stop - start, ny, nx), np.uint8)
        for bit in range(8):
            i, j, k = bit & 1, bit >> 1 & 1, bit >> 2
            code |= bits[start + k : stop + k, j : j + ny, i : i + nx] << np.uint8(bit)
        found += np.bincount(code.ravel(), minlength=256)
    return found


class Minkowski(NamedTuple):
    """Densities per volume of the image."""

    volume: float  # share of the phase
    surface: float  # area by the Cauchy-Crofton formula over thirteen directions
    curvature: float  # integral of the mean curvature, from the Euler numbers of sections along the axes
    euler: float  # parts touch across faces, as everywhere in this program


def minkowski(counts: I64, spacing: tuple[float, float, float]) -> Minkowski:
    """Minkowski numbers from the counts of patterns; Ohser and Mücklich 2000, "Statistical Analysis of Microstructures
    in Materials Science". Lengths are in the unit of `spacing`.
    """
    number = float(counts.sum())
    cell = math.prod(spacing)
    codes = np.arange(256)
    bits = np.array([codes >> b & 1 for b in range(8)], bool)
    # voxels of a pattern around each half of an edge, and on both sides of each quarter of a face
    edges = [[b for b in range(8) if b >> axis & 1 == side] for axis in range(3) for side in range(2)]
    faces = [[b, b | 1 << axis] for axis in range(3) for b in range(8) if not b >> axis & 1]

    def euler(x: Bools) -> F64:
        """Of the union of closed voxels: corners less edges plus faces less voxels, by their share of the pattern."""
        corner = x.any(0).astype(float)
        half = sum(x[four].any(0).astype(float) for four in edges)
        quarter = sum(x[two].any(0).astype(float) for two in faces)
        return np.asarray(corner - half / 2 + quarter / 4 - x.mean(0))

    # the complement of a body whose parts touch across faces is closed; both have the same Euler number in space
    chi = euler(~bits)
    bend = 0.0
    for axis in range(3):
        void = ~bits[edges[2 * axis]]  # a section, voxels numbered along the two other axes
        sides = sum(void[list(two)].any(0).astype(float) for two in ((0, 1), (2, 3), (0, 2), (1, 3)))
        flat = void.any(0).astype(float) - sides / 2 + void.mean(0)
        # in a plane the Euler number of the complement has the other sign
        area = cell / spacing[axis]
        bend += 2 * math.pi / 3 * float(counts @ -flat) / (number * area)
    crossings, weights = crossing_rates(counts, spacing), _weights(spacing)
    return Minkowski(share_of(counts), 2 * float(crossings @ weights), bend, float(counts @ chi) / (number * cell))


def crossing_rates(counts: I64, spacing: tuple[float, float, float]) -> F64:
    """Changes of phase for each length of a line along the thirteen directions, (13,)."""
    codes, number = np.arange(256), float(counts.sum())
    rates = []
    for step in DIRECTIONS:
        first = [b for b in range(8) if all(0 <= (b >> a & 1) + step[a] <= 1 for a in range(3))]
        moved = [b + step[0] + 2 * step[1] + 4 * step[2] for b in first]
        differ = sum(((codes >> a ^ codes >> b) & 1) for a, b in zip(first, moved, strict=True)) / len(first)
        rates.append(float(counts @ differ) / number / math.dist((0, 0, 0), np.array(step) * spacing))
    return np.array(rates)


@cache
def _weights(spacing: tuple[float, float, float]) -> F64:
    """Share of the sphere that is nearest to each of the thirteen directions, counted on 20000 points."""
    k = np.arange(20000) + 0.5
    z, turn = 1 - 2 * k / 20000, np.pi * (1 + 5**0.5) * k
    points = np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], 1)
    lines = np.array(DIRECTIONS) * spacing
    lines = lines / np.linalg.norm(lines, axis=1)[:, None]
    nearest = np.abs(points @ lines.T).argmax(1)
    return np.asarray(np.bincount(nearest, minlength=13) / 20000.0)


def fabric(counts: I64, spacing: tuple[float, float, float]) -> tuple[F64, F64]:
    """Mean intercept lengths along the axes of the ellipsoid that fits them best, and these axes, longest first.

    The mean length along a direction is twice the share of the phase over the changes of phase (Harrigan and Mann
    1984); ``1 / length^2 = n H n`` is fitted by least squares over thirteen directions.
    """
    rates = crossing_rates(counts, spacing)
    share = share_of(counts)
    if not (rates > 0).all() or not share:
        return np.full(3, np.nan), np.eye(3)
    n = np.array(DIRECTIONS) * spacing
    n = n / np.linalg.norm(n, axis=1)[:, None]
    x, y, z = n.T
    square = (rates / (2 * share)) ** 2
    system = np.stack([x * x, y * y, z * z, 2 * y * z, 2 * x * z, 2 * x * y], 1)
    # relative errors count
    h = np.linalg.lstsq(system / square[:, None], np.ones(13), rcond=None)[0]
    values, axes = np.linalg.eigh(np.array([[h[0], h[5], h[4]], [h[5], h[1], h[3]], [h[4], h[3], h[2]]]))
    return np.where(values > 0, 1 / np.sqrt(np.maximum(values, 1e-300)), np.inf), axes.T


def share_of(counts: I64) -> float:
    """Share of the phase in the patterns."""
    return float(counts @ np.array([c.bit_count() for c in range(256)])) / (8 * float(counts.sum()))


def entry_sizes(squared: I32) -> I32:
    """The largest ball, as a squared radius, whose center reaches each voxel (z, y, x) from a side of the image.

    What a wetting or invading fluid decides: of all ways from the sides the widest, in its narrowest place. Voxels are
    taken from the widest place down and joined to their neighbors until they meet the sides.
    """
    flat = squared.ravel()
    # short numbers are sorted by their digits
    falling = -flat if flat.max(initial=0) > 65535 else (65535 - flat).astype(np.uint16)
    order = np.argsort(falling, kind="stable")
    order = order[: int(np.count_nonzero(flat))]
    out = np.zeros(flat.size, np.int32)
    _flood(order, flat, squared.shape[0], squared.shape[1], squared.shape[2], out)
    return out.reshape(squared.shape)


@jit
def _flood(order: I64, squared: I32, nz: int, ny: int, nx: int, out: I32) -> None:
    """Join voxels in order; a part that meets the sides gives its size to all it holds, which are kept in lists."""
    size = squared.size
    parent = np.full(size, -1, np.int32)
    following = np.full(size, -1, np.int32)  # the next voxel of a part that has not met the sides
    last = np.arange(size).astype(np.int32)
    open_ = np.zeros(size, np.uint8)
    for at in order:
        k, j, i = at // (ny * nx), at // nx % ny, at % nx
        level = squared[at]
        parent[at] = at
        outside = k == 0 or j == 0 or i == 0 or k == nz - 1 or j == ny - 1 or i == nx - 1
        if outside:
            open_[at] = 1
            out[at] = level
        for side in range(6):
            axis, step = side // 2, side % 2 * 2 - 1
            z, y, x = k + step * (axis == 0), j + step * (axis == 1), i + step * (axis == 2)
            if z < 0 or y < 0 or x < 0 or z >= nz or y >= ny or x >= nx:
                continue
            other = (z * ny + y) * nx + x
            if parent[other] < 0:
                continue
            a, b = find_root(parent, at), find_root(parent, other)
            if a == b:
                continue
            if open_[a] != open_[b]:
                closed = b if open_[a] else a
                one = closed
                while one >= 0:
                    out[one] = level
                    one = following[one]
                if open_[a] == 0:
                    a, b = b, a
            elif open_[a] == 0:
                following[last[a]] = b
                last[a] = last[b]
            parent[b] = a


def blocks_of(shape: tuple[int, ...], parts: int) -> list[tuple[slice, ...]]:
    """Equal blocks of an image, `parts` along each axis."""
    ends = [np.linspace(0, n, parts + 1).astype(int) for n in shape]
    return list(product(*([slice(a, b) for a, b in pairwise(cuts)] for cuts in ends)))
