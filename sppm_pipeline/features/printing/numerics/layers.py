"""Single layers: overhang over the one below, first moments, the hull of the foot."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from sppm_pipeline.features.printing.numerics.tracker import Events, Tracker, complement
from sppm_pipeline.method.connectivity.components import paint_runs
from sppm_pipeline.method.connectivity.runs import Runs, find_runs
from sppm_pipeline.services.arrays import F64, I32, I64, U8, Bools
from sppm_pipeline.services.jit.compiled import jit

VOID, SOLID, OVERHANG, ISLAND, CUP, TRAP = range(6)
"""Codes of the pixels of a marked layer."""

BANDS = 8
"""Of so many bands of the height the worst layer for each reason is remembered, so that not all are neighbors."""

SPACINGS_IN_HEIGHT = 60
"""Painted layers differ by more than this part of the height, as neighbors look alike."""

_TRAPPED, _OPENED, _AMBIENT = -1, -2, -3

CURVES = (
    "area", "sealed", "floating", "islands", "overhang", "components", "largest", "edges_x", "edges_y",
)  # fmt: skip


class Scan(NamedTuple):
    """Results of a pass over all layers; lengths are in pixels and layers.

    The curves, (layers,) each by the names of `CURVES`, are pixels of solid; of void that is a cup in this half-stack;
    of solid not yet connected to the plate; of these, the ones in components that begin here; of overhang;
    two-dimensional components of solid, pixels of the largest, and edges along x and y of its outline.
    """

    ground: int  # first layer that holds solid; the number of layers if none does
    curves: dict[str, I64]
    islands: Events  # of solid
    cups: Events  # of void
    center: F64  # (3,), of mass (x, y, z), counted from the low corner of the stack; NaN without solid
    foot: F64  # (n, 2), convex hull of the first layer that holds solid
    worst: list[tuple[int, U8]]  # layers (ny, nx) with codes from `VOID` to `TRAP`, by their number


@dataclass
class _Remembered:
    """A layer that may be among the worst: what it held, and what has become of its open components of void since."""

    score: int
    layer: int
    solid: Runs
    floating: Bools
    overhang: Runs
    void_of_run: I32
    fate: I32

    def follow(self, void: Tracker, was_on_plate: Bools) -> None:
        """Carry the components of void over the next layer."""
        alive = np.flatnonzero(self.fate >= 0)
        if not len(alive):
            return
        old = self.fate[alive]
        new = void.successor[old]
        fate = np.where(was_on_plate[old], _OPENED, _TRAPPED)
        goes_on = new >= 0  # nothing does below a layer that is all solid
        fate[goes_on] = np.where(void.grounded[new[goes_on]], _OPENED, new[goes_on])
        self.fate[alive] = fate

    def painted(self) -> U8:
        _, ny, nx = self.solid.shape
        codes = np.zeros((1, ny, nx), np.int32)
        paint_runs(self.solid.rows, self.solid.bounds, np.where(self.floating, ISLAND, SOLID).astype(np.int32), codes)
        over = np.zeros_like(codes)
        paint_runs(self.overhang.rows, self.overhang.bounds, np.ones(self.overhang.n_runs, np.int32), over)
        codes[(over > 0) & (codes == SOLID)] = OVERHANG
        # `fate` is known only now: whether a cup of that layer was vented later, or stayed a trap
        void = complement(self.solid)
        code = np.select([self.fate == _AMBIENT, self.fate == _TRAPPED], [VOID, TRAP], CUP).astype(np.int32)
        shut = np.zeros_like(codes)
        paint_runs(void.rows, void.bounds, code[self.void_of_run], shut)
        marked: U8 = np.where(shut[0] > 0, shut[0], codes[0]).astype(np.uint8)
        return marked


class PrintScan:
    """Take in the layers of a print one by one with `add`, then ask for what was found with `finish`.

    `shape` is (nx, ny, nz), `pixel` the pitch along x and y, `overhang` the distance up to which solid is held by the
    solid of the layer below, in the same unit. With `plate` "sealed" the build plate closes the void from below. At
    most `pictures` layers are painted.
    """

    def __init__(
        self,
        shape: tuple[int, int, int],
        pixel: tuple[float, float],
        overhang: float,
        plate: Literal["sealed", "supports"] = "sealed",
        pictures: int = 6,
    ) -> None:
        self._shape = shape
        self._reach = reach_of(overhang, pixel)
        self._solid, self._void = Tracker("solid"), Tracker("void", plate)
        self._pictures = pictures
        self._curves = {name: np.zeros(shape[2], np.int64) for name in CURVES}
        self._moments = np.zeros(3)
        self._below: Runs | None = None
        self._ground = shape[2]
        self._foot = np.zeros((0, 2))
        self._next = 0
        self._worst: dict[tuple[int, str], _Remembered] = {}

    def add(self, layer: U8) -> Runs:
        """Take in the next layer, (ny, nx) uint8, solid where it is not 0; returns its runs."""
        k, self._next = self._next, self._next + 1
        runs = find_runs(layer[None])
        if self._below is None:
            if not runs.n_runs:
                return runs
            self._ground, self._foot = k, convex_hull(runs)
            overhang = Runs(runs.shape, np.zeros_like(runs.rows), runs.bounds[:0])
        else:
            overhang = unsupported(runs, self._below, self._reach)
        was_on_plate = self._void.plate
        solid, void = self._solid.add(runs, k), self._void.add(complement(runs), k)
        row = {
            "area": solid.area, "sealed": void.loose, "floating": solid.loose, "islands": solid.born,
            "overhang": int(overhang.lengths.sum()), "components": solid.components, "largest": solid.largest,
            "edges_x": solid.edges_x, "edges_y": solid.edges_y,
        }  # fmt: skip
        for name, value in row.items():
            self._curves[name][k] = value
        self._moments += (*first_moments(runs), solid.area * (k + 0.5))
        for remembered in {id(one): one for one in self._worst.values()}.values():
            remembered.follow(self._void, was_on_plate)
        self._remember(k, row, runs, overhang)
        self._below = runs
        return runs

    def _remember(self, k: int, row: dict[str, int], runs: Runs, overhang: Runs) -> None:
        band = k * BANDS // self._shape[2]
        for reason in ("sealed", "floating", "overhang"):
            known = self._worst.get((band, reason))
            if self._pictures and row[reason] > (known.score if known else 0):
                grounded = self._void.grounded
                self._worst[band, reason] = _Remembered(
                    row[reason], k, runs, ~self._solid.grounded[self._solid.of_run], overhang, self._void.of_run,
                    np.where(grounded, _AMBIENT, np.arange(len(grounded))).astype(np.int32),
                )  # fmt: skip

    def finish(self) -> Scan:
        """Everything that was found, once all layers were added."""
        nz = self._shape[2]
        solid = self._curves["area"].sum()
        center = self._moments / solid if solid else np.full(3, np.nan)
        return Scan(
            self._ground, self._curves, self._solid.finish(nz), self._void.finish(nz), center, self._foot,
            self._painted(),
        )  # fmt: skip

    def _painted(self) -> list[tuple[int, U8]]:
        """The worst layers: by turns that with the largest area of cups, of islands, of overhang, and the next ones."""
        ranks: list[tuple[int, int, _Remembered]] = []
        for number, reason in enumerate(("sealed", "floating", "overhang")):
            own = sorted((one for (_, why), one in self._worst.items() if why == reason), key=lambda one: -one.score)
            ranks += [(rank, number, one) for rank, one in enumerate(own)]
        picked: dict[int, _Remembered] = {}
        apart = self._shape[2] // SPACINGS_IN_HEIGHT
        for _, _, one in sorted(ranks, key=lambda place: place[:2]):
            if len(picked) < self._pictures and all(abs(one.layer - k) > apart for k in picked):
                picked[one.layer] = one
        return [(k, one.painted()) for k, one in sorted(picked.items())]


def reach_of(distance: float, pixel: tuple[float, float]) -> I64:
    """Half widths of a disk in pixels, a row each from -R to R rows; pixel pitch along x and y in the disk's unit."""
    px, py = pixel
    rows = math.floor(distance / py + 1e-9)
    along = [math.sqrt(max(0.0, distance**2 - (row * py) ** 2)) / px for row in range(-rows, rows + 1)]
    return np.floor(np.array(along) + 1e-9).astype(np.int64)


