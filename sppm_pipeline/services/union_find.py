"""Sets that are united: each element has a parent, and a root is its own."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.arrays import I32, Bools
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


@jit
def _lift(parent: I32, offset: I32, c: int) -> tuple[int, int, int, int]:
    """Root of c, and the shift (in cells along x, y, z) of c against its root."""
    x, y, z = 0, 0, 0
    while parent[c] != c:
        p = parent[c]
        if parent[p] != p:
            # path halving; the shift of a node is that against its new parent then
            for axis in range(3):
                offset[c, axis] += offset[p, axis]
            parent[c] = parent[p]
        x += offset[c, 0]
        y += offset[c, 1]
        z += offset[c, 2]
        c = parent[c]
    return c, x, y, z


@jit
def unite_shifted(parent: I32, offset: I32, wraps: Bools, a: int, b: int, sx: int, sy: int, sz: int) -> None:
    """Component a touches the image of component b that is shifted by (sx, sy, sz) cells."""
    root_a, ax, ay, az = _lift(parent, offset, a)
    root_b, bx, by, bz = _lift(parent, offset, b)
    dx, dy, dz = ax + sx - bx, ay + sy - by, az + sz - bz
    # the component meets an image of itself: along axes with a shift it goes round the torus
    if root_a == root_b:
        wraps[root_a, 0] |= dx != 0
        wraps[root_a, 1] |= dy != 0
        wraps[root_a, 2] |= dz != 0
        return
    # the smaller root stays, so that numbers follow the first voxel
    if root_b < root_a:
        root_a, root_b = root_b, root_a
        dx, dy, dz = -dx, -dy, -dz
    parent[root_b] = root_a
    offset[root_b, 0] = dx
    offset[root_b, 1] = dy
    offset[root_b, 2] = dz
    for axis in range(3):
        wraps[root_a, axis] |= wraps[root_b, axis]
