"""Floating islands of a part whose layers come slab by slab and are never all in memory.

Islands have to be removed on the assembly, never per tile: what floats in a tile may be held by its neighbor. So the
part is gone through twice. The first pass gives every run of a layer an *id*: that of the component which it touches in
the layer below or in the row before, or a new one. Ids that turn out to be one component are united, and voxels are
counted per id. Of the ids that a layer has brought, those remain that nothing is known to be one with.

The verdict falls when all layers were seen, but for most runs long before: a run that is one with the largest component
so far remains so. Runs that are not, the *loose* ones, are stored, a few in a hundred. The second pass looks up
whether their ids stay, and takes out those that do not; it need not look at the others. Should there be too many to
store, the second pass derives the ids of all runs again, in the same way.

Slabs may also be labeled apart from each other, each by a filter of its own: `IslandFilter.labels` ends the first pass
of a slab, `slab_union` unites them, and `IslandFilter.decided` begins the second pass.

Kept between layers are the runs of one layer and their ids; besides, some forty bytes per id until `finish`, and one
byte afterwards, and sixteen for each loose run. A new id is needed only where a two-dimensional component lies on
nothing below: a few per cell.
"""

from __future__ import annotations

from collections import deque
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import InputError
from sppm_pipeline.method.connectivity.layer_ids import clear_runs, layer_ids, list_loose, set_runs, still_loose
from sppm_pipeline.method.connectivity.runs import Runs, runs_of_bits
from sppm_pipeline.services.arrays import I32, I64, U64, Bools
from sppm_pipeline.services.bit_rows import count
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.union_find import find_root

_MAX_STORED = 1 << 21
"""Loose runs that are stored in the first pass: 32 MB. With more, ids are derived twice, which takes time instead."""

_PRUNED_FROM = 1 << 18
"""Loose runs from which they are pruned: most of those of the first layers have become connected. These
are 4 MB; not sensitive."""


class _Loose(NamedTuple):
    """Data of a layer for the second pass."""

    voxels: int  # how many are set, so that another layer is noticed
    main: int  # an id of the component that was the largest when the layer was seen; -1 if the layer is empty
    runs: I32  # (n, 4): row, first voxel, the one after the last, and id of each run of another component


class IslandStatistics(NamedTuple):
    """Statistics of the components, from the first pass."""

    layers: int
    voxels: int  # of the phase
    components: int
    largest_share: float  # fraction of the phase in the largest component
    removed_share: float  # fraction of the phase that is removed
    # the largest component reaches, along x, y, z, from the first to the last voxel of the whole phase
    spans: tuple[bool, bool, bool]


class SlabLabels(NamedTuple):
    """Components of a slab labeled by itself, from the first pass, in the order of their first voxels (z slowest)."""

    layers: int
    component: I32  # (n_ids,), of each id
    voxels: I64  # (n,), of each component
    # (n, 6): x low, x high, y ..., z high; the highs are inclusive, z counts from the first layer
    boxes: I32
    first: Runs  # runs of the first layer, and their components
    of_first: I32
    last: Runs  # likewise of the last layer
    of_last: I32


