"""Connectivity of both phases on the torus, by SciPy's labels of faces joined across the borders."""

from __future__ import annotations

import numpy as np
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components


def pieces(phase):
    """Number of connected pieces of a phase on the torus; neighbors share a face."""
    labels, count = ndimage.label(phase)
    pairs = [np.stack([labels.take(0, axis).ravel(), labels.take(-1, axis).ravel()]) for axis in range(3)]
    first, last = np.concatenate(pairs, axis=1)
    touch = (first > 0) & (last > 0)
    graph = coo_array((np.ones(touch.sum()), (first[touch] - 1, last[touch] - 1)), shape=(count, count))
    return connected_components(graph, directed=False)[0]


def is_whole(phase):
    """One piece that crosses each face of the cell somewhere."""
    crosses = all((phase.take(0, axis) & phase.take(-1, axis)).any() for axis in range(3))
    return pieces(phase) == 1 and crosses


def check(cells, inputs, truth):
    """Shares of draws in which a phase is whole."""
    return {
        "solid whole": float(np.mean([is_whole(cell) for cell in cells])),
        "void whole": float(np.mean([is_whole(~cell) for cell in cells])),
        "pieces of void": float(np.mean([pieces(~cell) for cell in cells])),
    }
