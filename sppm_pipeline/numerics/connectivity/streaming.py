"""Floating islands of a part whose layers come slab by slab and are never all in memory.

Islands have to be removed on the assembly, never per tile: what floats in a tile may be held by its neighbor. So the
part is gone through twice. The first pass gives every two-dimensional component of a layer an *id*: the smallest id
that it touches in the layer below, or a new one. Ids that turn out to be one component are united, and voxels are
counted per id. The second pass meets the same layers, derives the same ids in the same way, without any union, and
looks up whether they stay.

Slabs may also be labeled apart from each other, each by a filter of its own: `IslandFilter.labels` ends the first pass
of a slab, `slab_union` unites them, and `IslandFilter.decided` begins the second pass.

Kept between layers are the runs of one layer and their ids; besides, some forty bytes per id until `finish`, and one
byte afterwards. A new id is needed only where a two-dimensional component lies on nothing below: a few per cell. The
ids of the first layers, as many as fit into 16 MB, wait for the second pass, which then need not derive them.
"""

from __future__ import annotations

from collections import deque
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import InputError
from sppm_pipeline.numerics.compiled import jit
from sppm_pipeline.numerics.connectivity.islands import clear_runs
from sppm_pipeline.numerics.connectivity.runs import Runs, as_bytes, find_runs, join_rows, neighbor_reach, unite
from sppm_pipeline.numerics.connectivity.verdicts import IslandStatistics, SlabLabels, decide

_REMEMBERED = 1 << 22
"""Runs whose ids are kept from the first pass for the second one."""


