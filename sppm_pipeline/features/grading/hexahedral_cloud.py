"""Pores scattered in a mesh of hexahedra: so many in each cell, in sizes that follow the cells or stay.

Dart throwing in hexahedra of any shape, by quota, with spacings that follow their size or stay.

Two pores at p and q keep the mean of the spacings there, as in `blocks`, measured straight. Hexahedra are thrown one
after the other, all into one list, so that spacings hold across their faces whatever the mesh looks like.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.grading.curved_cells import HexahedralCells
from sppm_pipeline.features.grading.curved_porosity import CurvedSamples, curved_targets
from sppm_pipeline.features.grading.laid_graph import WarpedTiling, cloud, laid_graph
from sppm_pipeline.features.grading.numerics.hexahedral_mesh import largest_determinants
from sppm_pipeline.features.grading.numerics.hexahedral_places import point_and_volume
from sppm_pipeline.features.grading.rounds import (
    corrected,
    curve_of,
    in_rounds,
    of_scattered_boxes,
    recipe_total,
    scattered,
)
from sppm_pipeline.method.families.scattered import FilledBlocks
from sppm_pipeline.method.families.tiler import HALO, without_faces
from sppm_pipeline.method.fields.microstructure import Microstructure
from sppm_pipeline.method.nouns.maps import Grading
from sppm_pipeline.method.nouns.pores import PoreSet
from sppm_pipeline.method.sampling.blocks import ATTEMPTS, DARTS
from sppm_pipeline.method.sampling.cell_list import CellList, add_point, bucket_of, empty_cell_list, next_uniform
from sppm_pipeline.method.sampling.graded_blocks import is_free
from sppm_pipeline.services.arrays import F64, I32, I64, U64
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.stage import Context, Recipe

_ABOVE = 1.3  # the determinant is looked at in 27 places, and may be so much larger in between


class GrowingCloud:
    """Up to `capacity` pores thrown so far in a `box` (2, 3) mm, with the spacing that each keeps.

    `widest` is the largest spacing that any pore keeps, mm; those of pores that keep more are not looked for far
    enough. Where spacings follow the determinant, as in `throw` unless `by_volume`, it is that at its largest.
    """

    def __init__(self, capacity: int, widest: float, box: F64) -> None:
        self._cells = empty_cell_list(capacity, widest, box[0], box[1], (False, False, False))
        self._spacings = np.empty(capacity)

    @property
    def points(self) -> F64:
        """All pores, (n, 3) mm, in the order in which they came."""
        return self._cells.points[: self._cells.used[0]].copy()

    def add(self, points: F64, spacings: F64) -> None:
        """Add pores without looking at others."""
        first = int(self._cells.used[0])
        self._spacings[first : first + len(points)] = spacings
        for x, y, z in points.tolist():
            add_point(self._cells, x, y, z, 0, 0)

    def throw(self, seed: int, corners: F64, quotas: I64, spacings: F64, by_volume: bool) -> I64:
        """Throw `quotas` (m,) pores into hexahedra with `corners` (m, 2, 2, 2, 3) mm; returns for how many there was
        no room, (m,).

        Spacings (m,) are in mm; or, unless `by_volume`, in cube roots of the determinant. With `by_volume` pores are
        as dense everywhere in a hexahedron; otherwise as in a cube that was bent to it, so that they are finer where
        it is narrower.
        """
        missing = np.zeros(len(quotas), np.int64)
        nodes = np.ascontiguousarray(corners.reshape(-1, 8, 3), np.float64)
        state = np.array([seed % 2**64], np.uint64)
        _throw(self._cells, self._spacings, state, nodes, quotas, spacings, by_volume, missing)
        return missing

    def take(self, candidates: F64, spacings: F64, group: I64, quotas: I64) -> None:
        """Add those of the candidates (k, 3) that keep their spacings, in order, up to the quota of their group."""
        _take(self._cells, self._spacings, candidates, spacings, group, quotas.copy())


@jit
def _remove_last(cells: CellList) -> None:
    row = cells.used[0] - 1
    i, j, k = bucket_of(cells, cells.points[row, 0], cells.points[row, 1], cells.points[row, 2])
    cells.first[k, j, i] = cells.following[row]
    cells.used[0] = row


@jit
def _throw(
    cells: CellList, kept: F64, stream: U64, nodes: F64, quotas: I64, spacings: F64, by_volume: bool, missing: I64
) -> None:
    p, d = np.empty(3), np.empty((3, 3))
    metric = np.empty(0)
    for e in range(len(quotas)):
        most = 0.0
        if by_volume:
            for i in range(27):
                most = max(
                    most, _ABOVE * point_and_volume(nodes[e], 0.5 * (i // 9), 0.5 * (i // 3 % 3), 0.5 * (i % 3), p, d)
                )
        wanted, placed = quotas[e], 0
        for attempt in range(ATTEMPTS):
            placed, darts = 0, 0
            while placed < wanted and darts < DARTS * wanted + 1000:
                x, y, z = next_uniform(stream), next_uniform(stream), next_uniform(stream)
                det = point_and_volume(nodes[e], x, y, z, p, d)
                # places are uniform in the unit cube: rejection by the determinant makes them uniform in space
                if by_volume and next_uniform(stream) * most > det:
                    continue
                darts += 1
                own = spacings[e] if by_volume else spacings[e] * max(det, 0.0) ** (1.0 / 3.0)
                if is_free(cells, kept, None, p, own, metric):
                    kept[cells.used[0]] = own
                    add_point(cells, p[0], p[1], p[2], 0, 0)
                    placed += 1
            if placed == wanted or attempt == ATTEMPTS - 1:
                break
            # a cell that jammed is emptied and thrown again, as adding to it would only find the last gaps
            for _ in range(placed):
                _remove_last(cells)
        missing[e] = wanted - placed


@jit
def _take(cells: CellList, kept: F64, candidates: F64, spacings: F64, group: I64, left: I64) -> None:
    metric = np.empty(0)
    for n in range(len(candidates)):
        p = candidates[n]
        if left[group[n]] > 0 and is_free(cells, kept, None, p, spacings[n], metric):
            kept[cells.used[0]] = spacings[n]
            add_point(cells, p[0], p[1], p[2], 0, 0)
            left[group[n]] -= 1


RIM = 0.75
"""Distance outside of the mesh, in cells, within which pores are drawn, too: their kernels reach into it."""

CLOSER = 0.85
"""Factor of the spacing of pores that are added to others, which have filled the space at the full spacing. A
heuristic: near 1 few darts find room, and far below pores merge."""

_PROBES = 6  # points along a block by which its share around the mesh is measured
_TRIES = 60  # darts for each pore around the mesh


class Surroundings:
    """The size of cells anywhere in and around a mesh: `fixed` mm everywhere, or that of the mesh if it is None."""

    def __init__(self, curved: HexahedralCells, fixed: float | None) -> None:
        self.curved, self.fixed = curved, fixed

    @cached_property
    def edges(self) -> F64:
        """Edge of a cube as large as each cell, (m,) mm."""
        return np.cbrt(self.curved.volumes) if self.fixed is None else np.full(self.curved.count, self.fixed)

    @cached_property
    def largest_edges(self) -> F64:
        """Upper bounds of `size_at` in each cell, (m,) mm."""
        return self.edges if self.fixed is not None else np.cbrt(largest_determinants(self.curved.corners))

    @cached_property
    def _rim(self) -> tuple[Any, I32]:
        from scipy.spatial import cKDTree

        points, cells = self.curved.rim()
        return cKDTree(points), cells

    def nearest(self, points: F64) -> tuple[F64, I32]:
        """Distances of points from the surface of the mesh, mm, and the cells there."""
        tree, cells = self._rim
        distance, which = tree.query(points)
        return distance, cells[which]

    def size_at(self, points: F64) -> F64:
        """The edge of a cell at points (n, 3), mm: the cube root of the determinant; outside, of the nearest cell."""
        if self.fixed is not None:
            return np.full(len(points), self.fixed)
        cell, within = self.curved.places(points)
        inside = cell >= 0
        size = np.empty(len(points))
        size[inside] = np.cbrt(np.linalg.det(self.curved.derivatives(cell[inside], within[inside])))
        if not inside.all():
            # beyond the mesh the mapping of a cell may fold: its mean size is taken there
            size[~inside] = self.edges[self.nearest(points[~inside])[1]]
        return size


@dataclass(frozen=True, eq=False)
class HexahedralBlocks(FilledBlocks):
    """Blocks over a mesh of hexahedra, into whose cells pores are thrown by quota.

    `kept` are centers and blocks of pores as in `Blocks`; `added` are pores by cell of the mesh.
    """

    content: ClassVar[str] = "a mesh of hexahedra"

    curved: HexahedralCells = field(kw_only=True)
    edge: float = field(kw_only=True)  # of a block, mm
    origin: tuple[float, float, float] = field(kw_only=True)  # low corner of the first block, mm
    # pores of each cell of the mesh, which need not be whole; None for what the recipe's samplers state
    quotas: F64 | None = None
    # edge of the cell, mm, in which lengths of the recipe hold everywhere; None if they follow the mesh
    fixed: float | None = None

    def in_mm(self, centers: F64, piece: I32) -> F64:
        """Places of pores by their centers and blocks, (n, 3) mm."""
        return np.asarray((centers + self.sites[piece]) * self.edge + np.array(self.origin))

    def with_darts(self, context: Context, base: PoreSet, mean: float, spacing: float) -> PoreSet:
        """Pores of each cell of the mesh, and around it; `DesignError` if the pores of a cell do not fit."""
        if len(base.centers):
            raise ConfigError(
                "cells of a mesh are filled by one sampler",
                hint="give `sample.mirrored_faces` a `total` instead of `count`",
            )
        curved, around = self.curved, Surroundings(self.curved, self.fixed)
        by_volume = self.fixed is not None
        usual = mean * curved.volumes / self.fixed**3 if self.fixed is not None else np.full(curved.count, mean)
        wanted = usual if self.quotas is None else self.quotas
        # a cell with more pores than usual has them closer
        closer = spacing * np.cbrt(usual / np.maximum(wanted, 1e-9))
        # one stream for all cells, in their order, so that the result does not depend on threads
        rng, origin = context.rng(), np.array(self.origin)
        seed = int(rng.integers(0, 2**64, dtype=np.uint64))
        # rounded cumulated quotas: the total is right though each is a whole number
        quotas = np.diff(np.floor(np.concatenate([[0.0], np.cumsum(wanted)]) + 0.5)).astype(np.int64)
        box = np.array([origin, origin + self.edge * np.array(self.shape)])
        in_mm = closer * around.edges
        longest = float((closer * around.largest_edges).max())
        if self.kept is not None and self.added is not None:
            old = self.in_mm(*self.kept.handed_over())
            made = GrowingCloud(len(old) + int(self.added.sum()), longest, box)
            cell = curved.places(old).cell
            cell = np.where(cell >= 0, cell, around.nearest(old)[1])
            made.add(old, closer[cell] * around.size_at(old))
            scale = in_mm if by_volume else closer
            made.throw(seed, curved.corners, self.added, CLOSER * scale, by_volume)
        else:
            outside = _around_the_mesh(rng, around, self, wanted, in_mm)
            made = GrowingCloud(int(quotas.sum() + outside.quotas.sum()), longest, box)
            missing = made.throw(seed, curved.corners, quotas, in_mm if by_volume else closer, by_volume)
            if missing.any():
                worst = int(missing.argmax())
                name = dict(zip(curved.columns, curved.names[worst].tolist(), strict=True))
                raise DesignError(
                    f"only {quotas[worst] - missing[worst]} of {quotas[worst]} pores fit into cell {name} with the "
                    f"spacing there; {np.count_nonzero(missing)} of {curved.count} cells are too full",
                    hint="ask for a smaller `share` or `spacing` in the recipe",
                )
            made.take(outside.points, outside.spacings, outside.group, outside.quotas)
        place = (made.points - origin) / self.edge
        site = np.clip(np.floor(place).astype(np.int64), 0, np.array(self.shape) - 1)
        flat = np.ravel_multi_index(tuple(site.T), self.shape)
        order = np.argsort(flat, kind="stable")
        return replace(
            base, centers=np.clip(place - site, 0.0, 1.0)[order], piece=flat[order].astype(np.int32),
            spacing=float(in_mm.min()) / self.edge, colors=(0, 0, 0), blocks=self,
        )  # fmt: skip


@dataclass(frozen=True)
class _Outside:
    """Darts around a mesh in the order in which they are thrown, and how many of each block are wanted."""

    points: F64
    spacings: F64
    group: I64
    quotas: I64


def _around_the_mesh(
    rng: np.random.Generator, around: Surroundings, blocks: HexahedralBlocks, wanted: F64, spacings: F64
) -> _Outside:
    """Darts where kernels reach in from, as dense as pores are in the nearest cell."""
    curved, origin = blocks.curved, np.array(blocks.origin)
    sites = np.stack(np.unravel_index(np.arange(blocks.mask.size), blocks.shape), axis=1)
    # blocks of which nothing is near enough are not looked at
    distance, cell = around.nearest((sites + 0.5) * blocks.edge + origin)
    sites = sites[distance < RIM * around.edges[cell] + 0.9 * blocks.edge]
    density = wanted / curved.volumes

    def dense(points: F64) -> tuple[F64, I32]:
        far, own = around.nearest(points)
        there = (far < RIM * around.edges[own]) & (curved.places(points).cell < 0)
        return np.where(there, density[own], 0.0), own

    t = (np.arange(_PROBES) + 0.5) / _PROBES
    inner = np.stack(np.meshgrid(t, t, t, indexing="ij"), -1).reshape(-1, 3)
    found = dense((sites[:, None] + inner).reshape(-1, 3) * blocks.edge + origin)[0].reshape(len(sites), -1)
    expected = found.mean(axis=1) * blocks.edge**3
    quotas = np.diff(np.floor(np.concatenate([[0.0], np.cumsum(expected)]) + 0.5)).astype(np.int64)
    group = np.repeat(np.arange(len(sites)), np.where(quotas > 0, _TRIES * quotas + _TRIES, 0))
    # thinned darts: as many candidates as the densest place of a block asks for, kept by the local density
    points = (sites[group] + rng.random((len(group), 3))) * blocks.edge + origin
    here, own = dense(points)
    kept = rng.random(len(group)) * found.max(axis=1)[group] < here
    return _Outside(points[kept], spacings[own[kept]], group[kept], quotas)


@dataclass(frozen=True)
class HexahedralCloud:
    """Pores scattered in a mesh of hexahedra, with rounds of corrections.

    Lengths of the recipe hold in a cell of the edge `fixed`, mm, or follow the mesh if that is None. The target is the
    map `porosity` of the grading, or `porosity`; without either the recipe's number of pores is taken.
    """

    recipe: Recipe
    curved: HexahedralCells
    fixed: float | None
    grading: Grading | None
    porosity: float | None
    trials: int
    resolution: int

    @cached_property
    def _around(self) -> Surroundings:
        return Surroundings(self.curved, self.fixed)

    def laid(self, context: Context, rounds: int) -> WarpedTiling:
        """Scatter, measure, and add and take away pores."""
        blocks, targets = self._blocks(), self._targets()

        def drawn(blocks: HexahedralBlocks) -> tuple[PoreSet, WarpedTiling]:
            micro = scattered(context, self.recipe, None, 0, blocks)
            return micro.graph.pores, self._scaled(micro, blocks)

        if targets is None:
            return drawn(blocks)[1]
        trials = of_scattered_boxes(context, self.recipe, max(24, self.resolution))
        curve = curve_of(context, trials, recipe_total(self.recipe), targets, self.trials)
        usual = curve.pores(targets)
        # how many cells of the recipe each cell of the mesh holds
        room = np.ones(self.curved.count) if self.fixed is None else self.curved.volumes / self.fixed**3
        blocks = replace(blocks, quotas=usual * room)

        def errors(number: int, made: tuple[PoreSet, WarpedTiling]) -> F64:
            return CurvedSamples(made[1], self.curved, self.resolution, context.threads).shares().porosity - targets

        def again(number: int, made: tuple[PoreSet, WarpedTiling], errors: F64) -> HexahedralBlocks | None:
            if number == rounds:
                return None
            pores = made[0]
            cell = self.curved.places(blocks.in_mm(pores.centers, pores.piece)).cell
            return corrected(context, number, blocks, pores, cell, errors * room / curve.slope(usual))

        made, report = in_rounds(blocks, drawn, errors, again)
        context.report(**report, cell_deviation=curve.deviation)
        return made[1]

    def _targets(self) -> F64 | None:
        if self.grading is not None and "porosity" in self.grading:
            return curved_targets(self.grading, "porosity", self.curved)
        return None if self.porosity is None else np.full(self.curved.count, self.porosity)

    def _blocks(self) -> HexahedralBlocks:
        """Blocks of about the size of a cell over the mesh and what is around it."""
        edge = float(self._around.edges.mean())
        margin = RIM * float(self._around.edges.max())
        low, high = self.curved.box + np.array([[-margin], [margin]])
        count = np.maximum(np.ceil((high - low) / edge - 1e-9), 1).astype(int)
        x, y, z = ((low + high - count * edge) / 2).tolist()
        mask = np.ones(tuple(count), bool)
        return HexahedralBlocks(mask, False, curved=self.curved, edge=edge, origin=(x, y, z), fixed=self.fixed)

    def _scaled(self, micro: Microstructure, blocks: HexahedralBlocks) -> WarpedTiling:
        """The graph with kernels of the sizes of the cells around them, laid in blocks."""
        if not micro.additive:
            raise ConfigError(
                "walls and sheets can't fill a mesh of hexahedra", hint="end the recipe with `field.gaussian`"
            )
        plain = without_faces(micro, blocks, 0, blocks.edge, blocks.origin)
        graph = laid_graph(plain, (False, False, False))
        points = graph.points * blocks.edge + np.array(blocks.origin)
        # a tunnel has one size, that of the cell in its middle
        middles = points[graph.edges].mean(axis=1)
        at_pores, at_tunnels = self._around.size_at(points), self._around.size_at(middles)
        largest = max(float(at_pores.max(initial=0.0)), float(at_tunnels.max(initial=0.0)))
        # blocks are at least as large as kernels reach, so that one ring of blocks around the box is enough
        edge = max(blocks.edge, micro.reach * largest / HALO)
        profile = micro.pieces.kernels.profile
        scaled = graph._replace(points=points).resized(profile, at_pores / edge, at_tunnels / edge)
        made = cloud(scaled, edge, self.curved.box, profile, micro.level, curved=self.curved)
        assert isinstance(made, WarpedTiling)
        return made
