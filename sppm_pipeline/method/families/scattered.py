"""Samplers and connectors on blocks without faces: how one method that knows a cell serves a whole lattice."""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.method.families.cloud import Cloud
from sppm_pipeline.method.nouns.pores import PoreSet
from sppm_pipeline.method.nouns.tunnels import TunnelGraph
from sppm_pipeline.nouns.palette import Blocks
from sppm_pipeline.services.arrays import F64, I32, I64
from sppm_pipeline.stage import Context

if TYPE_CHECKING:
    from sppm_pipeline.method.families.connector import Connector
    from sppm_pipeline.method.families.sampler import Sampler


RIM = 2.0
"""Mean distances of pores from the rim of the blocks within which darts are not evened out, so that they hold the
others back: beyond, the potential is below 1e-3. The rim lies in the blocks around a part, outside of it."""


@dataclass(frozen=True, eq=False)
class FilledBlocks(Blocks, ABC):
    """Blocks over cells of another shape, which say themselves where darts fall: implement `with_darts`."""

    content: ClassVar[str]  # what they cover, for messages

    @abstractmethod
    def with_darts(self, context: Context, base: PoreSet, mean: float, spacing: float) -> PoreSet:
        """Throw darts, `mean` pores and `spacing` in a cell of the recipe; see the function `with_darts`."""


def with_darts(
    context: Context, base: PoreSet, blocks: Blocks, mean: float, spacing: float, *, obstacles: bool = True
) -> PoreSet:
    """Throw darts into all blocks, `mean` pores each, by the compiled way; fractions are carried from block to block.

    With a density, pores are so many times as many; with pores that are kept, the missing ones are added to these. The
    spacing is in cell sizes, and is kept from the pores thrown before (`base`), too, if they are `obstacles`.
    """
    from sppm_pipeline.method.sampling.blocks import check_block_spacing, throw_blocks

    if isinstance(blocks, FilledBlocks):
        return blocks.with_darts(context, base, mean, spacing)
    if blocks.density is None:
        check_block_spacing(mean, spacing)
    base, more = _kept_and_more(base, blocks, mean)
    quotas = np.zeros(blocks.shape, np.int64)
    quotas[blocks.mask] = more
    before = (base.centers, _first_of_blocks(base.piece, blocks)) if obstacles and len(base.centers) else None
    # one number for the whole lattice: blocks derive theirs from it and their place
    seed = int(context.rng().integers(0, 2**64, dtype=np.uint64))
    centers, first = throw_blocks(
        seed, quotas, spacing, periodic=blocks.periodic, density=blocks.density, metric=blocks.metric, before=before,
        threads=context.threads,
    )  # fmt: skip
    # spacings go with the power -1/3 of the density: the smallest is where it is largest
    least = spacing if blocks.density is None else spacing * float(blocks.density.max()) ** (-1 / 3)
    return _extended(base, blocks, centers, np.diff(first)[blocks.mask.ravel()], least)


def with_evened(
    context: Context, base: PoreSet, blocks: Blocks, mean: float, spacing: float, stealth: float
) -> tuple[PoreSet, float]:
    """Throw darts into all blocks, `mean` pores each, and even them out; pores thrown before stay where they are.

    At the rim of the blocks, where neighbors are missing, darts stay, too; others may have moved to a neighboring
    block. Also returns the structure factor of the silenced waves, see `sampling.evened`.
    """
    from sppm_pipeline.method.sampling.evened import even_out, near_the_rim

    thrown = with_darts(context, base, blocks, mean, spacing)
    piece = thrown.piece
    # in each block those thrown before come first
    before = np.bincount(base.piece, minlength=base.interiors)
    moves = np.arange(len(piece)) - np.searchsorted(piece, piece) >= before[piece]
    density = mean + float(before.mean())
    points = thrown.centers + blocks.sites[piece]
    if not blocks.periodic:
        moves &= ~near_the_rim(points, blocks.mask, RIM * density ** (-1 / 3))
    points, factor = even_out(
        points, moves, blocks.mask, blocks.periodic, density, stealth, spacing, threads=context.threads
    )
    # a coordinate may lie on the far end by rounding
    block = np.minimum(points.astype(np.int64), np.array(blocks.shape) - 1)
    piece = blocks.numbers[tuple(block.T)].astype(np.int32)
    order = np.argsort(piece, kind="stable")
    return replace(thrown, centers=(points - block)[order], piece=piece[order]), factor


