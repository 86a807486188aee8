"""Dart throwing by quota on a lattice of blocks: no faces, and any region can be thrown alone.

Every block gets a given number of pores, uniform in the block but for the spacing, which holds across blocks, too.
Blocks have colors such that no two neighbors share one. They are thrown color after color, each by a random stream of
its own, made from the seed and the place of the block, so that neither threads nor the order of the blocks of a color
enter the result. A block then depends only on neighbors of earlier colors: with the order below on at most 4, 2 and 1
blocks along x, y and z, whatever the size of the lattice.

Rules are those of `darts.throw`: plain darts up to 75 % of the capacity, then darts into active voxels.

Density and spacing may vary from place to place (`graded_blocks`). A dart is then kept with a probability proportional
to the density at its place, and two pores at p and q keep the mean of the spacings there, ``(l(p) + l(q)) / 2``. Where
pores are stretched, their distance is measured in the mean of the metrics at p and q, and the spacing is that of as
many pores in the metric: the same as if round pores had been thrown and then been stretched. Active voxels know one
spacing alone: graded blocks are thrown by plain darts only, and again from the start if these find no room.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.sampling.active_voxels import fill_active_voxels
from sppm_pipeline.method.sampling.capacity import box_capacity, check_capacity, largest_spacing
from sppm_pipeline.method.sampling.cell_list import CellList, add_point, empty_cell_list, next_uniform
from sppm_pipeline.method.sampling.darts import NAIVE_BUDGET, NAIVE_SHARE
from sppm_pipeline.method.sampling.graded_blocks import NODES, density_means, is_free, metric_at, value_at
from sppm_pipeline.method.tiling.lattice import INTERIOR, hash_places
from sppm_pipeline.services.arrays import F64, I8, I64, U64, Bools
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.metric import determinants, semi_axes
from sppm_pipeline.services.threads import ordered_map

# Parities of x, y, z in the order of their colors: a Gray code, so that a chain of dependent blocks, whose parities
# differ by one step along the axes where they change, changes x at most 4, y 2 and z 1 times.
_GRAY = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 1, 1), (1, 1, 1), (1, 0, 1), (0, 0, 1))
ATTEMPTS = 20
DARTS = 400
"""Darts for each pore before a graded block is thrown again. At 60 % of the packing limit some 30 are needed, so that
only blocks that are really full take so many; twice as many only delay the error."""
_BLOCK_PORE = 0


def block_colors(shape: tuple[int, int, int], periodic: bool = False) -> I8:
    """Colors of the blocks of a lattice, (nx, ny, nz), from 0 on in the order in which they are thrown.

    Along an axis that repeats after an odd number of blocks the last one is neither even nor odd, which takes more than
    eight colors.
    """
    rank = np.zeros((3, 3, 3), np.int8)
    later = [parities for parities in itertools.product(range(3), repeat=3) if 2 in parities]
    for color, parities in enumerate([*_GRAY, *later]):
        rank[parities] = color
    parity = [np.arange(n) % 2 for n in shape]
    for axis, n in enumerate(shape):
        if periodic and n % 2 and n > 1:
            parity[axis][-1] = 2
    return rank[np.ix_(*parity)]


def block_quotas(mask: Bools, mean: float, density: F64 | None = None) -> I64:
    """Numbers of pores of the blocks, (nx, ny, nz): whole, `mean` on average, the rest carried on in the order z, y, x.

    With a `density` (NODES nx + 1, NODES ny + 1, NODES nz + 1), `mean` is that of a block where the density is 1, and a
    block gets its integral. Without one the carry belongs to the place in the lattice alone, so that the quota of a
    block does not depend on the mask.
    """
    if density is None:
        ends = mean * np.arange(mask.size + 1, dtype=np.float64)
    else:
        wanted = np.where(mask, mean * density_means(density), 0.0)
        ends = np.concatenate([[0.0], np.cumsum(wanted.transpose(2, 1, 0).ravel())])
    quotas = np.diff(np.floor(ends + 0.5)).astype(np.int64).reshape(mask.shape[::-1]).transpose(2, 1, 0)
    return np.where(mask, quotas, 0)


def check_block_spacing(mean: float, spacing: float) -> None:
    """Raise DesignError if the spacing is longer than a block, or `mean` pores are above the capacity of one."""
    if not 0.0 < spacing <= 1.0:
        raise DesignError(
            f"the pore spacing is {spacing:.6g} cell sizes; scattered pores need more than 0 and at most 1",
            hint="give a larger cell: pores of a block look at the neighboring blocks only",
        )
    check_capacity(math.ceil(mean), spacing, (1.0, 1.0, 1.0), periodic=True, what="block")


def spacing_at_share(mean: float, share: float) -> float:
    """The spacing at which `mean` pores a block are this share of the capacity."""
    return largest_spacing(max(round(mean / share), 1), (1.0, 1.0, 1.0), periodic=True)


def throw_blocks(
    seed: int,
    quotas: I64,
    spacing: float,
    *,
    periodic: bool = False,
    density: F64 | None = None,
    metric: F64 | None = None,
    before: tuple[F64, I64] | None = None,
    threads: int = 1,
) -> tuple[F64, I64]:
    """Throw `quotas` (nx, ny, nz) pores into the blocks of a lattice; the result does not depend on the threads.

    Two pores keep `spacing` block edges, at most 1; with a `density` > 0 at the nodes of `graded_blocks`, which is one
    number for a lattice that repeats, ``spacing density^(-1/3)``. A `metric` (..., 6) at the nodes (`services.metric`)
    needs a density. Pores `before` have the form of the result: centers (n, 3), relative to the low corner of the block
    in block edges, blocks in C order of (x, y, z); and where those of each block begin, (blocks + 1,). `seed` is taken
    modulo 2^64.

    Raises DesignError if the spacing is longer than a block somewhere, or a block holds fewer pores than its quota.
    """
    quotas = np.ascontiguousarray(quotas, np.int64)
    shape, graded = quotas.shape, density is not None
    widest = closest = spacing
    # darts follow the first of these and spacings the second, both powers -1/3 of densities
    of_darts = of_spacings = of_metrics = None
    if density is not None:
        of_darts = of_spacings = np.ascontiguousarray(density, np.float64) ** (-1 / 3)
        widest, closest = spacing * float(of_darts.max()), spacing * float(of_darts.min())
        if metric is not None:
            of_metrics = np.ascontiguousarray(metric, np.float64)
            # as many pores in the metric as there are in space: its volume element is the root of the determinant
            of_spacings = (density / np.sqrt(determinants(metric))) ** (-1 / 3)
            widest = spacing * float((of_spacings.ravel() * semi_axes(metric.reshape(-1, 6))[:, 0]).max())
        if not 0 < widest <= 1:
            raise DesignError(
                f"the pore spacing reaches {widest:.4g} cell sizes where pores are fewest; at most 1 is possible",
                hint="give a larger cell: pores of a block look at the neighboring blocks only",
            )
    else:
        check_block_spacing(float(quotas.max(initial=0)), spacing)
    first = np.concatenate([[0], np.cumsum(quotas.ravel())])
    centers = np.empty((int(first[-1]), 3))
    old_centers, old_first = before if before is not None else (np.zeros((0, 3)), np.zeros(quotas.size + 1, np.int64))
    old_centers = old_centers.view()
    old_centers.flags.writeable = False  # as of pores that are shared: one kind of argument is compiled once
    streams = hash_places(seed, INTERIOR, *np.ogrid[tuple(slice(n) for n in shape)]).ravel()
    colors = block_colors(shape, periodic).ravel()
    # an axis along which the only block is its own neighbor repeats inside the cell list
    wraps = np.array([periodic and n == 1 for n in shape])
    most = int((quotas.ravel() + np.diff(old_first)).max(initial=0))
    # memory for one block and what lies around it within the widest spacing, however large the lattice; no packing of
    # balls is denser than pi / sqrt(18)
    rows = int(min(27 * most, math.sqrt(2.0) * (1 + 3 * widest) ** 3 / closest**3 + 27)) + most
    naive = math.inf if graded else NAIVE_SHARE * box_capacity(1.0, spacing, True)
    missing = np.zeros(quotas.size, np.int64)

    def throw(blocks: I64) -> None:
        cells = empty_cell_list(rows, widest, np.zeros(3), np.ones(3), wraps.tolist())
        lattice = (blocks, np.array(shape), periodic, wraps, streams, first, centers, old_centers, old_first)
        _throw_in_turn(cells, *lattice, of_darts, of_spacings, of_metrics, spacing, naive, missing)

    # blocks of one color are not neighbors, so that any thread may throw any of them
    for color in range(int(colors.max()) + 1):
        blocks = np.flatnonzero((colors == color) & (quotas.ravel() > 0))
        if len(blocks):
            parts = np.array_split(blocks, min(len(blocks), 4 * threads)) if threads > 1 else [blocks]
            for _ in ordered_map(throw, parts, threads):
                pass
    if missing.any():
        worst = int(missing.argmax())
        wanted = int(quotas.ravel()[worst])
        place = tuple(int(i) for i in np.unravel_index(worst, shape))
        # the number that fits falls with the cube of the spacing
        near = spacing * (1 - missing[worst] / wanted) ** (1 / 3)
        raise DesignError(
            f"only {wanted - missing[worst]} of {wanted} pores fit into the block {place} with "
            + (
                "the spacing there; "
                if graded
                else f"a spacing of {spacing:.6g} "
                f"({wanted / box_capacity(1.0, spacing, True):.0%} of the capacity, {ATTEMPTS} throws); "
            )
            + f"{np.count_nonzero(missing)} of {np.count_nonzero(quotas)} blocks are too full",
            hint="ask for a smaller `share` or `spacing` in the recipe"
            if graded
            else f"ask for fewer pores, or for a spacing of about {0.95 * near:.4g} (cell sizes)",
        )
    return centers, first


@jit
def _throw_in_turn(
    cells: CellList,
    blocks: I64,
    shape: I64,
    periodic: bool,
    wraps: Bools,
    streams: U64,
    first: I64,
    centers: F64,
    old_centers: F64,
    old_first: I64,
    nodes: F64 | None,
    packing: F64 | None,
    metric_nodes: F64 | None,
    spacing: float,
    naive: float,
    missing: I64,
) -> None:
    """Throw the pores of blocks that are not neighbors; what can't be placed is noted in `missing`.

    Both `nodes` and `packing` are powers -1/3 of densities: darts follow the one, spacings the other. What is None is
    not compiled. Blocks that are not thrown yet are empty to their neighbors: `streams` of a thrown block is 0.
    """
    own = cells.reach
    spacings = np.full(cells.points.shape[0], own)
    metrics = None if metric_nodes is None else np.empty((cells.points.shape[0], 6))
    own_metric, place = np.zeros(6), np.zeros(3)
    low, side = np.zeros(3), np.ones(3)
    for block in blocks:
        stream = streams[block : block + 1].copy()
        wanted = first[block + 1] - first[block]
        most = np.int64(min(wanted, naive))
        budget = (NAIVE_BUDGET if nodes is None else DARTS) * most + 1000
        x0, y0, z0 = block // (shape[1] * shape[2]), block // shape[2] % shape[1], block % shape[2]
        least = np.inf
        if nodes is not None:
            for i in range(NODES + 1):
                for j in range(NODES + 1):
                    for k in range(NODES + 1):
                        least = min(least, nodes[x0 * NODES + i, y0 * NODES + j, z0 * NODES + k])
        for _ in range(ATTEMPTS):
            list_neighbors(cells, block, shape, periodic, wraps, streams, first, centers, old_centers, old_first)
            start = cells.used[0]
            if packing is not None:
                for row in range(start):
                    p = cells.points[row]
                    spacings[row] = spacing * value_at(packing, x0 + p[0], y0 + p[1], z0 + p[2])
                    if metric_nodes is not None:
                        metric_at(metric_nodes, x0 + p[0], y0 + p[1], z0 + p[2], metrics[row])  # type: ignore[index]
            placed, darts = 0, 0
            while placed < most and darts < budget:
                x, y, z = next_uniform(stream), next_uniform(stream), next_uniform(stream)
                if nodes is not None:
                    here = value_at(nodes, x0 + x, y0 + y, z0 + z)
                    # rejection: `here` cubed is one over the density, `least` cubed one over its maximum
                    if next_uniform(stream) * here * here * here > least * least * least:
                        continue
                    if metric_nodes is not None:
                        here = value_at(packing, x0 + x, y0 + y, z0 + z)  # type: ignore[arg-type]
                        metric_at(metric_nodes, x0 + x, y0 + y, z0 + z, own_metric)
                    own = spacing * here
                darts += 1
                place[0], place[1], place[2] = x, y, z
                if is_free(cells, spacings, metrics, place, own, own_metric):
                    row = cells.used[0]
                    spacings[row] = own
                    if metrics is not None:
                        metrics[row] = own_metric
                    add_point(cells, x, y, z, _BLOCK_PORE, 0)
                    placed += 1
            if placed < wanted and nodes is None:
                placed += fill_active_voxels(cells, stream, low, side, wanted - placed, _BLOCK_PORE, 0)
            if placed == wanted:
                break
        missing[block] = wanted - placed
        for row in range(placed):
            for axis in range(3):
                centers[first[block] + row, axis] = cells.points[start + row, axis]
        streams[block] = 0


@jit
def list_neighbors(
    cells: CellList,
    block: int | np.int64,
    shape: I64,
    periodic: bool,
    wraps: Bools,
    streams: U64,
    first: I64,
    centers: F64,
    old_centers: F64,
    old_first: I64,
) -> None:
    """Empty the cell list and add all pores that lie within the spacing around a block."""
    cells.used[0] = 0
    nz, ny, nx = cells.first.shape
    for k in range(nz):
        for j in range(ny):
            for i in range(nx):
                cells.first[k, j, i] = -1
    place = (block // (shape[1] * shape[2]), block // shape[2] % shape[1], block % shape[2])
    for step in range(27):
        shift = (step // 9 - 1, step // 3 % 3 - 1, step % 3 - 1)
        other = 0
        there = True
        for axis in range(3):
            at = place[axis] + shift[axis]
            if periodic:
                at = (at + shape[axis]) % shape[axis]
            there = there and 0 <= at < shape[axis] and not (wraps[axis] and shift[axis] != 0)
            other = other * shape[axis] + at
        if not there:
            continue
        for row in range(old_first[other], old_first[other + 1]):
            _add_near(cells, old_centers, row, shift)
        if streams[other] == 0 and other != block:
            for row in range(first[other], first[other + 1]):
                _add_near(cells, centers, row, shift)


@jit
def _add_near(cells: CellList, centers: F64, row: int, shift: tuple[int, int, int]) -> None:
    """Add the point of a neighboring block if it lies within the spacing around this one."""
    x, y, z = centers[row, 0] + shift[0], centers[row, 1] + shift[1], centers[row, 2] + shift[2]
    low, high = -cells.reach, 1.0 + cells.reach
    if low <= x <= high and low <= y <= high and low <= z <= high:
        add_point(cells, x, y, z, _BLOCK_PORE, 0)