def unsupported(runs: Runs, below: Runs, reach: I64) -> Runs:
    """The pixels of a layer farther from those of the layer below than `reach_of` says."""
    rows, bounds = _unsupported(runs.rows, runs.bounds, below.rows, below.bounds, runs.shape[2], reach)
    return Runs(runs.shape, rows, bounds)


@jit
def _unsupported(rows: I64, bounds: I32, rows_below: I64, bounds_below: I32, nx: int, reach: I64) -> tuple[I64, I32]:
    ny, around = rows.size - 1, reach.size // 2
    out_rows = np.empty_like(rows)
    out = np.empty(max(64, bounds.size), np.int32)
    # what of a row is left, and what is left of that; never more runs than fit into it
    left, rest = np.empty(nx + 2, np.int32), np.empty(nx + 2, np.int32)
    n = 0
    for y in range(ny):
        out_rows[y] = n // 2
        m = 2 * (rows[y + 1] - rows[y])
        left[:m] = bounds[2 * rows[y] : 2 * rows[y + 1]]
        for turn in range(2 * around + 1):
            dy = (turn + 1) // 2 if turn % 2 else -(turn // 2)  # the row itself holds most
            if m and 0 <= y + dy < ny:
                m = _subtract(
                    left, m, bounds_below, rows_below[y + dy], rows_below[y + dy + 1], reach[dy + around], rest
                )
                left, rest = rest, left
        if n + m > out.size:
            out = np.concatenate((out, np.empty(out.size + m, np.int32)))
        out[n : n + m] = left[:m]
        n += m
    out_rows[ny] = n // 2
    return out_rows, out[:n].copy()


