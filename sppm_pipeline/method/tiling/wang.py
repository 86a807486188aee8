"""The paper's tile set and its two rules (paper, section "Overall Stochasticity").

A tile is named by three colors (cx, cy, cz): both of its faces across x show cx, both across y show cy, both across z
show cz. With c colors there are c^3 tiles, 27 for the paper's three; (cx, cy, cz) is tile ``(cx c + cy) c + cz``.

* Rule 1: two faces that touch show the same color.
* Rule 2: among the tiles that Rule 1 allows, the one with the highest score is placed. A neighbor that has been
  placed already and is *another tile* adds 3 across a face, 2 across an edge, 1 across a corner.

The paper writes that a neighbor counts if it has "surfaces with different codes"; its worked example (scores 10, 8 and
11) fixes the meaning: a neighbor counts when it is a different tile.

Why no order of choices can get stuck
-------------------------------------
Opposite faces of a tile are equal, so Rule 1 says no more than this: all cells of a *run*, an unbroken row of filled
cells along an axis (around the end, too, if the assembly is periodic), show one color along that axis. A cell lies on
three runs, one along each axis, and every combination of three colors exists as a tile. Therefore a cell whose runs
have colors takes these, a run met for the first time may take any color, and no choice restricts a run elsewhere:
cells may be filled in any mask. (A filler that looks at the six neighbors only must go in raster order: in another
order two parts of one run can be given different colors before the cell between them is reached.) Raster order is
used here, x fastest, so that a run is known from the low neighbor, and in a periodic assembly from the cell at its
low end.

The price is that a box of nx * ny * nz cells has only nx ny + ny nz + nz nx runs; see `statistics.entropy_per_cell`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from sppm_pipeline.method.tiling.lattice import TIE, Laid, check_count, checked_mask, faces_of_cells, hash_places
from sppm_pipeline.services.arrays import I32, I64, U64, Bools
from sppm_pipeline.services.jit.compiled import jit

_MAX_COLORS = 1290  # 1290^3 is the largest cube below 2^31


@jit
def _run_neighbor(mask: Bools, tiles: I32, place: int, index: int, count: int, stride: int, periodic: bool) -> int:
    """The tile of a cell already placed on the run through `place`, or -1."""
    if index > 0 and mask[place - stride]:
        return int(tiles[place - stride])
    if periodic and index > 0:
        first = place - index * stride
        if mask[first]:
            end = index
            while end < count and mask[first + end * stride]:
                end += 1
            if end == count:
                return int(tiles[first])
    return -1


@jit
def _add_sameness(tiles: I32, k: int, j: int, i: int, periodic: bool, sameness: I64) -> None:
    """Add to ``sameness[T]`` the weights of placed neighbors that are tile T."""
    nz, ny, nx = tiles.shape
    for dk in range(-1, 2):
        for dj in range(-1, 2):
            for di in range(-1, 2):
                steps = abs(dk) + abs(dj) + abs(di)
                kk, jj, ii = k + dk, j + dj, i + di
                if periodic:
                    kk, jj, ii = kk % nz, jj % ny, ii % nx
                elif kk < 0 or jj < 0 or ii < 0 or kk >= nz or jj >= ny or ii >= nx:
                    continue
                if steps > 0 and tiles[kk, jj, ii] >= 0:
                    # Rule 2: neighbors across faces, edges and corners weigh 3, 2 and 1
                    sameness[tiles[kk, jj, ii]] += 4 - steps


@jit
def _fill(mask: Bools, colors: int, draws: U64, scored: bool, periodic: bool, tiles: I32) -> None:
    """Place tiles in raster order. Arrays are (nz, ny, nx), `tiles` starts at -1."""
    nz, ny, nx = mask.shape
    flat_mask, flat_tiles, flat_draws = mask.reshape(-1), tiles.reshape(-1), draws.reshape(-1)
    sameness = np.zeros(colors**3, np.int64)
    square = colors * colors
    for k in range(nz):
        for j in range(ny):
            for i in range(nx):
                place = (k * ny + j) * nx + i
                if not flat_mask[place]:
                    continue
                along_x = _run_neighbor(flat_mask, flat_tiles, place, i, nx, 1, periodic)
                along_y = _run_neighbor(flat_mask, flat_tiles, place, j, ny, nx, periodic)
                along_z = _run_neighbor(flat_mask, flat_tiles, place, k, nz, nx * ny, periodic)
                x0, x1 = (0, colors) if along_x < 0 else (along_x // square, along_x // square + 1)
                y0, y1 = (0, colors) if along_y < 0 else (along_y // colors % colors, along_y // colors % colors + 1)
                z0, z1 = (0, colors) if along_z < 0 else (along_z % colors, along_z % colors + 1)
                # all three runs have colors: Rule 1 leaves one tile
                if x1 - x0 == 1 and y1 - y0 == 1 and z1 - z0 == 1:
                    flat_tiles[place] = (x0 * colors + y0) * colors + z0
                    continue
                if scored:
                    # The highest score (eq. 6) is the smallest weight of neighbors that are the same tile.
                    sameness[:] = 0
                    _add_sameness(tiles, k, j, i, periodic, sameness)
                least, ties = 1 << 30, 0
                for x in range(x0, x1):
                    for y in range(y0, y1):
                        for z in range(z0, z1):
                            weight = sameness[(x * colors + y) * colors + z]
                            if weight < least:
                                least, ties = weight, 1
                            elif weight == least:
                                ties += 1
                # ties are drawn by the hash of the place, so that no cell depends on how many were drawn before
                chosen = int(flat_draws[place] % np.uint64(ties))
                for x in range(x0, x1):
                    for y in range(y0, y1):
                        for z in range(z0, z1):
                            if sameness[(x * colors + y) * colors + z] == least:
                                if chosen == 0:
                                    flat_tiles[place] = (x * colors + y) * colors + z
                                chosen -= 1


def tile_colors(colors: int = 3) -> I32:
    """Face colors of all c^3 tiles of the set across x, y, z, (c^3, 3); DesignError if c isn't within 1..1290."""
    check_count("face colors", colors, _MAX_COLORS)
    tile = np.arange(colors**3, dtype=np.int32)
    return np.stack([tile // colors**2, tile // colors % colors, tile % colors], axis=1)


def tile_wang(mask: ArrayLike, seed: int, colors: int = 3, *, scored: bool = True, periodic: bool = False) -> Laid:
    """Fill the cells of a mask with the paper's tiles by Rule 1 and Rule 2, in raster order with x fastest.

    Cells may have any shape. Tiles of equal score (all of them, for the first cell, or without `scored`, which leaves
    out Rule 2) are drawn by a hash of the seed and the cell. Opposite ends of a periodic assembly are neighbors for
    both rules. Tiles are numbered 0..c^3-1, -1 where there is no cell; DesignError if c isn't within 1..1290.
    """
    check_count("face colors", colors, _MAX_COLORS)
    cells = checked_mask(mask)
    nx, ny, nz = cells.shape
    stored = np.ascontiguousarray(cells.transpose(2, 1, 0))
    k, j, i = np.ogrid[:nz, :ny, :nx]
    tiles = np.full(stored.shape, -1, np.int32)
    _fill(stored, colors, hash_places(seed, TIE, i, j, k), scored, periodic, tiles)
    interior = np.ascontiguousarray(tiles.transpose(2, 1, 0))
    shown = (interior // colors**2, interior // colors % colors, interior % colors)
    return interior, faces_of_cells(shown, cells, periodic)
