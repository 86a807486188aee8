"""All kernels of a tiling that reach a box: the exact way to its field, for any grid."""

from __future__ import annotations

from threading import Lock
from typing import Any, NamedTuple

import numpy as np

from sppm_pipeline.method.assembly.contents import (
    PIECES_A_SITE,
    PieceNumbers,
    Pieces,
    TilingArrays,
    site_pieces,
    sites_between,
)
from sppm_pipeline.method.kernels.kernels import Kernels, boxes_meet, empty_kernels, half_boxes, kernel_reaches
from sppm_pipeline.method.kernels.profiles import DEFAULT_CUTOFF
from sppm_pipeline.method.kernels.splat import Prepared, add_prepared, prepared
from sppm_pipeline.services.arrays import F32, F64, I32, I64
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.jit.compiled import jit

# Sites whose kernels are gathered at a time: some 10^5 kernels, 50 MB with all temporary arrays.
_SITES = 600
# Samples that count as a small grid.
_SMALL = 2**20
# Bytes of lists that a catalog keeps: those of some blocks of cells.
_KEPT = 2**22
_LOCK = Lock()


class Catalog(NamedTuple):
    """All kernels of all pieces, where each piece begins, how far each piece reaches, and the cut-off that says so.

    `least` and `most` (3,) are how far any piece reaches; None if there are no kernels.
    """

    numbers: PieceNumbers
    kernels: Kernels
    first_pore: I64
    first_tunnel: I64
    lower: F64
    upper: F64
    cutoff: float
    least: F64 | None
    most: F64 | None
    kept: dict[Any, Any]  # the last lists of `sample_exact`: the next layers are near


PIECES_AT_A_TIME = 4096
"""Pieces whose reach is found together: there may be a hundred thousand with millions of kernels."""