@jit
def _subtract(runs: I32, n: int, taken: I32, r: int, r_stop: int, wide: int, out: I32) -> int:
    """Write what of some runs lies outside of others, which are widened at both ends; returns the bounds written."""
    m = 0
    for i in range(0, n, 2):
        start, stop = runs[i], runs[i + 1]
        while r < r_stop and taken[2 * r + 1] + wide <= start:
            r += 1
        other = r
        while start < stop and other < r_stop and taken[2 * other] - wide < stop:
            if taken[2 * other] - wide > start:
                out[m] = start
                out[m + 1] = taken[2 * other] - wide
                m += 2
            start = max(start, taken[2 * other + 1] + wide)
            other += 1
        if start < stop:
            out[m] = start
            out[m + 1] = stop
            m += 2
    return m


def first_moments(runs: Runs) -> tuple[float, float]:
    """Sums of x and of y over the pixels of a layer, at their centers (x + 1/2, y + 1/2)."""
    x, y = _first_moments(runs.rows, runs.bounds)
    return float(x) / 2, float(y) / 2


@jit
def _first_moments(rows: I64, bounds: I32) -> tuple[np.int64, np.int64]:
    x, y = np.int64(0), np.int64(0)
    for line in range(rows.size - 1):
        length = np.int64(0)
        for r in range(rows[line], rows[line + 1]):
            start, stop = np.int64(bounds[2 * r]), np.int64(bounds[2 * r + 1])
            length += stop - start
            x += (stop - start) * (start + stop)
        y += length * (2 * line + 1)
    return x, y


def convex_hull(runs: Runs) -> F64:
    """Corners of the convex hull of the pixels of a layer, counterclockwise, (n, 2), in pixels."""
    from scipy.spatial import ConvexHull

    rows = np.flatnonzero(np.diff(runs.rows))
    low = runs.bounds[2 * runs.rows[rows]]
    high = runs.bounds[2 * runs.rows[rows + 1] - 1]
    # only the first and last pixel of a row can be on the hull; pixels count by their corners
    x = np.concatenate([low, low, high, high])
    y = np.concatenate([rows, rows + 1, rows, rows + 1])
    points = np.stack([x, y], 1).astype(np.float64)
    return np.asarray(points[ConvexHull(points).vertices])


def margin_inside(hull: F64, point: tuple[float, float]) -> float:
    """Depth of a point in a convex polygon with counterclockwise corners; negative outside of an edge."""
    edge = np.roll(hull, -1, 0) - hull
    to_point = np.asarray(point) - hull
    return float(((edge[:, 0] * to_point[:, 1] - edge[:, 1] * to_point[:, 0]) / np.hypot(edge[:, 0], edge[:, 1])).min())