def block_by_block(context: Context, sampler: Sampler, base: PoreSet, blocks: Blocks) -> PoreSet:
    """Call the sampler's `throw` for every block, with the pores of all neighbors thrown before as obstacles.

    Raises DesignError if the lattice repeats and is one block wide along some axes, but not along all.
    """
    from sppm_pipeline.method.families.interiors import InteriorBox
    from sppm_pipeline.method.sampling.blocks import block_colors
    from sppm_pipeline.method.sampling.graded_blocks import density_means

    alone = blocks.periodic and blocks.shape == (1, 1, 1)
    if blocks.periodic and min(blocks.shape) == 1 and not alone:
        raise DesignError(
            f"{sampler.name} throws block by block, and a box of {list(blocks.shape)} blocks that repeats has blocks "
            "that are their own neighbors",
            hint="give at least 2 cells along each axis",
        )
    if isinstance(blocks, FilledBlocks):
        raise ConfigError(
            f"{sampler.name} throws into cubes, and can't fill {blocks.content}", hint="use `sample.dart_throwing`"
        )
    if blocks.metric is not None:
        raise ConfigError(
            f"{sampler.name} measures plain distances, and can't throw pores that are stretched",
            hint="use `sample.dart_throwing`, or leave out the map `stretch`",
        )
    quotas = factors = None
    if blocks.density is not None:
        total = getattr(sampler, "total", None) or sampler.expected_count(0.0)
        base, quotas = _kept_and_more(base, blocks, float(total))
        factors = density_means(blocks.density)[blocks.mask] ** (-1 / 3)
    spacing = sampler.requested_spacing(base.cell) or base.spacing
    sites, numbers = blocks.sites, blocks.numbers
    thrown = [base.of_piece(t) for t in range(base.interiors)]
    new: list[F64] = [np.zeros((0, 3))] * base.interiors
    shifts = [np.array(step) for step in itertools.product((-1, 0, 1), repeat=3)]
    # the order of colors is that of the compiled way, so that a block waits for few others
    colors = block_colors(blocks.shape, blocks.periodic)[tuple(sites.T)]
    for done, t in enumerate(np.argsort(colors, kind="stable")):
        around = [thrown[t]] if alone else []
        for shift in () if alone else shifts:
            place = sites[t] + shift
            if blocks.periodic:
                place %= blocks.shape
            if (place >= 0).all() and (place < blocks.shape).all() and numbers[tuple(place)] >= 0:
                around.append(thrown[numbers[tuple(place)]] + shift)
        own = np.column_stack([thrown[t], np.ones(len(thrown[t]))])
        box = InteriorBox(np.zeros(3), np.ones(3), alone, np.concatenate(around), base.cell, spacing, 0, folded=own)
        stage = sampler
        if quotas is not None and factors is not None:
            if not quotas[t]:
                continue
            stage = sampler.with_pores(int(quotas[t]))
            # as the compiled way does: spacings follow the density of the block
            box = box._replace(spacing=None if spacing is None else spacing * float(factors[t]))
        new[t] = stage.thrown(context, int(t), box)
        thrown[t] = np.concatenate([thrown[t], new[t]])
        context.progress(done + 1, base.interiors, "blocks")
    counts = np.array([len(points) for points in new])
    return _extended(base, blocks, np.concatenate(new), counts, sampler.kept_spacing(base.cell, base))


def _kept_and_more(base: PoreSet, blocks: Blocks, mean: float) -> tuple[PoreSet, I64]:
    """Pores thrown before, those that are kept among them, and how many more each interior gets."""
    from sppm_pipeline.method.sampling.blocks import block_quotas

    if blocks.density is not None and len(base.centers):
        raise ConfigError(
            "graded cells are scattered by one sampler",
            hint="give `sample.mirrored_faces` a `total` instead of `count`",
        )
    if blocks.kept is not None:
        assert blocks.added is not None
        return base.extended(*blocks.kept.handed_over()), blocks.added
    return base, block_quotas(blocks.mask, mean, blocks.density)[blocks.mask]


def _extended(base: PoreSet, blocks: Blocks, centers: F64, counts: I64, spacing: float | None) -> PoreSet:
    """The pores of before and the new ones, `counts` in each interior, sorted by block."""
    piece = np.repeat(np.arange(base.interiors, dtype=np.int32), counts)
    if len(base.centers):
        centers, piece = np.concatenate([base.centers, centers]), np.concatenate([base.piece, piece])
        order = np.argsort(piece, kind="stable")
        centers, piece = centers[order], piece[order]
    # those that were kept are among the pores, and need not be kept twice
    blocks = replace(blocks, kept=None, added=None)
    return replace(base, centers=centers, piece=piece, spacing=spacing, colors=(0, 0, 0), blocks=blocks)


def _first_of_blocks(piece: I32, blocks: Blocks) -> I64:
    """Index of the first pore of each block of the lattice, (blocks + 1,)."""
    counts = np.zeros(blocks.mask.size, np.int64)
    counts[blocks.mask.ravel()] = np.bincount(piece, minlength=int(blocks.mask.sum()))
    return np.concatenate([[0], np.cumsum(counts)])


def joined(context: Context, connector: Connector, pores: PoreSet) -> TunnelGraph:
    """Join the pores of all blocks into one graph.

    Raises ConfigError if the sampler does not support blocks, or the connector no stretched pores.
    """
    blocks = pores.blocks
    if blocks is None:
        raise ConfigError(
            "a sampler of this recipe throws cells without regard to their neighbors, which can't be scattered",
            hint="use `sample.dart_throwing`, or lay cells by `tile.fresh`",
        )
    # an axis at a time: there may be millions of pores
    corners, points = blocks.sites.astype(np.int32).T, np.array(pores.centers)
    for axis in range(3):
        points[:, axis] += corners[axis][pores.piece]
    metric = None
    if blocks.metric is not None:
        from sppm_pipeline.method.sampling.graded_blocks import at_nodes

        if not connector.follows_metric:
            raise ConfigError(
                f"{connector.name} measures plain distances, and can't join pores that are stretched",
                hint="use `connect.mbdst`, or leave out the map `stretch`",
            )
        metric = at_nodes(blocks.metric, points)
    periodic = (blocks.periodic,) * 3
    cloud = Cloud(points, _first_of_blocks(pores.piece, blocks), blocks.shape, periodic, pores.cell, metric)
    edges, shift = connector.join_cloud(context, cloud)
    # what the graph no longer needs goes before arrays of the same size are made
    del cloud, points
    first, second = (pores.piece[edges[:, end]] for end in range(2))
    # in a cloud shifts are between places of the lattice; in a tiling between cells
    shift = np.require(shift, np.int32, "W")
    for axis in range(3):
        shift[:, axis] += corners[axis][second]
        shift[:, axis] -= corners[axis][first]
    del first, second
    return TunnelGraph(pores, edges, shift)