def sample_exact(
    pieces: Pieces,
    tiling: TilingArrays,
    grid: Grid,
    cutoff: float = DEFAULT_CUTOFF,
    threads: int = 1,
    layer_start: int = 0,
    layer_stop: int | None = None,
    *,
    wanted: I32 | None = None,
    catalog: Catalog | None = None,
) -> F32:
    """The field of a tiling on any grid, kernel by kernel, indexed x, y, z; x is contiguous in memory.

    Kernels are gathered for a few cells at a time, so memory beyond the result does not grow with the grid.

    Parameters
    ----------
    pieces : Pieces
    tiling : TilingArrays
        Which piece stands where; a periodic tiling repeats for ever.
    grid : Grid
        Samples in cell units; the spacing need not divide the cell edge.
    cutoff : float
        See `add_kernels`.
    threads : int
        Number of threads; the result does not depend on it.
    layer_start, layer_stop : int
        Layers of the grid to sample, all by default; a layer's values do not depend on the choice.
    wanted : (layer_stop - layer_start, ny, 2) int32, optional
        Parts of the rows that matter, see `add_kernels`.
    catalog : Catalog, optional
        That of the pieces and the cut-off, if the caller kept it.

    Returns
    -------
    (nx, ny, layer_stop - layer_start) float32
        The field G.
    """
    nx, ny, nz = grid.shape
    layer_stop = nz if layer_stop is None else layer_stop
    if not 0 <= layer_start <= layer_stop <= nz:
        raise ValueError(f"layers {layer_start} to {layer_stop} are not all in a grid of {nz} layers")
    catalog = catalog or make_catalog(pieces, cutoff)
    out = np.zeros((layer_stop - layer_start, ny, nx), dtype=np.float32)
    # Some layers, and bands of rows, that depend on the grid alone: the sums are always the same. Half a cell of layers
    # keeps the list of kernels short; small grids take more at a time, as each list has its price.
    height = max(1, int(0.5 / grid.spacing[2]), min(int(2.0 / grid.spacing[2]), _SMALL // (nx * ny)))
    cells_a_row = 2.0 + nx * grid.spacing[0]
    rows = max(16, int(_SITES / (3.0 * cells_a_row) / grid.spacing[1]))
    for first in range(layer_start // height * height, layer_stop, height):
        start, stop = max(first, layer_start), min(first + height, layer_stop)
        for row in range(0, ny, rows):
            band = min(row + rows, ny) - row
            origin = (grid.origin[0], grid.origin[1] + row * grid.spacing[1], grid.origin[2])
            part = Grid(origin, grid.spacing, (nx, band, nz))
            asked = None
            if wanted is not None:
                rows_asked = wanted[start - layer_start : stop - layer_start, row : row + band]
                if (rows_asked[..., 0] >= rows_asked[..., 1]).all():
                    continue
                asked = np.ascontiguousarray(rows_asked)
            kernels = _prepared_for(catalog, tiling, part, first, min(first + height, nz))
            block = out[start - layer_start : stop - layer_start]
            target = block if band == ny else np.zeros((stop - start, band, nx), dtype=np.float32)
            add_prepared(target, part, kernels, threads, start, asked)
            if band < ny:
                block[:, row : row + band] = target
    return out.T


def _prepared_for(catalog: Catalog, tiling: TilingArrays, grid: Grid, start: int, stop: int) -> Prepared:
    """The kernels that reach the layers start <= k < stop."""
    kept: dict[object, tuple[TilingArrays, Prepared]] = catalog.kept
    key = id(tiling), grid.origin, grid.spacing, grid.shape[:2], start, stop
    found = kept.get(key)
    if found is not None and found[0] is tiling:
        return found[1]
    span = grid.layers(start, stop)
    lower = np.array(span.origin)
    upper = lower + np.array(span.spacing) * (np.array(span.shape) - 1)
    made = prepared(kernels_in_box(catalog, tiling, lower, upper), grid, catalog.cutoff, start, stop - start)
    with _LOCK:  # several threads sum at once
        kept[key] = tiling, made
        while sum(one.points.nbytes + one.tunnels.nbytes for _, one in kept.values()) > _KEPT:
            del kept[next(iter(kept))]
    return made


def make_catalog(pieces: Pieces, cutoff: float) -> Catalog:
    """All kernels of a tile set with the boxes of reach of its pieces; worth keeping between calls."""
    every = pieces.kernels
    lower, upper = np.full((len(pieces), 3), np.inf), np.full((len(pieces), 3), -np.inf)
    for begin in range(0, len(pieces), PIECES_AT_A_TIME):
        stop = min(begin + PIECES_AT_A_TIME, len(pieces))
        first_pore, first_tunnel = (first[begin : stop + 1] for first in (pieces.first_pore, pieces.first_tunnel))
        some = every.taken(slice(first_pore[0], first_pore[-1]), slice(first_tunnel[0], first_tunnel[-1]))
        pores, tunnels = kernel_reaches(some, cutoff)
        for one, other, reach, first in (
            (some.centers, some.centers, pores, first_pore),
            (some.starts, some.ends, tunnels, first_tunnel),
        ):
            filled = np.flatnonzero(np.diff(first))
            if not len(filled):
                continue
            low, high = np.minimum(one, other) - reach[:, None], np.maximum(one, other) + reach[:, None]
            at, own = first[filled] - first[0], begin + filled
            lower[own] = np.minimum(lower[own], np.minimum.reduceat(low, at, axis=0))
            upper[own] = np.maximum(upper[own], np.maximum.reduceat(high, at, axis=0))
    # empty pieces keep an empty box, from infinity to minus infinity
    reaching = np.isfinite(lower).all(axis=1)
    least, most = (lower[reaching].min(axis=0), upper[reaching].max(axis=0)) if reaching.any() else (None, None)
    return Catalog(pieces.numbers, every, pieces.first_pore, pieces.first_tunnel, lower, upper, cutoff, least, most, {})


def kernels_in_box(catalog: Catalog, tiling: TilingArrays, lower: F64, upper: F64) -> Kernels:
    """All kernels of a tiling that reach a box, up to the cut-off of the catalog; only cells near the box are visited.

    Corners are in cell sizes and may lie outside of the tiling; a periodic one repeats for ever. Kernels have a fixed
    order: by lattice site (z, y, x), interior, faces, connectors, place in the piece. The order of two kernels does not
    depend on the box.
    """
    if catalog.least is None or catalog.most is None:
        return empty_kernels()
    # Site s is near if the box of reach of a piece, moved by s, meets the box.
    first = np.ceil(lower - catalog.most).astype(np.int64)
    stop = np.floor(upper - catalog.least).astype(np.int64) + 1
    sites = sites_between(tiling, first, stop)
    numbers = site_pieces(catalog.numbers, sites).reshape(-1, PIECES_A_SITE)
    site, slot = np.nonzero(numbers >= 0)
    number = numbers[site, slot]
    z, y, x = np.unravel_index(site, sites.interior.shape)
    place = (sites.first + np.stack([x, y, z], axis=-1)).astype(np.float64)
    # of whole pieces first: most of those around a box are ruled out by a single comparison
    near = np.flatnonzero(
        boxes_meet(catalog.lower.take(number, axis=0) + place, catalog.upper.take(number, axis=0) + place, lower, upper)
    )
    number, place = number.take(near), place.take(near, axis=0)
    every, cutoff = catalog.kernels, catalog.cutoff
    pore, of_pore = _expanded(catalog.first_pore, number)
    tunnel, of_tunnel = _expanded(catalog.first_tunnel, number)
    pores, tunnels = half_boxes(every, pore, tunnel, cutoff)
    ends = every.centers, every.centers, every.starts, every.ends
    centers, _, pore = _moved(pore, of_pore, place, *ends[:2], pores, lower, upper)
    starts, stops, tunnel = _moved(tunnel, of_tunnel, place, *ends[2:], tunnels, lower, upper)
    metrics = (
        None if metric is None else metric.take(own, axis=0)
        for metric, own in ((every.pore_metric, pore), (every.tunnel_metric, tunnel))
    )
    return Kernels(centers, every.omega.take(pore), starts, stops, every.mu.take(tunnel), every.profile, *metrics)


def _expanded(begin: I64, number: I32) -> tuple[I64, I32]:
    """The kernels of the pieces `number`, one piece after the other, and which of these each belongs to."""
    total = int((begin.take(number + 1) - begin.take(number)).sum())
    index, owner = np.empty(total, np.int64), np.empty(total, np.int32)
    _expand(begin, number, index, owner)
    return index, owner


def _moved(
    index: I64, owner: I32, place: F64, starts: F64, ends: F64, half: F64, lower: F64, upper: F64
) -> tuple[F64, F64, I64]:
    """Both ends, moved to the place of their owners, of those kernels that reach a box, and which these are.

    `half` (n, 1 or 3) is how far each reaches.
    """
    found = np.empty((2, len(index), 3))
    kept = np.empty(len(index), np.int64)
    count = _move(index, owner, place, starts, ends, half, lower, upper, found[0], found[1], kept)
    return found[0, :count], found[1, :count], kept[:count]


@jit
def _expand(begin: I64, number: I32, index: I64, owner: I32) -> None:
    at = 0
    for i in range(len(number)):
        for k in range(begin[number[i]], begin[number[i] + 1]):
            index[at], owner[at] = k, i
            at += 1


@jit
def _move(
    index: I64,
    owner: I32,
    place: F64,
    starts: F64,
    ends: F64,
    half: F64,
    lower: F64,
    upper: F64,
    moved_starts: F64,
    moved_ends: F64,
    kept: I64,
) -> int:
    """Returns how many meet the box; they are written one after the other."""
    count = 0
    for i in range(len(index)):
        k, own, meets = index[i], owner[i], True
        for axis in range(3):
            start, end = starts[k, axis] + place[own, axis], ends[k, axis] + place[own, axis]
            # one reach for all axes, or one for each where kernels are stretched
            reach = half[i, min(axis, half.shape[1] - 1)]
            meets &= min(start, end) - reach <= upper[axis] and max(start, end) + reach >= lower[axis]
            # written in any case, and overwritten by the next one if it does not meet the box
            moved_starts[count, axis], moved_ends[count, axis] = start, end
        if meets:
            kept[count] = k
            count += 1
    return count
