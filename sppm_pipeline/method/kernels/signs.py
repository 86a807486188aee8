"""Samples of a sum of kernels below a level: bounds around the sum on a coarse grid decide most samples.

Kernels ``exp(-f)`` have a convex f: a multiple of a distance, or of its square. Let a sample m lie between coarse
samples c, their mean with weights w_c that add up to one, no more than H apart along an axis. Then for each kernel k:

* ``sum w_c k(c) <= k(m) exp(g^2 H^2 / 8)``, g the steepest slope of f: f lies above its tangent at m, and the mean of
  the exponential of a linear function is bounded by Hoeffding's lemma. So m is *void* where the interpolated sum
  exceeds the level by this factor.
* ``sum w_c k(c) >= k(m) exp(f(m) - sum w_c f(c))`` by Jensen's inequality, and the mean of f exceeds f(m) by no more
  than ``mu (sqrt(d^2 + V) - d)``, or ``mu V`` for a square, with d the distance of m and V the sum of
  ``w (1 - w) H^2`` over the axes. The factor falls with d. If the sum at m reached the level C, either one kernel alone
  would reach it, or all would be farther away than where one is C; so the distance at which a kernel is C bounds the
  factor, and m is *solid* where the interpolated sum lies below the level by it.

Where neither holds, at 8 % of the samples at three to a tunnel radius, the sum is taken at the sample (`open_samples`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.method.kernels.profiles import PORE_PROFILE, TUNNEL_PROFILES, TunnelProfile
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.jit.compiled import inline_jit, jit

STEEPEST = 0.36
"""Largest exponent g^2 H^2 / 8 of the bound for void: the farther apart the coarse samples, the more is left open."""

DROPPED = 200
"""Kernels that end near a sample, each of them below the cut-off, that the bounds allow for."""

MAX_DRIFT = 0.2
"""Largest change of ln C from one coarse sample to the next along all axes."""

UNDECIDED = 2
"""Marks a sample that the bounds leave open."""

_MAX_STEPS = 8


class Bounds(NamedTuple):
    """Steps and bounds by which samples are decided.

    Sample types are numbered by 1, 2, 4 for samples that lie between coarse ones along x, y, z.
    """

    steps: tuple[int, int, int]  # samples from one coarse sample to the next along x, y, z
    solid: NDArray[np.float32]  # (8,) interpolated sums below which a sample is solid, by type
    void: NDArray[np.float32]  # (8,) those above which it is void


class Levels(NamedTuple):
    """At which level a sum is cut: at one, or at one that is a function of place."""

    mean: float  # sums that the bounds are compared with are G / C times this
    least: float  # C does not go below
    most: float  # nor above
    slope: float = 0.0  # that of ln C along no axis exceeds this, 1 / unit of length


def one_level(level: float) -> Levels:
    """The same level everywhere."""
    return Levels(level, level, level)


def find_bounds(
    omega: float,
    mu: float,
    profile: str,
    levels: Levels,
    spacing: tuple[float, float, float],
    cutoff: float,
    crowd: float = math.inf,
) -> Bounds | None:
    """The bounds for sums whose steepest pore and tunnel have the parameters omega and mu (0 for none).

    None where they would not pay: for grids so coarse that a third of the samples, or more, would be summed. `crowd` is
    a number that pores within reach of a sample do not exceed; the steps do not depend on it.
    """
    if not 0.0 < levels.least <= levels.most < 1.0:
        return None
    kinds = [(kind, m) for kind, m in ((PORE_PROFILE, omega), (TUNNEL_PROFILES[profile], mu)) if m > 0]
    # steepest slope of f, squared: mu for a distance; of a square, 2 mu d where the kernel is cut off
    slope2 = max((m * m if kind.power == 1 else 4 * m * math.log(1 / cutoff) for kind, m in kinds), default=0.0)
    if slope2 == 0.0:
        return None
    apart = math.sqrt(8 * STEEPEST / slope2)
    x, y, z = (max(1, min(_MAX_STEPS, int(apart / h + 1e-9))) for h in spacing)
    # with fewer fine samples for each coarse one, the bounds cost more than they save
    if x * y * z < 4:
        return None
    drift = levels.slope * sum(s * h for s, h in zip((x, y, z), spacing, strict=True))
    if drift > MAX_DRIFT:
        return None
    slack = DROPPED * cutoff
    solid, void = np.empty(8), np.empty(8)
    for number in range(8):
        between = [s * h if number & 1 << a else 0.0 for a, (s, h) in enumerate(zip((x, y, z), spacing, strict=True))]
        # w (1 - w) H^2 is largest in the middle, where w is 1/2
        spread = sum(side * side for side in between) / 4
        far = 0.0
        for kind, m in kinds:
            # at the highest level the radius is smallest, and the bound weakest
            d = float(kind.radius(m, levels.most))
            far = max(far, m * (math.sqrt(d * d + spread) - d) if kind.power == 1 else m * spread)
        solid[number] = levels.mean * (1 - slack / levels.least) * math.exp(-far - drift)
        above = _void_above(omega, kinds, levels.least + slack, max(between), cutoff, crowd)
        void[number] = levels.mean * above / levels.least * math.exp(drift)
    return Bounds((x, y, z), solid.astype(np.float32), void.astype(np.float32))


def _void_above(
    omega: float, kinds: list[tuple[TunnelProfile, float]], level: float, apart: float, cutoff: float, crowd: float
) -> float:
    """The sum interpolated from samples `apart` that is reached by no sum below the level.

    Pores fall off the more steeply the farther away they are, and the less they count. Either all kernels are taken as
    steep as the steepest; or the distant pores are taken as steep as the rest, and what each of them may be more is
    allowed for, as many times as there can be pores.
    """
    eighth = apart * apart / 8
    steepest = max(m * m if kind.power == 1 else 4 * m * math.log(1 / cutoff) for kind, m in kinds)
    best = level * math.exp(steepest * eighth)
    others = kinds[1:] if omega > 0 else kinds
    if omega > 0 and math.isfinite(crowd) and all(kind.power == 1 for kind, _ in others):
        least = max((m * m for _, m in others), default=0.0) * eighth
        far = np.linspace(0.0, math.log(1 / cutoff), 200)
        for rate in np.linspace(least, max(least, steepest * eighth), 20):
            more = np.exp(-far) * (np.exp(4 * omega * eighth * far) - math.exp(rate))
            # between two places of the table it is larger by no more than the last digit
            best = min(best, level * math.exp(rate) + 1.05 * crowd * max(0.0, float(more.max())))
    return float(best)


def crowd_of(centers: NDArray[np.float64], reach: float) -> int:
    """A number that the points within `reach` of any place do not exceed: those of 27 cubes."""
    if not len(centers):
        return 0
    # a ball of the radius `reach` meets at most 3 cubes of this edge along each axis
    place = np.floor((centers - centers.min(0)) / reach).astype(np.int64)
    counts = np.zeros(place.max(0) + 3, np.int64)
    np.add.at(counts, tuple(place.T + 1), 1)
    for axis in range(3):
        padded = np.pad(counts, [(1, 1) if a == axis else (0, 0) for a in range(3)])
        n = counts.shape[axis]
        counts = np.sum([padded.take(range(shift, shift + n), axis) for shift in range(3)], axis=0)
    return int(counts.max())


def coarse_grid(grid: Grid, steps: tuple[int, int, int]) -> Grid:
    """The grid of every so many samples from the first one on, and one more where it would end before the last."""
    spacing = [h * s for h, s in zip(grid.spacing, steps, strict=True)]
    shape = [-(-(n - 1) // s) + 1 for n, s in zip(grid.shape, steps, strict=True)]
    return Grid(grid.origin, (spacing[0], spacing[1], spacing[2]), (shape[0], shape[1], shape[2]))


def coarse_layers(start: int, stop: int, step: int) -> tuple[int, int]:
    """First and last but one of the coarse layers that layers start <= k < stop are decided from."""
    return start // step, -(-(stop - 1) // step) + 1


def coarse_rows(wanted: NDArray[np.int32], steps: tuple[int, int, int], start: int, coarse: Grid) -> NDArray[np.int32]:
    """Coarse rows that are wanted where fine ones, (layers, ny, 2) from layer `start` on, are."""
    first, stop = coarse_layers(start, start + len(wanted), steps[2])
    out = np.empty((stop - first, coarse.shape[1], 2), np.int32)
    out[..., 0], out[..., 1] = coarse.shape[0], 0
    _coarse_rows(wanted, *steps, start, first, out)
    np.minimum(out[..., 1], coarse.shape[0], out=out[..., 1])
    out[out[..., 0] >= out[..., 1]] = 0
    return out


@jit
def _coarse_rows(
    wanted: NDArray[np.int32], sx: int, sy: int, sz: int, start: int, first: int, out: NDArray[np.int32]
) -> None:
    for k in range(wanted.shape[0]):
        z = start + k
        for j in range(wanted.shape[1]):
            a, b = wanted[k, j, 0], wanted[k, j, 1]
            if a >= b:
                continue
            low, high = np.int32(a // sx), np.int32(-(-(b - 1) // sx) + 1)
            for p in range(z // sz - first, -(-z // sz) - first + 1):
                for q in range(j // sy, -(-j // sy) + 1):
                    out[p, q, 0], out[p, q, 1] = min(out[p, q, 0], low), max(out[p, q, 1], high)


@inline_jit
def _mix(
    coarse: NDArray[np.float32],
    p: np.uint64,
    p1: np.uint64,
    q: np.uint64,
    q1: np.uint64,
    wz: np.float32,
    wy: np.float32,
    start: np.uint64,
    stop: np.uint64,
    row: NDArray[np.float32],
) -> None:
    """Four coarse rows, interpolated along y and z."""
    a, b = (np.float32(1) - wz) * (np.float32(1) - wy), (np.float32(1) - wz) * wy
    c, d = wz * (np.float32(1) - wy), wz * wy
    for i in range(start, stop):
        row[i] = a * coarse[p, q, i] + b * coarse[p, q1, i] + c * coarse[p1, q, i] + d * coarse[p1, q1, i]


@inline_jit
def _judge(
    row: NDArray[np.float32],
    start: np.uint64,
    stop: np.uint64,
    weight: np.float32,
    solid: np.float32,
    void: np.float32,
    out: NDArray[np.uint8],
) -> None:
    """Classify samples between coarse ones, of which there is one more: solid (1), void (0) or open (2)."""
    one, near = np.uint64(1), np.float32(1) - weight
    for i in range(start, stop):
        value = near * row[i] + weight * row[i + one]
        out[i] = np.uint8(value < solid) + np.uint8(2) * np.uint8((value >= solid) & (value <= void))


@inline_jit
def _spread(
    found: NDArray[np.uint8], start: np.uint64, stop: np.uint64, step: np.uint64, out: NDArray[np.uint8]
) -> None:
    for i in range(start, stop):
        out[i * step] = found[i]


@inline_jit
def _interleave(
    even: NDArray[np.uint8], odd: NDArray[np.uint8], start: np.uint64, stop: np.uint64, out: NDArray[np.uint8]
) -> None:
    two, one = np.uint64(2), np.uint64(1)
    for i in range(start, stop):
        out[two * i] = even[i]
        out[two * i + one] = odd[i]


@jit
def decide_rows(
    coarse: NDArray[np.float32],
    first_plane: int,
    first_row: int,
    steps: tuple[int, int, int],
    solid: NDArray[np.float32],
    void: NDArray[np.float32],
    first_layer: int,
    row_start: int,
    row_stop: int,
    wanted: NDArray[np.int32],
    out: NDArray[np.uint8],
    open_from: NDArray[np.int64],
    open_x: NDArray[np.int32],
) -> None:
    """Decide the wanted samples of rows of layers by bounds: 1 solid, 0 void, 2 open; others are left as they are.

    `coarse` (planes, cy, cx) are sums on coarse layers and rows from `first_plane` and `first_row` on, counted in those
    of the whole grid; layer `first_layer` of the grid is ``out[0]``, of (layers, ny, nx). `wanted` is (layers, ny, 2).
    The open samples of each row begin in `open_x` at `open_from` (layers * (row_stop - row_start) + 1,); `open_x` is 8
    longer than the number of those that are wanted.
    """
    sx, sy, sz = steps
    cx, cy, planes = coarse.shape[2], coarse.shape[1], coarse.shape[0]
    row = np.zeros(cx + 1, np.float32)
    found = np.zeros((sx, cx + 1), np.uint8)
    whole = np.zeros(((cx + 1) * sx + 7) // 8 * 8, np.uint8)
    words, marks = whole.view(np.uint64), np.uint64(0x0202020202020202)
    count = number = 0
    for k in range(out.shape[0]):
        z = first_layer + k
        p, wz = z // sz - first_plane, z % sz
        p1 = min(p + 1, planes - 1)
        for j in range(row_start, row_stop):
            open_from[number] = count
            number += 1
            begin, end = np.int64(wanted[k, j, 0]), np.int64(wanted[k, j, 1])
            if begin >= end:
                continue
            q, wy = j // sy - first_row, j % sy
            # samples on a coarse plane or row lie between fewer coarse ones, and have tighter bounds
            kind = 2 * int(wy > 0) + 4 * int(wz > 0)
            low, high = np.uint64(begin // sx), np.uint64((end - 1) // sx + 1)
            _mix(
                coarse, np.uint64(p), np.uint64(p1 if wz > 0 else p), np.uint64(q),
                np.uint64(min(q + 1, cy - 1) if wy > 0 else q), np.float32(wz / sz), np.float32(wy / sy), low,
                min(high + np.uint64(1), np.uint64(cx)), row,
            )  # fmt: skip
            for f in range(sx):
                t = kind + int(f > 0)
                _judge(row, low, high, np.float32(f / sx), solid[t], void[t], found[f])
            if sx == 2:
                _interleave(found[0], found[1], low, high, whole)
            else:
                for f in range(sx):
                    _spread(found[f], low, high, np.uint64(sx), whole[f:])
            target = out[k, j]
            for x in range(np.uint64(begin), np.uint64(end)):
                target[x] = whole[x]
            whole[begin // 8 * 8 : begin] = 0
            whole[end : (end + 7) // 8 * 8] = 0
            # eight marks at once: most words hold none that is open
            for word in range(begin // 8, (end + 7) // 8):
                if words[word] & marks:
                    for x in range(8 * word, 8 * word + 8):
                        open_x[count] = x
                        count += int(whole[x] == UNDECIDED)
    open_from[number] = count
