"""One pass over the layers of a print: both phases in every half-stack, overhang, and the worst layers as pictures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.features.printing.numerics.layers import convex_hull, first_moments, reach_of, unsupported
from sppm_pipeline.features.printing.numerics.tracker import Events, Tracker, complement
from sppm_pipeline.method.connectivity.components import paint_runs
from sppm_pipeline.method.connectivity.runs import Runs, find_runs

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
    curves: dict[str, NDArray[np.int64]]
    islands: Events  # of solid
    cups: Events  # of void
    center: NDArray[np.float64]  # (3,), of mass (x, y, z), counted from the low corner of the stack; NaN without solid
    foot: NDArray[np.float64]  # (n, 2), convex hull of the first layer that holds solid
    worst: list[tuple[int, NDArray[np.uint8]]]  # layers (ny, nx) with codes from `VOID` to `TRAP`, by their number


@dataclass
class _Remembered:
    """A layer that may be among the worst: what it held, and what has become of its open components of void since."""

    score: int
    layer: int
    solid: Runs
    floating: NDArray[np.bool_]
    overhang: Runs
    void_of_run: NDArray[np.int32]
    fate: NDArray[np.int32]

    def follow(self, void: Tracker, was_on_plate: NDArray[np.bool_]) -> None:
        """Carry the components of void over the next layer."""
        alive = np.flatnonzero(self.fate >= 0)
        if not len(alive):
            return
        old = self.fate[alive]
        new = void.successor[old]
        ended = np.where(was_on_plate[old], _OPENED, _TRAPPED)
        self.fate[alive] = np.where(new < 0, ended, np.where(void.grounded[np.maximum(new, 0)], _OPENED, new))

    def painted(self) -> NDArray[np.uint8]:
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
        marked: NDArray[np.uint8] = np.where(shut[0] > 0, shut[0], codes[0]).astype(np.uint8)
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

    def add(self, layer: NDArray[np.uint8]) -> Runs:
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

    def _painted(self) -> list[tuple[int, NDArray[np.uint8]]]:
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
