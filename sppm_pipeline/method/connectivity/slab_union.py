"""Components of a part whose slabs were labeled apart from each other, by processes that share no data.

The result is that of labeling all layers at once, in components, in their order and in which of equals is the first: a
component of the part is numbered by its first voxel, which lies in the lowest slab that it reaches, and there in the
local component that begins first. Slabs are added from the bottom; only the last layer of one of them is kept.
"""

from __future__ import annotations

import numpy as np

from sppm_pipeline.method.connectivity.streaming import IslandStatistics, SlabLabels, decide, resolve
from sppm_pipeline.services.arrays import I32, I64, Bools
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.union_find import unite


class SlabUnion:
    """Unites the components of slabs that follow each other.

    Call `add` for each slab in the order of z, then `finish` once. Kept are four bytes for each id, some forty for each
    component of a slab, and the runs of one layer.
    """

    def __init__(self) -> None:
        self._layers = 0
        self._starts = [0]
        self._components: list[I32] = []
        self._voxels: list[I64] = []
        self._boxes: list[I32] = []
        self._parent = np.zeros(1024, dtype=np.int32)
        self._below: SlabLabels | None = None

    def add(self, labels: SlabLabels) -> None:
        """Take in the next slab."""
        start = self._starts[-1]
        stop = start + labels.voxels.size
        if stop > self._parent.size:
            self._parent = np.pad(self._parent, (0, stop))
        self._parent[start:stop] = np.arange(start, stop, dtype=np.int32)
        if (below := self._below) is not None:
            _join_border(
                below.last.rows,
                below.last.bounds,
                below.of_last + np.int32(self._starts[-2]),
                labels.first.rows,
                labels.first.bounds,
                labels.of_first + np.int32(start),
                self._parent,
            )
        boxes = labels.boxes.copy()
        # z of a slab counts from its own first layer
        boxes[:, 4:] += self._layers
        self._boxes.append(boxes)
        self._voxels.append(labels.voxels)
        self._components.append(labels.component)
        self._starts.append(stop)
        self._layers += labels.layers
        # the last layer alone is needed for the border to the next slab
        self._below = labels._replace(component=labels.component[:0], first=labels.last, of_first=labels.of_last)

    def finish(self) -> tuple[IslandStatistics, list[Bools]]:
        """Decide what stays, as `IslandFilter.finish`; and the verdict on the ids of each slab."""
        parent = self._parent[: self._starts[-1]].copy()
        voxels = np.concatenate([np.zeros(0, np.int64), *self._voxels])
        boxes = np.concatenate([np.zeros((0, 6), np.int32), *self._boxes])
        resolve(parent, voxels, boxes)
        stays, statistics = decide(parent, voxels, boxes, self._layers)
        slabs = zip(self._starts[:-1], self._components, strict=True)
        return statistics, [stays[start + component] for start, component in slabs]


@jit
def _join_border(
    rows_below: I64, bounds_below: I32, labels_below: I32, rows: I64, bounds: I32, labels: I32, parent: I32
) -> None:
    """Unite the labels of runs that touch across the border of two slabs; the smaller root stays."""
    for y in range(rows.size - 1):
        a, a_stop = rows[y], rows[y + 1]
        b, b_stop = rows_below[y], rows_below[y + 1]
        while a < a_stop and b < b_stop:
            if bounds[2 * a + 1] <= bounds_below[2 * b]:
                a += 1
            elif bounds_below[2 * b + 1] <= bounds[2 * a]:
                b += 1
            else:
                unite(parent, labels[a], labels_below[b])
                # the run that ends first can touch no further one
                if bounds[2 * a + 1] < bounds_below[2 * b + 1]:
                    a += 1
                else:
                    b += 1