class IslandFilter:
    """Remove floating islands in two passes over the same slabs.

    Call `observe` for every slab in the order of z, `finish` once, then `clear` for every slab in the same order (the
    slabs may be cut differently). The result is that of labeling all layers at once.

    Parameters
    ----------
    ny, nx : int
        Size of a layer.
    connectivity : {6, 26}
        Neighbors across faces, or across faces, edges and corners.
    """

    def __init__(self, ny: int, nx: int, connectivity: int = 6) -> None:
        self._shape = (ny, nx)
        self._reach = neighbor_reach(connectivity)
        self._layers = 0
        self._parent = np.zeros(1024, dtype=np.int32)
        self._voxels = np.zeros(1024, dtype=np.int64)
        # x low, x high, y low, y high, z low, z high; the highs are inclusive
        self._boxes = np.zeros((1024, 6), dtype=np.int32)
        self._verdict: NDArray[np.bool_] | None = None
        # of the first layers, the ids of their runs and how many ids there are so far; emptied by the second pass
        self._remembered: deque[tuple[NDArray[np.int32], int]] = deque()
        self._room = _REMEMBERED
        self._rewind()
        self._first, self._ids_first = self._below, self._ids_below

    @classmethod
    def decided(cls, ny: int, nx: int, layers: int, verdict: NDArray[np.bool_], connectivity: int = 6) -> IslandFilter:
        """The filter of a slab whose second pass begins; `verdict` says of each of its ids whether it stays."""
        islands = cls(ny, nx, connectivity)
        islands._layers, islands._verdict = layers, verdict
        return islands

    def _rewind(self) -> None:
        ny, nx = self._shape
        self._below = Runs((1, ny, nx), np.zeros(ny + 1, dtype=np.int64), np.zeros(0, dtype=np.int32))
        self._ids_below = np.zeros(0, dtype=np.int32)
        self._n_ids = 0
        self._z = 0

    def _bytes(self, slab: NDArray[np.bool_] | NDArray[np.uint8]) -> NDArray[np.uint8]:
        if slab.ndim != 3 or slab.shape[1:] != self._shape:
            raise ValueError(f"a slab is (nz, {self._shape[0]}, {self._shape[1]}), not {slab.shape}")
        return as_bytes(slab)

    def _advance(self, layer: NDArray[np.uint8], joining: bool) -> Runs:
        """Find the runs of the next layer and their ids; unite ids if `joining`."""
        runs = find_runs(layer)
        if joining and self._n_ids + runs.n_runs > self._parent.size:
            room = ((0, self._n_ids + 2 * runs.n_runs),)
            self._parent = np.pad(self._parent, room)
            self._voxels = np.pad(self._voxels, room)
            self._boxes = np.pad(self._boxes, (*room, (0, 0)))
        if not joining and self._remembered:
            ids, self._n_ids = self._remembered.popleft()
            if ids.size != runs.n_runs:
                raise _other_layer(self._z)
        else:
            ids = np.empty(runs.n_runs, dtype=np.int32)
            self._n_ids = _layer_ids(
                runs.rows,
                runs.bounds,
                self._below.rows,
                self._below.bounds,
                self._ids_below,
                ids,
                self._parent,
                self._n_ids,
                self._reach,
                joining,
            )
            if joining and runs.n_runs <= self._room:
                self._remembered.append((ids, self._n_ids))
                self._room -= runs.n_runs
            elif joining:
                self._room = -1  # only the first layers, with none missing in between
        self._below, self._ids_below = runs, ids
        self._z += 1
        return runs

    def observe(self, slab: NDArray[np.bool_] | NDArray[np.uint8]) -> None:
        """First pass: take in the next layers.

        Parameters
        ----------
        slab : (nz, ny, nx) bool or uint8
            Anything but 0 belongs to the phase.
        """
        if self._verdict is not None:
            raise ValueError("observe comes before finish")
        layers = self._bytes(slab)
        for k in range(layers.shape[0]):
            known = self._n_ids
            runs = self._advance(layers[k : k + 1], joining=True)
            if self._z == 1:
                self._first, self._ids_first = runs, self._ids_below
            _count_runs(
                runs.rows, runs.bounds, self._ids_below, known, self._n_ids, self._z - 1, self._voxels, self._boxes
            )
        self._layers = self._z

    def finish(self, keep: Literal["largest"] | float = "largest") -> IslandStatistics:
        """Decide what stays; `clear` may follow.

        Parameters
        ----------
        keep : "largest" or float
            Keep the largest component only (the first of equals), or all that hold at least this fraction of the phase.

        Returns
        -------
        IslandStatistics

        Raises
        ------
        ValueError
            If the fraction is not in (0, 1].
        """
        if self._verdict is not None:
            raise ValueError("finish comes once")
        root = self._parent[: self._n_ids]
        _resolve(root, self._voxels, self._boxes)
        kept, statistics = decide(root, self._voxels[: root.size], self._boxes[: root.size], self._layers, keep)
        self._verdict = kept[root]
        self._forget()
        return statistics

    def labels(self) -> SlabLabels:
        """End the first pass of a slab that is one of several; nothing else may follow.

        Raises
        ------
        ValueError
            If no layer was observed, or the first pass has ended already.
        """
        if self._verdict is not None or not self._layers:
            raise ValueError("labels come once, after the layers of a slab")
        root = self._parent[: self._n_ids]
        _resolve(root, self._voxels, self._boxes)
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
        self._remembered.clear()  # the second pass may be another process
        self._forget()
        return made

    def _forget(self) -> None:
        """What only the first pass needs."""
        self._parent, self._voxels, self._boxes = (
            np.zeros(0, dtype=np.int32),
            np.zeros(0, dtype=np.int64),
            np.zeros((0, 6), dtype=np.int32),
        )
        self._rewind()
        self._first, self._ids_first = self._below, self._ids_below

    def clear(
        self, slab: NDArray[np.bool_] | NDArray[np.uint8], out: NDArray[np.uint8] | None = None
    ) -> NDArray[np.uint8]:
        """Second pass: take the islands out of the next layers.

        Parameters
        ----------
        slab : (nz, ny, nx) bool or uint8
            The same layers, in the same order, as in the first pass.
        out : (nz, ny, nx) uint8, C-contiguous, optional
            Where the result goes; may be `slab` itself, which saves a copy.

        Returns
        -------
        (nz, ny, nx) uint8
            The slab with 0 in the voxels of islands.

        Raises
        ------
        InputError
            If the layers are not those of the first pass, as far as that shows.
        """
        if self._verdict is None:
            raise ValueError("clear comes after finish")
        layers = self._bytes(slab)
        if out is None:
            out = layers.copy()
        elif out is not slab:
            out[...] = layers
        if self._z + layers.shape[0] > self._layers:
            raise InputError(f"the second pass has more layers than the first, which had {self._layers}")
        for k in range(layers.shape[0]):
            runs = self._advance(layers[k : k + 1], joining=False)
            if self._n_ids > self._verdict.size:
                raise _other_layer(self._z - 1)
            clear_runs(runs.rows, runs.bounds, self._verdict[self._ids_below], out[k : k + 1].view(np.uint8))
        return out


