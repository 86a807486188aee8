"""Which voxels are inside a mesh that does not quite close: a vote of rays along x, y and z.

A hole spoils only the rays that pass through it, and those along the other two axes mostly do not. Every ray counts
from both of its ends, and each end has one ballot; a sample with more than half of the six is inside.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sppm_pipeline.method.part.ray_crossings import Scan, prepare_scan
from sppm_pipeline.method.part.scanline import Occupancy, count_inside
from sppm_pipeline.services.grid import Grid


class ThreeAxisScan(NamedTuple):
    """A mesh made ready for rays along each axis."""

    x: Scan
    y: Scan
    z: Scan


def prepare_three_axis(vertices: ArrayLike, faces: ArrayLike, grid: Grid) -> ThreeAxisScan:
    """Sort the triangles of a mesh for rays along each axis; see `prepare_scan`."""
    x, y, z = (prepare_scan(vertices, faces, grid, axis) for axis in range(3))
    return ThreeAxisScan(x, y, z)


def vote_layers(
    scan: ThreeAxisScan, start: int, stop: int, rule: Literal["winding", "parity"] = "winding"
) -> Occupancy:
    """The occupancy of layers start <= k < stop by a vote of the three axes; rays along z are counted with every slab.

    Takes all triangles for every slab (the rays along z pass through all layers), so slabs should not be thin. The rule
    "winding" trusts the orientation of the triangles and unites overlapping shells; "parity" does not look at it, for
    meshes whose triangles are wound at random, and cuts out where shells overlap. Undecided are voxels with two to four
    of the six ballots.
    """
    n_x, n_y, n_z = scan.x.shape
    if not 0 <= start <= stop <= n_z:
        raise ValueError(f"layers {start} to {stop} are not among the {n_z} of the grid")
    if rule not in ("winding", "parity"):
        raise ValueError(f"the rule is 'winding' or 'parity', not {rule!r}")
    parity = rule == "parity"
    n = stop - start
    votes = np.zeros((n, n_y, n_x), dtype=np.uint8)
    along_y = np.zeros((n, n_x, n_y), dtype=np.uint8)
    # rays along z see only the samples of this slab, but cross all triangles above and below
    along_z = np.zeros((n_y, n_x, n), dtype=np.uint8)
    counts = [
        count_inside(scan.x, start, stop, 0, votes, ballots=True, parity=parity),
        count_inside(scan.y, start, stop, 0, along_y, ballots=True, parity=parity),
        count_inside(scan.z, 0, n_y, start, along_z, ballots=True, parity=parity),
    ]
    votes += along_y.transpose(0, 2, 1)
    votes += along_z.transpose(2, 0, 1)
    # a majority of six ballots, two of each axis
    mask = (votes > 3).view(np.uint8)
    split = int(np.count_nonzero((votes > 1) & (votes < 5)))
    return Occupancy(mask, sum(c for c, _ in counts), sum(o for _, o in counts), split)