class IslandFilter:
    """Remove floating islands in two passes over the same slabs.

    Call `observe` for every slab in the order of z, `finish` once, then `clear` for every slab in the same order (the
    slabs may be cut differently). The result is that of labeling all layers at once.
    """

    def __init__(self, ny: int, nx: int) -> None:
        self._shape = (ny, nx)
        self._layers = 0
        self._parent = np.zeros(1024, dtype=np.int32)
        self._voxels = np.zeros(1024, dtype=np.int64)
        # x low, x high, y low, y high, z low, z high; the highs are inclusive
        self._boxes = np.zeros((1024, 6), dtype=np.int32)
        self._verdict: Bools | None = None
        self._remembered: deque[_Loose] | None = deque()  # emptied by the second pass
        self._written, self._next_look = 0, _PRUNED_FROM
        self._rewind()
        self._first, self._ids_first = self._below, self._ids_below

    @classmethod
    def decided(cls, ny: int, nx: int, layers: int, verdict: Bools) -> IslandFilter:
        """The filter of a slab whose second pass begins; `verdict` says of each of its ids whether it stays."""
        islands = cls(ny, nx)
        islands._layers, islands._verdict, islands._remembered = layers, verdict, None
        return islands

    def _rewind(self) -> None:
        ny, nx = self._shape
        self._largest = 0  # the id with most voxels, of those known
        self._below = Runs((1, ny, nx), np.zeros(ny + 1, dtype=np.int64), np.zeros(0, dtype=np.int32))
        self._ids_below = np.zeros(0, dtype=np.int32)
        self._n_ids = 0
        self._z = 0

    def _advance(self, layer: U64, counting: bool) -> Runs:
        """Find the runs of the next layer (1, ny, words) and their ids; count their voxels in the first pass."""
        # runs, not voxels: far fewer, and as quick to join
        runs = runs_of_bits(layer, self._shape[1])
        needed = self._n_ids + runs.n_runs
        if needed > self._parent.size:
            self._parent = _grown(self._parent, self._n_ids, needed)
        if counting and needed > self._voxels.size:
            self._voxels, self._boxes = (_grown(of, self._n_ids, needed) for of in (self._voxels, self._boxes))
        ids = np.empty(runs.n_runs, dtype=np.int32)
        self._n_ids, self._largest = layer_ids(
            runs.rows,
            runs.bounds,
            self._below.rows,
            self._below.bounds,
            self._ids_below,
            ids,
            self._parent,
            self._voxels,
            self._boxes,
            self._n_ids,
            self._largest,
            self._z,
            counting,
        )
        self._below, self._ids_below = runs, ids
        self._z += 1
        return runs

    def observe(self, slab: U64) -> int:
        """First pass: take in the next layers, bits (nz, ny, words) as in `services.bit_rows`; how many are set."""
        total = 0
        for k in range(slab.shape[0]):
            runs = self._advance(slab[k : k + 1], counting=True)
            if self._z == 1:
                self._first, self._ids_first = runs, self._ids_below
            voxels = int(runs.lengths.sum())
            total += voxels
            if self._remembered is not None:
                self._remember(runs, voxels)
        self._layers = self._z
        return total

    def _remember(self, runs: Runs, voxels: int) -> None:
        """Store the loose runs of the last layer; give up storing if there are too many."""
        assert self._remembered is not None
        loose = np.empty((0, 4), np.int32)
        main = -1
        if self._n_ids:
            main = int(find_root(self._parent, self._largest))
            loose = np.empty((np.count_nonzero(self._ids_below != main), 4), np.int32)
            list_loose(runs.rows, runs.bounds, self._ids_below, main, loose)
        self._remembered.append(_Loose(voxels, main, loose))
        self._written += len(loose)
        if self._written > self._next_look:
            self._look_through()

    def _look_through(self) -> None:
        """Drop runs that have become one with the largest component since they were stored."""
        assert self._remembered is not None
        main = int(find_root(self._parent, self._largest))
        for number, loose in enumerate(self._remembered):
            if loose.main >= 0 and find_root(self._parent, loose.main) == main:
                still = still_loose(loose.runs[:, 3], self._parent, main)
                self._remembered[number] = loose._replace(runs=loose.runs[still])
        self._written = sum(len(loose.runs) for loose in self._remembered)
        self._next_look = self._written + _PRUNED_FROM
        if self._written > _MAX_STORED:
            self._remembered = None

    def finish(self) -> IslandStatistics:
        """Keep the largest component, the first of equals; `clear` may follow."""
        root = self._parent[: self._n_ids]
        resolve(root, self._voxels, self._boxes)
        kept, statistics = decide(root, self._voxels[: root.size], self._boxes[: root.size], self._layers)
        self._verdict = kept
        self._free()
        return statistics

    def labels(self) -> SlabLabels:
        """End the first pass of a slab that is one of several; nothing else may follow."""
        root = self._parent[: self._n_ids]
        resolve(root, self._voxels, self._boxes)
        is_root = root == np.arange(root.size, dtype=np.int32)
        number = np.cumsum(is_root, dtype=np.int32) - np.int32(1)
        component = number[root]
        made = SlabLabels(
            layers=self._layers,
            component=component,
            voxels=self._voxels[: root.size][is_root],
            boxes=self._boxes[: root.size][is_root],
            first=self._first,
            of_first=component[self._ids_first],
            last=self._below,
            of_last=component[self._ids_below],
        )
        self._verdict = np.zeros(0, dtype=np.bool_)
        self._remembered = None  # the second pass may be another process
        self._free()
        return made

    def _free(self) -> None:
        """Free the arrays that only the first pass needs."""
        self._parent, self._voxels, self._boxes = (
            np.zeros(0, dtype=np.int32),
            np.zeros(0, dtype=np.int64),
            np.zeros((0, 6), dtype=np.int32),
        )
        self._rewind()
        self._first, self._ids_first = self._below, self._ids_below

    def clear(self, slab: U64) -> None:
        """Second pass: take the islands out of the next layers, bits (nz, ny, words); in place.

        An InputError says that the layers are not those of the first pass, as far as that shows.
        """
        if self._z + slab.shape[0] > self._layers:
            raise InputError(f"the second pass has more layers than the first, which had {self._layers}")
        assert self._verdict is not None
        for k in range(slab.shape[0]):
            if self._remembered is None:
                runs = self._advance(slab[k : k + 1], counting=False)
                if self._n_ids > self._verdict.size:
                    raise _other_layer(self._z - 1)
                clear_runs(runs.rows, runs.bounds, self._verdict[self._ids_below], slab[k])
                continue
            loose = self._remembered.popleft()
            # a source that delivers other layers the second time would be cut in the wrong places
            if count(slab[k]) != loose.voxels:
                raise _other_layer(self._z)
            self._z += 1
            if loose.main < 0:
                continue
            # the component that was the largest then may be an island in the end
            main_stays = bool(self._verdict[loose.main])
            # runs that share the fate of the main component need not be touched
            chosen = loose.runs[self._verdict[loose.runs[:, 3]] != main_stays]
            if not main_stays:
                slab[k] = 0
            set_runs(chosen, not main_stays, slab[k])


