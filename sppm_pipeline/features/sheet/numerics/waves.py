"""Periodic fields of few waves: relaxed until their zero is nearly a minimal surface, and summed at any point.

A field is ``f(p) = Re sum_k c_k exp(2 pi i k . p)`` over integer vectors k of nearly one length, a band.
It is relaxed by steps of ``f <- band(tanh(2 f / rms f))``, as in the equation of Swift and Hohenberg (1977): tanh draws
f to two values with a thin layer between them, and the band allows only layers at equal distances.

A field of few waves has directions that it prefers by chance. The weights of its waves are therefore corrected in each
step so that the moments of second and fourth order of their directions are those of all directions alike. The
stiffness, a tensor of fourth order, then hardly depends on the direction.

Pores in two colors, each of them one connected network.

Which pores are neighbors is given as pairs. Half of the pores are of either color; neighbors of different colors are
exchanged as long as that brings both nearer to the share of neighbors of their own color that they should have. A few
pores that are left without a way to the others of their color take the color around them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.arrays import F64, I64
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.union_find import find_root, unite

OWN_SHARE = 0.42
"""Share of a pore's neighbors that are of its own color: with less, networks break up, with more they clump."""

_SWEEPS = 30
"""Tries to exchange each pore; most settle within ten."""


def two_networks(pairs: I64, count: int, rng: np.random.Generator) -> NDArray[np.int8]:
    """Colors 1 and -1 of so many pores, (count,), of which each is one network, where the neighbors (m, 2) allow it.

    Pores that are not connected by neighbors have networks of their own, two in each part.
    """
    colors = np.ones(count, np.int8)
    colors[rng.permutation(count)[: count // 2]] = -1
    ends = np.concatenate([pairs, pairs[:, ::-1]])
    order = np.argsort(ends[:, 0], kind="stable")
    first = np.concatenate([[0], np.cumsum(np.bincount(ends[:, 0], minlength=count))]).astype(np.int64)
    neighbors = np.ascontiguousarray(ends[order, 1], np.int64)
    for _ in range(_SWEEPS):
        choice = rng.random((count, 2))
        if not _exchange(first, neighbors, colors, rng.permutation(count), choice[:, 0].copy(), OWN_SHARE):
            break
    _unite_colors(first, neighbors, colors)
    return colors


@jit
def _excess(first: I64, neighbors: I64, colors: NDArray[np.int8], i: int, share: float) -> float:
    """Square of what a pore has more or less than its share of neighbors of its own color."""
    degree, own = first[i + 1] - first[i], 0
    for k in range(first[i], first[i + 1]):
        if colors[neighbors[k]] == colors[i]:
            own += 1
    if degree == 0:
        return 0.0
    off: float = own / degree - share
    return off * off


@jit
def _around(first: I64, neighbors: I64, colors: NDArray[np.int8], i: int, j: int, share: float) -> float:
    """Sum of `_excess` over two pores and their neighbors; who is a neighbor of both counts twice, before and after."""
    total = _excess(first, neighbors, colors, i, share) + _excess(first, neighbors, colors, j, share)
    for k in range(first[i], first[i + 1]):
        total += _excess(first, neighbors, colors, neighbors[k], share)
    for k in range(first[j], first[j + 1]):
        total += _excess(first, neighbors, colors, neighbors[k], share)
    return total


@jit
def _exchange(first: I64, neighbors: I64, colors: NDArray[np.int8], order: I64, choice: F64, share: float) -> int:
    """One try for each pore to exchange its color with a neighbor; how many did."""
    changed = 0
    for i in order:
        degree = first[i + 1] - first[i]
        if degree == 0:
            continue
        j = neighbors[first[i] + min(int(choice[i] * degree), degree - 1)]
        if colors[i] == colors[j]:
            continue
        before = _around(first, neighbors, colors, i, j, share)
        colors[i], colors[j] = colors[j], colors[i]
        if _around(first, neighbors, colors, i, j, share) < before:
            changed += 1
        else:
            colors[i], colors[j] = colors[j], colors[i]
    return changed


@jit
def _unite_colors(first: I64, neighbors: I64, colors: NDArray[np.int8]) -> None:
    """Give all but the largest part of each color, among connected pores, the other color, until none is left.

    What turns joins the parts around it, and leaves the largest of its color whole, so there are fewer parts each time.
    """
    n = len(colors)
    parent, body = np.empty(n, np.int64), np.empty(n, np.int64)
    size, largest = np.empty(n, np.int64), np.empty((n, 2), np.int64)
    for i in range(n):
        body[i] = i
    for i in range(n):
        for k in range(first[i], first[i + 1]):
            unite(body, i, neighbors[k])
    turned = True
    while turned:
        turned = False
        for i in range(n):
            parent[i], size[i], largest[i, 0], largest[i, 1] = i, 0, -1, -1
        for i in range(n):
            for k in range(first[i], first[i + 1]):
                if colors[neighbors[k]] == colors[i]:
                    unite(parent, i, neighbors[k])
        for i in range(n):
            size[find_root(parent, i)] += 1
        for i in range(n):
            if find_root(parent, i) == i:
                whole, side = find_root(body, i), 0 if colors[i] < 0 else 1
                best = largest[whole, side]
                if best < 0 or size[i] > size[best]:
                    largest[whole, side] = i
        color = 0  # of one color at a time: two small parts side by side would only change places
        for i in range(n):
            root = find_root(parent, i)
            whole = find_root(body, i)
            if root != largest[whole, 0] and root != largest[whole, 1] and (color == 0 or colors[i] == color):
                color = colors[i]
                colors[i] = -colors[i]
                turned = True


_LEAST = 1e-3
"""Weight of the band below which waves are left out."""

_GAIN = 2.0
"""Slope of tanh at zero for a field of variance 1: the larger, the more two values are preferred."""

_CORRECTION = 4.0
"""Factor by which the power of a wave is changed at most in a step."""

_DIGITS = 30
"""Bits behind the point of the amplitudes: fewer than the rounding of a Fourier transform leaves right."""


class Waves(NamedTuple):
    """Amplitudes ``c_k = real + i imaginary`` by kx, ky + K, kz + K, as far as the largest K: (K + 1, 2K + 1, 2K + 1).

    Waves with kx > 0 stand for their opposites, too.
    """

    real: F64
    imaginary: F64


class Relaxed(NamedTuple):
    """A relaxed field of variance 1; samples of it and of the length of its gradient, (n, n, n), at i / n."""

    waves: Waves
    samples: F64
    slopes: F64


def band_of(wavenumber: float, width: float, metric: F64) -> tuple[I64, F64]:
    """Integer wave vectors (m, 3) near a sphere, one of each opposite pair, and weights ``exp(-(k / k0 - 1)^2 / w^2)``.

    `metric` (3, 3) is a matrix F by which the structure is stretched: its waves k have the length of ``F^T k``.
    """
    reach = wavenumber * (1 + width * math.sqrt(-math.log(_LEAST)))
    most = math.floor(reach * float(np.linalg.norm(np.linalg.inv(metric), 2)))
    axis = np.arange(-most, most + 1)
    every = np.stack(np.meshgrid(np.arange(most + 1), axis, axis, indexing="ij"), -1).reshape(-1, 3)
    x, y, z = every.T
    every = every[(x > 0) | (y > 0) | ((y == 0) & (z > 0))]
    lengths = np.linalg.norm(every @ metric, axis=1)
    weights = np.exp(-(((lengths / wavenumber - 1) / width) ** 2))
    kept = weights >= _LEAST
    return every[kept], weights[kept]


def moments_of(vectors: F64) -> F64:
    """The 15 monomials of fourth order of directions (m, 3) less their mean over all directions, (15, m)."""
    unit = vectors / np.linalg.norm(vectors, axis=1)[:, None]
    rows = []
    for a in range(5):
        for b in range(5 - a):
            powers = (a, b, 4 - a - b)
            # mean over the sphere: 1/5 for x^4, 1/15 for x^2 y^2, 0 where a power is odd
            mean = 0.0 if any(p % 2 for p in powers) else (0.2 if 4 in powers else 1 / 15)
            rows.append(np.prod(unit ** np.array(powers), axis=1) - mean)
    return np.array(rows)


def with_isotropic_power(amplitudes: NDArray[np.complex128], moments: F64) -> NDArray[np.complex128]:
    """Waves whose power has moments of zero, by the least change in proportion; each power changes within a factor."""
    power = np.abs(amplitudes) ** 2
    weighted = moments * power
    # one of the moments follows from the others: the matrix is singular
    found = np.linalg.lstsq(np.einsum("ik,jk->ij", weighted, moments), weighted.sum(1), rcond=1e-9)[0]
    factors = np.clip(1 - (found[:, None] * moments).sum(0), 1 / _CORRECTION, _CORRECTION)
    return np.asarray(amplitudes * np.sqrt(factors))


def relaxed(
    points: F64, charges: F64, wavenumber: float, width: float, steps: int, metric: F64 | None = None
) -> Relaxed:
    """Field of the waves of a band, from charges (n,) at points (n, 3) of the unit cube, and relaxed.

    The isotropy of directions holds before the structure is stretched by `metric` (3, 3).
    """
    metric = np.eye(3) if metric is None else metric
    vectors, weights = band_of(wavenumber, width, metric)
    moments = moments_of(vectors @ metric)
    # BLAS, whose sums depend on its threads, is left out
    turns = sum(vectors[:, axis, None] * points[:, axis] for axis in range(3))
    amplitudes = (np.exp(-2j * np.pi * turns) * charges).sum(1) * weights
    most = int(np.abs(vectors).max())
    n = _grid_for(most)
    place = tuple(np.where(vectors < 0, vectors + n, vectors).T)
    spectrum = np.zeros((n, n, n), np.complex128)
    opposite = tuple(np.where(vectors > 0, n - vectors, -vectors).T)

    def sampled(amplitudes: NDArray[np.complex128]) -> F64:
        spectrum[place], spectrum[opposite] = amplitudes, amplitudes.conj()
        return np.asarray(np.fft.ifftn(spectrum).real * n**3)

    for _ in range(steps):
        amplitudes = with_isotropic_power(amplitudes, moments)
        field = sampled(amplitudes)
        limited = np.tanh(_GAIN / field.std() * field)
        amplitudes = np.fft.fftn(limited)[place] * weights / n**3
    amplitudes = with_isotropic_power(amplitudes, moments)
    amplitudes /= math.sqrt(2 * float((np.abs(amplitudes) ** 2).sum()))
    # what a transform leaves in the last digits differs from processor to processor
    amplitudes = np.ldexp(np.round(np.ldexp(amplitudes.real, _DIGITS)), -_DIGITS) + 1j * np.ldexp(
        np.round(np.ldexp(amplitudes.imag, _DIGITS)), -_DIGITS
    )
    gradient = [sampled(2j * np.pi * vectors[:, axis] * amplitudes) for axis in range(3)]
    return Relaxed(_as_waves(vectors, amplitudes), sampled(amplitudes), np.sqrt(sum(part**2 for part in gradient)))


def _grid_for(most: int) -> int:
    """Samples along an edge: enough for the third harmonic of all waves, and quick to transform."""
    from scipy.fft import next_fast_len

    return int(next_fast_len(max(32, 7 * most)))


def _as_waves(vectors: I64, amplitudes: NDArray[np.complex128]) -> Waves:
    most = int(np.abs(vectors).max())
    table = np.zeros((most + 1, 2 * most + 1, 2 * most + 1), np.complex128)
    # each stands for its opposite, too
    table[vectors[:, 0], vectors[:, 1] + most, vectors[:, 2] + most] = 2 * amplitudes
    return Waves(np.ascontiguousarray(table.real), np.ascontiguousarray(table.imag))


def sum_of_waves(waves: Waves, x: F64, y: F64, z: F64) -> F64:
    """The field at the points of three axes (nx,), (ny,), (nz,), cell sizes: (nx, ny, nz), x contiguous in memory."""
    values = np.zeros((z.size, y.size, x.size))
    _add_waves(waves.real, waves.imaginary, x, y, z, values)
    return values.T


@jit
def _add_waves(real: F64, imaginary: F64, x: F64, y: F64, z: F64, values: F64) -> None:
    """Add waves to values (nz, ny, nx): first those that share kx and ky along z, then those that share kx along y."""
    columns, rows, _ = real.shape
    most = rows // 2
    turn = 2.0 * math.pi
    cos_x, sin_x = np.empty((columns, len(x))), np.empty((columns, len(x)))
    for c in range(columns):
        for i in range(len(x)):
            cos_x[c, i], sin_x[c, i] = math.cos(turn * (c * x[i])), math.sin(turn * (c * x[i]))
    cos_y, sin_y = np.empty((len(y), rows)), np.empty((len(y), rows))
    for j in range(len(y)):
        for r in range(rows):
            cos_y[j, r], sin_y[j, r] = math.cos(turn * ((r - most) * y[j])), math.sin(turn * ((r - most) * y[j]))
    at_z = np.empty((columns, rows, 2))
    cos_z, sin_z = np.empty(rows), np.empty(rows)
    for k in range(len(z)):
        for r in range(rows):
            cos_z[r], sin_z[r] = math.cos(turn * ((r - most) * z[k])), math.sin(turn * ((r - most) * z[k]))
        for c in range(columns):
            for r in range(rows):
                re, im = 0.0, 0.0
                for i in range(rows):
                    re += real[c, r, i] * cos_z[i] - imaginary[c, r, i] * sin_z[i]
                    im += real[c, r, i] * sin_z[i] + imaginary[c, r, i] * cos_z[i]
                at_z[c, r, 0], at_z[c, r, 1] = re, im
        for j in range(len(y)):
            for c in range(columns):
                re, im = 0.0, 0.0
                for r in range(rows):
                    re += at_z[c, r, 0] * cos_y[j, r] - at_z[c, r, 1] * sin_y[j, r]
                    im += at_z[c, r, 0] * sin_y[j, r] + at_z[c, r, 1] * cos_y[j, r]
                for i in range(len(x)):
                    values[k, j, i] += re * cos_x[c, i] - im * sin_x[c, i]
