"""Dart throwing in hexahedra of any shape, by quota, with spacings that follow their size or stay.

Two pores at p and q keep the mean of the spacings there, as in `blocks`, measured straight. Hexahedra are thrown one
after the other, all into one list, so that spacings hold across their faces whatever the mesh looks like.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.features.grading.numerics.hexahedral_places import point_and_volume
from sppm_pipeline.method.sampling.blocks import ATTEMPTS, DARTS
from sppm_pipeline.method.sampling.cell_list import CellList, add_point, bucket_of, empty_cell_list, next_uniform
from sppm_pipeline.method.sampling.graded_blocks import is_free
from sppm_pipeline.services.jit.compiled import jit

_ABOVE = 1.3  # the determinant is looked at in 27 places, and may be so much larger in between


class GrowingCloud:
    """Up to `capacity` pores thrown so far in a `box` (2, 3) mm, with the spacing that each keeps.

    `widest` is the largest spacing that any pore keeps, mm; those of pores that keep more are not looked for far
    enough. Where spacings follow the determinant, as in `throw` unless `by_volume`, it is that at its largest.
    """

    def __init__(self, capacity: int, widest: float, box: NDArray[np.float64]) -> None:
        self._cells = empty_cell_list(capacity, widest, box[0], box[1], (False, False, False))
        self._spacings = np.empty(capacity)

    @property
    def points(self) -> NDArray[np.float64]:
        """All pores, (n, 3) mm, in the order in which they came."""
        return self._cells.points[: self._cells.used[0]].copy()

    def add(self, points: NDArray[np.float64], spacings: NDArray[np.float64]) -> None:
        """Add pores without looking at others."""
        first = int(self._cells.used[0])
        self._spacings[first : first + len(points)] = spacings
        for x, y, z in points.tolist():
            add_point(self._cells, x, y, z, 0, 0)

    def throw(
        self,
        seed: int,
        corners: NDArray[np.float64],
        quotas: NDArray[np.int64],
        spacings: NDArray[np.float64],
        by_volume: bool,
    ) -> NDArray[np.int64]:
        """Throw `quotas` (m,) pores into hexahedra with `corners` (m, 2, 2, 2, 3) mm; returns for how many there was
        no room, (m,).

        Spacings (m,) are in mm; or, unless `by_volume`, in cube roots of the determinant. With `by_volume` pores are
        as dense everywhere in a hexahedron; otherwise as in a cube that was bent to it, so that they are finer where
        it is narrower.
        """
        missing = np.zeros(len(quotas), np.int64)
        nodes = np.ascontiguousarray(corners.reshape(-1, 8, 3), np.float64)
        state = np.array([seed % 2**64], np.uint64)
        _throw(self._cells, self._spacings, state, nodes, quotas, spacings, by_volume, missing)
        return missing

    def take(
        self,
        candidates: NDArray[np.float64],
        spacings: NDArray[np.float64],
        group: NDArray[np.int64],
        quotas: NDArray[np.int64],
    ) -> None:
        """Add those of the candidates (k, 3) that keep their spacings, in order, up to the quota of their group."""
        _take(self._cells, self._spacings, candidates, spacings, group, quotas.copy())


@jit
def _remove_last(cells: CellList) -> None:
    row = cells.used[0] - 1
    i, j, k = bucket_of(cells, cells.points[row, 0], cells.points[row, 1], cells.points[row, 2])
    cells.first[k, j, i] = cells.following[row]
    cells.used[0] = row


@jit
def _throw(
    cells: CellList, kept: NDArray[np.float64], stream: NDArray[np.uint64], nodes: NDArray[np.float64],
    quotas: NDArray[np.int64], spacings: NDArray[np.float64], by_volume: bool, missing: NDArray[np.int64],
) -> None:  # fmt: skip
    p, d = np.empty(3), np.empty((3, 3))
    metric = np.empty(0)
    for e in range(len(quotas)):
        most = 0.0
        if by_volume:
            for i in range(27):
                most = max(
                    most, _ABOVE * point_and_volume(nodes[e], 0.5 * (i // 9), 0.5 * (i // 3 % 3), 0.5 * (i % 3), p, d)
                )
        wanted, placed = quotas[e], 0
        for attempt in range(ATTEMPTS):
            placed, darts = 0, 0
            while placed < wanted and darts < DARTS * wanted + 1000:
                x, y, z = next_uniform(stream), next_uniform(stream), next_uniform(stream)
                det = point_and_volume(nodes[e], x, y, z, p, d)
                # places are uniform in the unit cube: rejection by the determinant makes them uniform in space
                if by_volume and next_uniform(stream) * most > det:
                    continue
                darts += 1
                own = spacings[e] if by_volume else spacings[e] * max(det, 0.0) ** (1.0 / 3.0)
                if is_free(cells, kept, None, p, own, metric):
                    kept[cells.used[0]] = own
                    add_point(cells, p[0], p[1], p[2], 0, 0)
                    placed += 1
            if placed == wanted or attempt == ATTEMPTS - 1:
                break
            # a cell that jammed is emptied and thrown again, as adding to it would only find the last gaps
            for _ in range(placed):
                _remove_last(cells)
        missing[e] = wanted - placed


@jit
def _take(
    cells: CellList, kept: NDArray[np.float64], candidates: NDArray[np.float64], spacings: NDArray[np.float64],
    group: NDArray[np.int64], left: NDArray[np.int64],
) -> None:  # fmt: skip
    metric = np.empty(0)
    for n in range(len(candidates)):
        p = candidates[n]
        if left[group[n]] > 0 and is_free(cells, kept, None, p, spacings[n], metric):
            kept[cells.used[0]] = spacings[n]
            add_point(cells, p[0], p[1], p[2], 0, 0)
            left[group[n]] -= 1
