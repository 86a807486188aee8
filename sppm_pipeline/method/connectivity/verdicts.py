"""Statistics of components once all voxels were seen, and the verdict which of them stay."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from sppm_pipeline.method.connectivity.runs import Runs
from sppm_pipeline.services.arrays import I32, I64, Bools


class IslandStatistics(NamedTuple):
    """Statistics of the components, from the first pass."""

    layers: int
    voxels: int  # of the phase
    components: int
    kept: int  # components that stay
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


def decide(
    root: I32, voxels: I64, boxes: I32, layers: int, keep: Literal["largest"] | float
) -> tuple[Bools, IslandStatistics]:
    """Roots that stay, (n,) bool, and the statistics of the components; `keep` as in `IslandFilter.finish`.

    `root` (n,) is that of each label, the smallest one of its component; smaller roots begin at earlier voxels. Voxels
    (n,) and bounding boxes (n, 6) are gathered at the roots.
    """
    if keep != "largest" and not 0 < keep <= 1:
        raise ValueError(f"the share of the phase that a kept component holds is in (0, 1], not {keep}")
    is_root = root == np.arange(root.size, dtype=np.int32)
    sizes = np.where(is_root, voxels, 0)
    total = int(sizes.sum())
    if total == 0:
        return np.zeros(0, dtype=np.bool_), IslandStatistics(layers, 0, 0, 0, 0.0, 0.0, (False, False, False))
    # of equals the first one, whose root is the smallest
    largest = int(np.argmax(sizes))
    if keep == "largest":
        kept = np.arange(root.size) == largest
    else:
        kept = is_root & (sizes >= keep * total)
    # "spans" compares with the box of the phase, not with that of the layers: a part need not fill its stack
    every, own = boxes[is_root], boxes[largest]
    x, y, z = (
        bool(own[2 * a] == every[:, 2 * a].min() and own[2 * a + 1] == every[:, 2 * a + 1].max()) for a in range(3)
    )
    statistics = IslandStatistics(
        layers=layers,
        voxels=total,
        components=int(np.count_nonzero(is_root)),
        kept=int(np.count_nonzero(kept)),
        largest_share=int(sizes[largest]) / total,
        removed_share=int(sizes[~kept].sum()) / total,
        spans=(x, y, z),
    )
    return kept, statistics