def resolve(parent: NDArray[np.int32], voxels: NDArray[np.int64], boxes: NDArray[np.int32]) -> None:
    """Point every label at its root and gather voxels and bounding boxes there; in place."""
    _resolve(parent, voxels, boxes)


def _other_layer(z: int) -> InputError:
    return InputError(
        f"layer {z} of the second pass is not that of the first",
        hint="both passes must make the same layers from the same input",
    )


@jit
def _layer_ids(
    rows: NDArray[np.int64],
    bounds: NDArray[np.int32],
    rows_below: NDArray[np.int64],
    bounds_below: NDArray[np.int32],
    ids_below: NDArray[np.int32],
    ids: NDArray[np.int32],
    parent: NDArray[np.int32],
    n_ids: int,
    reach: int,
    joining: bool,
) -> int:
    """Write the id of each run of a layer into `ids`; returns the number of ids so far."""
    ny = rows.size - 1
    n_runs = bounds.size // 2
    local = np.arange(n_runs).astype(np.int32)
    for y in range(1, ny):
        join_rows(bounds, rows[y], rows[y + 1], rows[y - 1], rows[y], reach, local)
    for r in range(n_runs):
        local[r] = local[local[r]]  # a parent is never after its child
        ids[r] = -1
    # unions go on while the smallest id of a component is still sought: the order doesn't matter
    for y in range(ny):
        for dy in range(-reach, reach + 1):
            if y + dy < 0 or y + dy >= ny:
                continue
            a, a_stop = rows[y], rows[y + 1]
            b, b_stop = rows_below[y + dy], rows_below[y + dy + 1]
            while a < a_stop and b < b_stop:
                if bounds[2 * a + 1] + reach <= bounds_below[2 * b]:
                    a += 1
                elif bounds_below[2 * b + 1] + reach <= bounds[2 * a]:
                    b += 1
                else:
                    c = local[a]
                    mine, other = ids[c], ids_below[b]
                    if mine != other:
                        if mine < 0:
                            ids[c] = other
                        else:
                            if joining:
                                unite(parent, mine, other)
                            ids[c] = min(mine, other)
                    if bounds[2 * a + 1] < bounds_below[2 * b + 1]:
                        a += 1
                    else:
                        b += 1
    for r in range(n_runs):
        if local[r] == r:
            if ids[r] < 0:
                ids[r] = n_ids
                if joining:
                    parent[n_ids] = n_ids
                n_ids += 1
        else:
            ids[r] = ids[local[r]]
    return n_ids


@jit
def _count_runs(
    rows: NDArray[np.int64],
    bounds: NDArray[np.int32],
    ids: NDArray[np.int32],
    known: int,
    n_ids: int,
    z: int,
    voxels: NDArray[np.int64],
    boxes: NDArray[np.int32],
) -> None:
    """Add a layer's voxels to the counts and bounding boxes of its ids; ids from `known` on are new."""
    for i in range(known, n_ids):
        voxels[i] = 0
        for axis in range(3):
            boxes[i, 2 * axis] = 2147483647
            boxes[i, 2 * axis + 1] = -1
    for y in range(rows.size - 1):
        for r in range(rows[y], rows[y + 1]):
            i = ids[r]
            box = boxes[i]
            voxels[i] += bounds[2 * r + 1] - bounds[2 * r]
            box[0] = min(box[0], bounds[2 * r])
            box[1] = max(box[1], bounds[2 * r + 1] - 1)
            box[2] = min(box[2], y)
            box[3] = max(box[3], y)
            box[4] = min(box[4], z)
            box[5] = z


@jit
def _resolve(parent: NDArray[np.int32], voxels: NDArray[np.int64], boxes: NDArray[np.int32]) -> None:
    """Point every id at its root and gather counts and bounding boxes there."""
    for i in range(parent.size):
        root = parent[parent[i]]  # a parent is never after its child
        parent[i] = root
        if root != i:
            voxels[root] += voxels[i]
            for axis in range(3):
                boxes[root, 2 * axis] = min(boxes[root, 2 * axis], boxes[i, 2 * axis])
                boxes[root, 2 * axis + 1] = max(boxes[root, 2 * axis + 1], boxes[i, 2 * axis + 1])
