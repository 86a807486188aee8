"""Which voxels are inside a mesh: signed scanlines.

Rays run along the rows of a grid. A ray that enters the solid counts +1, one that leaves -1, and a sample is inside
where the sum so far is positive; so shells that overlap are united, where an even-odd rule would cut them out.

A mesh that does not quite close is put to the vote of rays along x, y and z: a hole spoils only the rays that pass
through it, and those along the other two axes mostly do not. Every ray counts from both of its ends, and each end has
one ballot; a sample with more than half of the six is inside.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sppm_pipeline.method.part.ray_crossings import Scan, prepare_scan, ray_crossings
from sppm_pipeline.services.arrays import I64, U8, U64
from sppm_pipeline.services.bit_rows import fill_span, unpack, words_of
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.jit.compiled import jit


class Occupancy(NamedTuple):
    """Some layers of an occupancy."""

    mask: U8  # (nz, ny, nx), 1 inside
    undecided: int = 0  # voxels about which rays or winding number are not of one mind


def scan_layers(scan: Scan, start: int, stop: int) -> Occupancy:
    """The occupancy of layers start <= k < stop by rays along x, bit for bit however the part is cut into slabs.

    A ray that does not close is filled only where the count from either end says inside, so that a hole in the mesh
    does not leak to the end of the row.
    """
    return Occupancy(unpack(scan_bits(scan, start, stop), scan.shape[0]))


def scan_bits(scan: Scan, start: int, stop: int) -> U64:
    """The mask of `scan_layers` as bits, (stop - start, ny, words), see `services.bit_rows`."""
    n_ray, n_row, _ = scan.shape
    bits = np.zeros((stop - start, n_row, words_of(n_ray)), np.uint64)
    for first, last, starts, keys in ray_crossings(scan, start, stop):
        _fill_bits(starts, keys, n_ray, bits[first - start : last - start].reshape(-1, bits.shape[2]))
    return bits


def add_ballots(scan: Scan, start: int, stop: int, ray_start: int, out: U8) -> None:
    """Count the votes of both ends of each ray, in layers start <= k < stop along the third axis of the scan.

    To `out` (stop - start, rows, samples from `ray_start` on) two are added where both ends say inside, and one where
    one of them does.
    """
    for first, last, starts, keys in ray_crossings(scan, start, stop):
        part, out = out[: last - first], out[last - first :]
        _add_ballots(starts, keys, ray_start, part)


@jit
def _add_ballots(starts: I64, keys: I64, ray_start: int, out: U8) -> None:
    _, n_row, width = out.shape
    for r in range(starts.size - 1):
        row = out[r // n_row, r % n_row]
        total = 0
        for i in range(starts[r], starts[r + 1]):
            total += 1 if keys[i] & 1 else -1
        # between two crossings, `count` is the sum so far and `total - count` the sum that is still to come
        count = 0
        begin = 0
        for i in range(starts[r], starts[r + 1] + 1):
            end = min(max((keys[i] >> 1) - ray_start, 0), width) if i < starts[r + 1] else width
            # inside as seen from the low end, and as seen from the high end
            votes = int(count > 0) + int(count > total)
            if votes > 0:
                for x in range(begin, end):
                    row[x] += np.uint8(votes)
            begin = max(begin, end)
            if i < starts[r + 1]:
                count += 1 if keys[i] & 1 else -1


@jit
def _fill_bits(starts: I64, keys: I64, width: int, out: U64) -> None:
    """Set what the counts from both ends of the ray call inside."""
    for r in range(starts.size - 1):
        total = 0
        for i in range(starts[r], starts[r + 1]):
            total += 1 if keys[i] & 1 else -1
        count = begin = 0
        for i in range(starts[r], starts[r + 1] + 1):
            end = min(keys[i] >> 1, width) if i < starts[r + 1] else width
            if begin < end:
                if count > 0 and count > total:
                    fill_span(out[r], begin, end)
                begin = end
            if i < starts[r + 1]:
                count += 1 if keys[i] & 1 else -1


class ThreeAxisScan(NamedTuple):
    """A mesh made ready for rays along each axis."""

    x: Scan
    y: Scan
    z: Scan


def prepare_three_axis(vertices: ArrayLike, faces: ArrayLike, grid: Grid) -> ThreeAxisScan:
    """Sort the triangles of a mesh for rays along each axis; see `prepare_scan`."""
    x, y, z = (prepare_scan(vertices, faces, grid, axis) for axis in range(3))
    return ThreeAxisScan(x, y, z)


def vote_layers(scan: ThreeAxisScan, start: int, stop: int) -> Occupancy:
    """The occupancy of layers start <= k < stop by a vote of the three axes; shells that overlap are united.

    Takes all triangles for every slab (the rays along z pass through all layers), so slabs should not be thin.
    Undecided are voxels with two to four of the six ballots.
    """
    n_x, n_y, _ = scan.x.shape
    n = stop - start
    votes = np.zeros((n, n_y, n_x), dtype=np.uint8)
    along_y = np.zeros((n, n_x, n_y), dtype=np.uint8)
    # rays along z see only the samples of this slab, but cross all triangles above and below
    along_z = np.zeros((n_y, n_x, n), dtype=np.uint8)
    add_ballots(scan.x, start, stop, 0, votes)
    add_ballots(scan.y, start, stop, 0, along_y)
    add_ballots(scan.z, 0, n_y, start, along_z)
    votes += along_y.transpose(0, 2, 1)
    votes += along_z.transpose(2, 0, 1)
    # a majority of six ballots, two of each axis
    return Occupancy((votes > 3).view(np.uint8), int(np.count_nonzero((votes > 1) & (votes < 5))))
