"""Statistics of components once all voxels were seen, and the verdict which of them stay."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.method.connectivity.runs import Runs


class IslandStatistics(NamedTuple):
    """Statistics of the components, from the first pass.

    Attributes
    ----------
    layers : int
        Number of layers seen.
    voxels : int
        Voxels of the phase.
    components : int
        Number of connected components.
    kept : int
        How many of them stay.
    largest_share : float
        Fraction of the phase that is in the largest component.
    removed_share : float
        Fraction of the phase that is removed.
    spans : 3 bools
        Whether the largest component reaches, along x, y, z, from the first to the last voxel of the whole phase.
    """

    layers: int
    voxels: int
    components: int
    kept: int
    largest_share: float
    removed_share: float
    spans: tuple[bool, bool, bool]


class SlabLabels(NamedTuple):
    """Components of a slab that was labeled by itself, from the first pass.

    Components are numbered in the order of their first voxels (z slowest).

    Attributes
    ----------
    layers : int
        Number of layers.
    component : (n_ids,) int32
        The component that each id belongs to.
    voxels : (n,) int64
        Voxels of each component.
    boxes : (n, 6) int32
        x low, x high, y low, y high, z low, z high of each; the highs are inclusive, z counts from the slab's first
        layer.
    first, last : Runs
        The runs of the first and of the last layer.
    of_first, of_last : (n_runs,) int32
        The components of these runs.
    """

    layers: int
    component: NDArray[np.int32]
    voxels: NDArray[np.int64]
    boxes: NDArray[np.int32]
    first: Runs
    of_first: NDArray[np.int32]
    last: Runs
    of_last: NDArray[np.int32]


def decide(
    root: NDArray[np.int32],
    voxels: NDArray[np.int64],
    boxes: NDArray[np.int32],
    layers: int,
    keep: Literal["largest"] | float,
) -> tuple[NDArray[np.bool_], IslandStatistics]:
    """Which roots stay, and the statistics of the components.

    Parameters
    ----------
    root : (n,) int32
        The root of each label, the smallest one of its component; smaller roots begin at earlier voxels.
    voxels : (n,) int64
    boxes : (n, 6) int32
        Voxels and bounding boxes, gathered at the roots.
    layers : int
    keep : "largest" or float
        See `IslandFilter.finish`.

    Returns
    -------
    kept : (n,) bool
        Whether a root stays.
    statistics : IslandStatistics

    Raises
    ------
    ValueError
        If the fraction is not in (0, 1].
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
