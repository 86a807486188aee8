"""Sets that are united: each element has a parent, and a root is its own."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.jit.compiled import jit


@jit
def find_root(parent: NDArray[np.signedinteger[Any]], i: int) -> int:
    """Root of `i` in a union-find forest whose parents never have a larger index; halves the path on its way."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@jit
def unite(parent: NDArray[np.signedinteger[Any]], i: int, j: int) -> None:
    """Unite the components of two members of such a forest; the smaller root stays."""
    root_i = find_root(parent, i)
    root_j = find_root(parent, j)
    if root_i < root_j:
        parent[root_j] = root_i
    elif root_j < root_i:
        parent[root_i] = root_j
