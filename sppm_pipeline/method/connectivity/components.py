"""Connected components of a phase on a box whose axes may be periodic, and what they say about the phase.

Two steps. Inside the box, runs that touch are united. Then the components of the box are the nodes of a small graph
whose edges cross the periodic seams; a union-find with integer offsets merges them and notices closed loops with a net
shift: such a component is connected to its own periodic image, it *wraps*.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sppm_pipeline.method.connectivity.runs import Runs, as_bytes, find_runs, join_rows, neighbor_reach
from sppm_pipeline.services.arrays import I32, I64, U8, Bools
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.union_find import unite_shifted


class Components(NamedTuple):
    """The components of a phase, numbered from 0 by decreasing size, ties by their first voxel.

    Attributes
    ----------
    runs : Runs
        The runs of the phase.
    of_run : (n_runs,) int32
        Component of each run.
    sizes : (n,) int64
        Voxels in each component.
    wraps : (n, 3) bool
        Whether a component holds a closed loop with a net shift along x, y, z; False along axes that are not periodic.
    faces : (n, 6) bool
        Whether a component has voxels in the first and last layer along x, y, z: (x low, x high, y low, ..., z high).
    """

    runs: Runs
    of_run: I32
    sizes: I64
    wraps: Bools
    faces: Bools


def find_components(
    mask: Bools | U8,
    periodic: tuple[bool, bool, bool] = (False, False, False),
    connectivity: int = 6,
    zeros: bool = False,
) -> Components:
    """Find the connected components of a phase.

    Parameters
    ----------
    mask : (nz, ny, nx) bool or uint8
        The phase; anything but 0 belongs to it.
    periodic : 3 bools
        Whether opposite faces are merged, along x, y, z.
    connectivity : {6, 26}
        Voxels are neighbors across faces, or across faces, edges and corners.
    zeros : bool
        Take the voxels that are 0 as the phase.

    Returns
    -------
    Components
    """
    return components_of_runs(find_runs(as_bytes(mask), zeros), periodic, connectivity)


def components_of_runs(
    runs: Runs, periodic: tuple[bool, bool, bool] = (False, False, False), connectivity: int = 6
) -> Components:
    """`find_components` of a mask that is there only as its runs."""
    reach = neighbor_reach(connectivity)
    nz, ny, nx = runs.shape
    # the component of a run inside the box, its size in voxels and the faces it touches as bits
    # first the box without seams, then its components across the seams: far fewer than runs
    in_box, sizes, faces = _box_components(runs.rows, runs.bounds, nz, ny, nx, reach)
    if any(periodic):
        merged, wraps = _cross_seams(
            runs.rows, runs.bounds, in_box, sizes.size, nz, ny, nx, reach, np.array(periodic, dtype=np.bool_)
        )
        roots, group = np.unique(merged, return_inverse=True)
        all_faces = np.zeros(roots.size, dtype=np.uint8)
        np.bitwise_or.at(all_faces, group, faces)
        sizes = np.bincount(group, weights=sizes, minlength=roots.size).astype(np.int64)
        faces, wraps = all_faces, wraps[roots]
    else:
        group = np.arange(sizes.size)
        wraps = np.zeros((sizes.size, 3), dtype=np.bool_)
    # roots are the first of their components, so a stable sort breaks ties by the first voxel
    order = np.argsort(-sizes, kind="stable")
    number = np.empty(order.size, dtype=np.int32)
    number[order] = np.arange(order.size, dtype=np.int32)
    # bits 0 to 5: low x, high x, low y, high y, low z, high z
    touched = np.unpackbits(faces[order, None], axis=1, bitorder="little")[:, :6].astype(np.bool_)
    return Components(runs, number[group][in_box], sizes[order], wraps[order], touched)


@jit
def _box_components(rows: I64, bounds: I32, nz: int, ny: int, nx: int, reach: int) -> tuple[I32, I64, U8]:
    n_runs = bounds.size // 2
    parent = np.arange(n_runs).astype(np.int32)
    for z in range(nz):
        for y in range(ny):
            here = z * ny + y
            a, a_stop = rows[here], rows[here + 1]
            if a == a_stop:
                continue
            if y > 0:
                join_rows(bounds, a, a_stop, rows[here - 1], rows[here], reach, parent)
            if z > 0:
                for dy in range(-reach, reach + 1):
                    if 0 <= y + dy < ny:
                        below = here - ny + dy
                        join_rows(bounds, a, a_stop, rows[below], rows[below + 1], reach, parent)
    # number the roots in their order; a parent is never after its child, so one pass resolves all
    count = 0
    for r in range(n_runs):
        if parent[r] == r:
            # roots come first, so their numbers ascend with the first voxels
            parent[r] = count
            count += 1
        else:
            parent[r] = parent[parent[r]]
    sizes = np.zeros(count, np.int64)
    faces = np.zeros(count, np.uint8)
    for z in range(nz):
        for y in range(ny):
            row_bits = np.uint8(0)
            row_bits |= np.uint8(4) * np.uint8(y == 0) | np.uint8(8) * np.uint8(y == ny - 1)
            row_bits |= np.uint8(16) * np.uint8(z == 0) | np.uint8(32) * np.uint8(z == nz - 1)
            for r in range(rows[z * ny + y], rows[z * ny + y + 1]):
                c = parent[r]
                sizes[c] += bounds[2 * r + 1] - bounds[2 * r]
                faces[c] |= row_bits | np.uint8(bounds[2 * r] == 0) | np.uint8(2) * np.uint8(bounds[2 * r + 1] == nx)
    return parent, sizes, faces


@jit
def _cross_seams(
    rows: I64, bounds: I32, in_box: I32, count: int, nz: int, ny: int, nx: int, reach: int, periodic: Bools
) -> tuple[I32, Bools]:
    """Merge the components of the box across its periodic seams: (root of each, wraps of each root)."""
    parent = np.arange(count).astype(np.int32)
    offset = np.zeros((count, 3), np.int32)
    wraps = np.zeros((count, 3), np.bool_)
    for z in range(nz):
        for y in range(ny):
            a_first, a_stop = rows[z * ny + y], rows[z * ny + y + 1]
            if a_first == a_stop:
                continue
            # of each pair of opposite neighbors, the one that comes later in the order; only across a seam
            for step in range(14, 27):
                dz, dy, sx = step // 9 - 1, step // 3 % 3 - 1, step % 3 - 1
                if reach == 0 and abs(dz) + abs(dy) + abs(sx) > 1:
                    continue
                sy, sz = (y + dy) // ny, (z + dz) // nz
                if (sx == 0 and sy == 0 and sz == 0) or (sx != 0 and not periodic[0]):
                    continue
                if (sy != 0 and not periodic[1]) or (sz != 0 and not periodic[2]):
                    continue
                row = (z + dz - sz * nz) * ny + y + dy - sy * ny
                a, a_end, b, b_end = a_first, a_stop, rows[row], rows[row + 1]
                # across the seam along x, only the outermost runs can meet
                if sx > 0:
                    a, b_end = a_stop - 1, min(b + 1, b_end)
                elif sx < 0:
                    a_end, b = a_first + 1, max(b, b_end - 1)
                touch = 1 if dy == 0 and dz == 0 else reach
                while a < a_end and b < b_end:
                    # runs of the neighboring image
                    b_begins, b_ends = bounds[2 * b] + sx * nx, bounds[2 * b + 1] + sx * nx
                    if bounds[2 * a + 1] + touch <= b_begins:
                        a += 1
                    elif b_ends + touch <= bounds[2 * a]:
                        b += 1
                    else:
                        unite_shifted(parent, offset, wraps, in_box[a], in_box[b], sx, sy, sz)
                        if bounds[2 * a + 1] < b_ends:
                            a += 1
                        else:
                            b += 1
    for c in range(count):
        parent[c] = parent[parent[c]]  # a parent is never after its child
    return parent, wraps


@jit
def paint_runs(rows: I64, bounds: I32, value: I32, out: I32) -> None:
    """Write value[r] into the voxels of each run r; `out` is (nz, ny, nx) and the rest is left as it is."""
    nz, ny, _ = out.shape
    for z in range(nz):
        for y in range(ny):
            row = out[z, y]
            for r in range(rows[z * ny + y], rows[z * ny + y + 1]):
                row[bounds[2 * r] : bounds[2 * r + 1]] = value[r]


class PhaseReport(NamedTuple):
    """Connectivity of one phase.

    Attributes
    ----------
    components : int
        Number of connected components; 0 for an empty phase.
    largest_share : float
        Fraction of the phase that is in its largest component; 0 for an empty phase.
    wraps : 3 bools
        Whether the largest component runs through along x, y, z: along a periodic axis, whether it is connected to its
        own periodic image; along another, whether it reaches from the first to the last layer.
    removed_share : float
        Fraction of the phase that goes when only the largest component is kept.
    """

    components: int
    largest_share: float
    wraps: tuple[bool, bool, bool]
    removed_share: float


def phase_report(
    mask: Bools | U8,
    periodic: tuple[bool, bool, bool] = (True, True, True),
    connectivity: int = 6,
    *,
    zeros: bool = False,
) -> PhaseReport:
    """Report the connectivity of one phase.

    Use 6 for both phases, though the topological dual of a 6-connected solid is a 26-connected void: two solid voxels
    that share only an edge carry no load and two void voxels that share only an edge let no resin out, so connection
    across faces is the strict measure, on the safe side, for either.

    Parameters
    ----------
    mask : (nz, ny, nx) bool or uint8
        The phase; anything but 0 belongs to it.
    periodic : 3 bools
        Whether opposite faces are merged, along x, y, z.
    connectivity : {6, 26}
        Neighbors across faces, or across faces, edges and corners.
    zeros : bool
        Report the other phase, the voxels that are 0, without a copy of the mask.

    Returns
    -------
    PhaseReport
    """
    found = find_components(mask, periodic, connectivity, zeros)
    if found.sizes.size == 0:
        return PhaseReport(0, 0.0, (False, False, False), 0.0)
    total = int(found.sizes.sum())
    largest = int(found.sizes[0])
    low, high = found.faces[0, ::2], found.faces[0, 1::2]
    x, y, z = (bool(v) for v in np.where(np.array(periodic), found.wraps[0], low & high))
    return PhaseReport(int(found.sizes.size), largest / total, (x, y, z), (total - largest) / total)
