"""Which voxels are inside a mesh: signed scanlines.

Rays run along the rows of a grid. A ray that enters the solid counts +1, one that leaves -1, and a sample is inside
where the sum so far is positive; so shells that overlap are united, where an even-odd rule would cut them out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.method.part.ray_crossings import Scan, ray_crossings
from sppm_pipeline.services.bit_rows import fill_span, words_of
from sppm_pipeline.services.jit.compiled import jit


class Occupancy(NamedTuple):
    """Some layers of an occupancy."""

    mask: NDArray[np.uint8]  # (nz, ny, nx), 1 inside
    crossed_rays: int  # rays that meet the mesh
    open_rays: int  # those that do not leave as often as they enter; 0 for a closed mesh wound consistently
    undecided: int = 0  # voxels about which rays or winding number are not of one mind


def scan_layers(scan: Scan, start: int, stop: int) -> Occupancy:
    """The occupancy of layers start <= k < stop by rays along x, bit for bit however the part is cut into slabs.

    A ray that does not close is filled only where the count from either end says inside, so that a hole in the mesh
    does not leak to the end of the row.
    """
    n_ray, n_row, n_layer = scan.shape
    if not 0 <= start <= stop <= n_layer:
        raise ValueError(f"layers {start} to {stop} are not among the {n_layer} of the grid")
    mask = np.zeros((stop - start, n_row, n_ray), dtype=np.uint8)
    crossed, opened = count_inside(scan, start, stop, 0, mask)
    return Occupancy(mask, crossed, opened)


def scan_bits(scan: Scan, start: int, stop: int) -> NDArray[np.uint64]:
    """The mask of `scan_layers` as bits, (stop - start, ny, words), see `services.bit_rows`."""
    n_ray, n_row, n_layer = scan.shape
    if not 0 <= start <= stop <= n_layer:
        raise ValueError(f"layers {start} to {stop} are not among the {n_layer} of the grid")
    bits = np.zeros((stop - start, n_row, words_of(n_ray)), np.uint64)
    for first, last, starts, keys in ray_crossings(scan, start, stop):
        _fill_bits(starts, keys, n_ray, bits[first - start : last - start].reshape(-1, bits.shape[2]))
    return bits


def count_inside(
    scan: Scan,
    start: int,
    stop: int,
    ray_start: int,
    out: NDArray[np.uint8],
    *,
    ballots: bool = False,
    parity: bool = False,
) -> tuple[int, int]:
    """Scan layers start <= k < stop, along the third axis of the scan; the numbers of crossed and of open rays.

    `out` (stop - start, rows, samples from `ray_start` on) gets 1 where the counts from both ends of the ray say
    inside. With `ballots` two are added there instead, and one where one of them does. With `parity` inside is where
    the number of crossings, whatever their sign, is odd.
    """
    crossed = opened = 0
    for first, last, starts, keys in ray_crossings(scan, start, stop):
        part, out = out[: last - first], out[last - first :]
        more_crossed, more_opened = _fill(starts, keys, ray_start, part, ballots, parity)
        crossed += more_crossed
        opened += more_opened
    return crossed, opened


@jit
def _fill(
    starts: NDArray[np.int64],
    keys: NDArray[np.int64],
    ray_start: int,
    out: NDArray[np.uint8],
    ballots: bool,
    parity: bool,
) -> tuple[int, int]:
    _, n_row, width = out.shape
    crossed = 0
    opened = 0
    for r in range(starts.size - 1):
        if starts[r] == starts[r + 1]:
            continue
        row = out[r // n_row, r % n_row]
        crossed += 1
        total = 0
        for i in range(starts[r], starts[r + 1]):
            total += 1 if parity or keys[i] & 1 else -1
        # a ray that enters a closed mesh leaves it
        if (parity and total & 1) or (not parity and total != 0):
            opened += 1
        # between two crossings, `count` is the sum so far and `total - count` the sum that is still to come
        count = 0
        begin = 0
        for i in range(starts[r], starts[r + 1] + 1):
            end = width
            if i < starts[r + 1]:
                end = min(max((keys[i] >> 1) - ray_start, 0), width)
            if parity:
                votes = (count & 1) + ((total - count) & 1)
            else:
                # inside as seen from the low end, and as seen from the high end
                votes = int(count > 0) + int(count > total)
            if begin < end:
                if ballots:
                    if votes > 0:
                        for x in range(begin, end):
                            row[x] += np.uint8(votes)
                elif votes == 2:
                    row[begin:end] = 1
            begin = max(begin, end)
            if i < starts[r + 1]:
                count += 1 if parity or keys[i] & 1 else -1
    return crossed, opened


@jit
def _fill_bits(starts: NDArray[np.int64], keys: NDArray[np.int64], width: int, out: NDArray[np.uint64]) -> None:
    """Set what the counts from both ends of the ray call inside; as `_fill`, of which this is the common case."""
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