def decide(root: I32, voxels: I64, boxes: I32, layers: int) -> tuple[Bools, IslandStatistics]:
    """Labels of the largest component, (n,) bool, and the statistics of the components.

    `root` (n,) is that of each label, the smallest one of its component; smaller roots begin at earlier voxels. Voxels
    (n,) and bounding boxes (n, 6) are gathered at the roots.
    """
    is_root = root == np.arange(root.size, dtype=np.int32)
    sizes = np.where(is_root, voxels, 0)
    total = int(sizes.sum())
    if total == 0:
        return np.zeros(0, dtype=np.bool_), IslandStatistics(layers, 0, 0, 0.0, 0.0, (False, False, False))
    # of equals the first one, whose root is the smallest
    largest = int(np.argmax(sizes))
    share = int(sizes[largest]) / total
    # "spans" compares with the box of the phase, not with that of the layers: a part need not fill its stack
    every, own = boxes[is_root], boxes[largest]
    x, y, z = (
        bool(own[2 * a] == every[:, 2 * a].min() and own[2 * a + 1] == every[:, 2 * a + 1].max()) for a in range(3)
    )
    removed = (total - int(sizes[largest])) / total
    found = IslandStatistics(layers, total, int(np.count_nonzero(is_root)), share, removed, (x, y, z))
    return root == largest, found


def _grown(of_ids: NDArray[Any], known: int, needed: int) -> NDArray[Any]:
    """The numbers of the known ids, with room for as many as are needed and half as many again."""
    larger = np.empty((needed + needed // 2, *of_ids.shape[1:]), of_ids.dtype)
    larger[:known] = of_ids[:known]
    return larger


def _other_layer(z: int) -> InputError:
    return InputError(
        f"layer {z} of the second pass is not that of the first",
        hint="both passes must make the same layers from the same input",
    )


@jit
def resolve(parent: I32, voxels: I64, boxes: I32) -> None:
    """Point every id at its root and gather counts and bounding boxes there."""
    # in ascending order the parent of a parent is a root already
    for i in range(parent.size):
        root = parent[parent[i]]  # a parent is never after its child
        parent[i] = root
        if root != i:
            voxels[root] += voxels[i]
            for axis in range(3):
                boxes[root, 2 * axis] = min(boxes[root, 2 * axis], boxes[i, 2 * axis])
                boxes[root, 2 * axis + 1] = max(boxes[root, 2 * axis + 1], boxes[i, 2 * axis + 1])
