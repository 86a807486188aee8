"""Pores scattered in a mesh of hexahedra: so many in each cell, in sizes that follow the cells or stay."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.grading.curved_cells import HexahedralCells
from sppm_pipeline.features.grading.curved_porosity import CurvedSamples, curved_targets
from sppm_pipeline.features.grading.graded import curve_of, recipe_total, trial
from sppm_pipeline.features.grading.graded_cloud import ROOM, without_faces
from sppm_pipeline.features.grading.grading import Grading
from sppm_pipeline.features.grading.local_porosity import error_summary
from sppm_pipeline.features.grading.numerics.curve import PorosityCurve
from sppm_pipeline.features.grading.warped import LaidGraph, WarpedTiling, cloud, laid_graph
from sppm_pipeline.method.families.interiors import FEWEST
from sppm_pipeline.method.families.tiler import HALO
from sppm_pipeline.method.fields.microstructure import Microstructure
from sppm_pipeline.method.fields.tiling import Tiling
from sppm_pipeline.method.nouns.pores import PoreSet
from sppm_pipeline.nouns.palette import Blocks, HexahedralBlocks, KeptPores, Palette
from sppm_pipeline.stage import Context, Recipe

RIM = 0.75
"""How far outside of the mesh pores are thrown, too, in cells: kernels reach in from there."""

CLOSER = 0.85
"""Factor of the spacing of pores that are added to others: where these have taken the room, more would not fit."""

_PROBES = 6  # places along a block at which it is asked what part of it lies around the mesh
_TRIES = 60  # darts for each pore around the mesh


class Surroundings:
    """The size of cells anywhere in and around a mesh.

    Parameters
    ----------
    curved : HexahedralCells
    fixed : float or None
        Edge of the cell, mm, everywhere; None if it is that of the mesh.
    """

    def __init__(self, curved: HexahedralCells, fixed: float | None) -> None:
        self.curved, self.fixed = curved, fixed

    @cached_property
    def edges(self) -> NDArray[np.float64]:
        """Edge of a cube as large as each cell, (m,) mm."""
        return np.cbrt(self.curved.volumes) if self.fixed is None else np.full(self.curved.count, self.fixed)

    @cached_property
    def largest_edges(self) -> NDArray[np.float64]:
        """What `size_at` is nowhere above in each cell, (m,) mm."""
        from sppm_pipeline.features.grading.numerics.hexahedral_determinant import largest_determinants

        return self.edges if self.fixed is not None else np.cbrt(largest_determinants(self.curved.corners))

    @cached_property
    def _rim(self) -> tuple[Any, NDArray[np.int32]]:
        from scipy.spatial import cKDTree

        points, cells = self.curved.rim()
        return cKDTree(points), cells

    def nearest(self, points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
        """Distances of points from the surface of the mesh, mm, and the cells there."""
        tree, cells = self._rim
        distance, which = tree.query(points)
        return distance, cells[which]

    def size_at(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """The edge of a cell at points (n, 3), mm: the cube root of the determinant; outside, of the nearest cell."""
        if self.fixed is not None:
            return np.full(len(points), self.fixed)
        cell, within = self.curved.places(points)
        inside = cell >= 0
        size = np.empty(len(points))
        size[inside] = np.cbrt(np.linalg.det(self.curved.derivatives(cell[inside], within[inside])))
        if not inside.all():
            size[~inside] = self.edges[self.nearest(points[~inside])[1]]
        return size


def with_darts_in_cells(
    context: Context, base: PoreSet, blocks: HexahedralBlocks, mean: float, spacing: float
) -> PoreSet:
    """`scattered.with_darts` where blocks cover a mesh of hexahedra.

    Raises
    ------
    DesignError
        If the pores of a cell do not fit.
    """
    from sppm_pipeline.features.grading.numerics.curved_darts import GrowingCloud

    if len(base.centers):
        raise ConfigError(
            "cells of a mesh are filled by one sampler",
            hint="give `sample.mirrored_faces` a `total` instead of `count`",
        )
    curved, around = blocks.curved, Surroundings(blocks.curved, blocks.fixed)
    by_volume = blocks.fixed is not None
    usual = mean * curved.volumes / blocks.fixed**3 if blocks.fixed is not None else np.full(curved.count, mean)
    wanted = usual if blocks.quotas is None else blocks.quotas
    # a cell with more pores than usual has them closer
    closer = spacing * np.cbrt(usual / np.maximum(wanted, 1e-9))
    rng, origin = context.rng(), np.array(blocks.origin)
    seed = int(rng.integers(0, 2**64, dtype=np.uint64))
    quotas = np.diff(np.floor(np.concatenate([[0.0], np.cumsum(wanted)]) + 0.5)).astype(np.int64)
    box = np.array([origin, origin + blocks.edge * np.array(blocks.shape)])
    in_mm = closer * around.edges
    longest = float((closer * around.largest_edges).max())
    if blocks.kept is not None and blocks.added is not None:
        centers, piece = blocks.kept.handed_over()
        old = (centers + blocks.sites[piece]) * blocks.edge + origin
        made = GrowingCloud(len(old) + int(blocks.added.sum()), longest, box)
        cell = curved.places(old).cell
        cell = np.where(cell >= 0, cell, around.nearest(old)[1])
        made.add(old, closer[cell] * around.size_at(old))
        scale = in_mm if by_volume else closer
        made.throw(seed, curved.corners, blocks.added, CLOSER * scale, by_volume)
    else:
        outside = _around_the_mesh(rng, around, blocks, wanted, in_mm)
        made = GrowingCloud(int(quotas.sum() + outside.quotas.sum()), longest, box)
        missing = made.throw(seed, curved.corners, quotas, in_mm if by_volume else closer, by_volume)
        if missing.any():
            worst = int(missing.argmax())
            name = dict(zip(curved.columns, curved.names[worst].tolist(), strict=True))
            raise DesignError(
                f"only {quotas[worst] - missing[worst]} of {quotas[worst]} pores fit into cell {name} with the spacing "
                f"there; {np.count_nonzero(missing)} of {curved.count} cells are too full",
                hint="ask for a smaller `share` or `spacing` in the recipe",
            )
        made.take(outside.points, outside.spacings, outside.group, outside.quotas)
    place = (made.points - origin) / blocks.edge
    site = np.clip(np.floor(place).astype(np.int64), 0, np.array(blocks.shape) - 1)
    flat = np.ravel_multi_index(tuple(site.T), blocks.shape)
    order = np.argsort(flat, kind="stable")
    return replace(
        base, centers=np.clip(place - site, 0.0, 1.0)[order], piece=flat[order].astype(np.int32),
        spacing=float(in_mm.min()) / blocks.edge, colors=(0, 0, 0), blocks=blocks,
    )  # fmt: skip


@dataclass(frozen=True)
class _Outside:
    """Darts around a mesh in the order in which they are thrown, and how many of each block are wanted."""

    points: NDArray[np.float64]
    spacings: NDArray[np.float64]
    group: NDArray[np.int64]
    quotas: NDArray[np.int64]


def _around_the_mesh(
    rng: np.random.Generator,
    around: Surroundings,
    blocks: HexahedralBlocks,
    wanted: NDArray[np.float64],
    spacings: NDArray[np.float64],
) -> _Outside:
    """Darts where kernels reach in from, as dense as pores are in the nearest cell."""
    curved, origin = blocks.curved, np.array(blocks.origin)
    sites = np.stack(np.unravel_index(np.arange(blocks.mask.size), blocks.shape), axis=1)
    # blocks of which nothing is near enough are not looked at
    distance, cell = around.nearest((sites + 0.5) * blocks.edge + origin)
    sites = sites[distance < RIM * around.edges[cell] + 0.9 * blocks.edge]
    density = wanted / curved.volumes

    def dense(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
        far, own = around.nearest(points)
        there = (far < RIM * around.edges[own]) & (curved.places(points).cell < 0)
        return np.where(there, density[own], 0.0), own

    t = (np.arange(_PROBES) + 0.5) / _PROBES
    inner = np.stack(np.meshgrid(t, t, t, indexing="ij"), -1).reshape(-1, 3)
    found = dense((sites[:, None] + inner).reshape(-1, 3) * blocks.edge + origin)[0].reshape(len(sites), -1)
    expected = found.mean(axis=1) * blocks.edge**3
    quotas = np.diff(np.floor(np.concatenate([[0.0], np.cumsum(expected)]) + 0.5)).astype(np.int64)
    group = np.repeat(np.arange(len(sites)), np.where(quotas > 0, _TRIES * quotas + _TRIES, 0))
    points = (sites[group] + rng.random((len(group), 3))) * blocks.edge + origin
    here, own = dense(points)
    kept = rng.random(len(group)) * found.max(axis=1)[group] < here
    return _Outside(points[kept], spacings[own[kept]], group[kept], quotas)


@dataclass(frozen=True)
class HexahedralCloud:
    """What is needed to scatter pores in a mesh of hexahedra.

    Attributes
    ----------
    recipe : Recipe
    curved : HexahedralCells
    fixed : float or None
        Edge of the cell, mm, in which lengths of the recipe hold; None if they follow the mesh.
    grading : Grading or None
        May hold the map `porosity`.
    porosity : float or None
        The target where there is no map of it; without either the recipe's number of pores is taken.
    trials : int
    resolution : int
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

    @cached_property
    def _of_cells(self) -> NDArray[np.float64]:
        """How many cells of the recipe each cell of the mesh holds, (m,)."""
        return np.ones(self.curved.count) if self.fixed is None else self.curved.volumes / self.fixed**3

    def laid(self, context: Context, rounds: int) -> WarpedTiling:
        """Scatter, measure, and add and take away pores."""
        targets, curve, quotas = self._targets(), None, None
        if targets is not None:
            curve = self._curve(context, targets)
            quotas = curve.pores(targets) * self._of_cells
        blocks = self._blocks(quotas)
        micro = self._drawn(context, blocks)
        made = self._scaled(micro, blocks)
        if curve is None or targets is None:
            return made
        rms = []
        for number in range(rounds + 1):
            errors = CurvedSamples(made, self.curved, self.resolution, context.threads).shares().porosity - targets
            summary = error_summary(errors)
            rms.append(summary["error_rms"])
            if number == rounds:
                break
            change = -np.rint(errors / curve.slope(curve.pores(targets)) * self._of_cells).astype(np.int64)
            micro = self._changed(context, number, micro, blocks, change)
            made = self._scaled(micro, blocks)
        context.report(**summary, error_rms_of_rounds=rms, cell_deviation=curve.deviation)
        return made

    def _targets(self) -> NDArray[np.float64] | None:
        if self.grading is not None and "porosity" in self.grading:
            return curved_targets(self.grading, "porosity", self.curved)
        return None if self.porosity is None else np.full(self.curved.count, self.porosity)

    def _curve(self, context: Context, targets: NDArray[np.float64]) -> PorosityCurve:
        """The curve of boxes of scattered blocks that repeat."""
        blocks = Blocks(np.ones((ROOM,) * 3, bool), True)

        def porosity(n: int, attempt: int) -> float:
            micro = trial(context, self.recipe, n, attempt, Palette(ROOM**3, (0, 0, 0), blocks=blocks))
            tiling = without_faces(micro, blocks, 0, None, (0.0, 0.0, 0.0))
            return float((tiling.solid(max(24, self.resolution), context.threads) == 0).mean())

        return curve_of(context, porosity, recipe_total(self.recipe), targets, self.trials)

    def _blocks(self, quotas: NDArray[np.float64] | None) -> HexahedralBlocks:
        """Blocks of about the size of a cell over the mesh and what is around it."""
        edge = float(self._around.edges.mean())
        margin = RIM * float(self._around.edges.max())
        low, high = self.curved.box + np.array([[-margin], [margin]])
        count = np.maximum(np.ceil((high - low) / edge - 1e-9), 1).astype(int)
        x, y, z = ((low + high - count * edge) / 2).tolist()
        return HexahedralBlocks(
            np.ones(tuple(count), bool), False, curved=self.curved, edge=edge, origin=(x, y, z), quotas=quotas,
            fixed=self.fixed,
        )  # fmt: skip

    def _drawn(self, context: Context, blocks: HexahedralBlocks) -> Microstructure:
        palette = Palette(int(blocks.mask.sum()), (0, 0, 0), blocks=blocks)
        micro = trial(context, self.recipe, None, 0, palette)
        if not micro.additive:
            raise ConfigError("walls can't fill a mesh of hexahedra", hint="end the recipe with `field.gaussian`")
        return micro

    def _scaled(self, micro: Microstructure, blocks: HexahedralBlocks) -> WarpedTiling:
        """The graph with kernels of the sizes of the cells around them, laid in blocks."""
        from sppm_pipeline.method.kernels.profiles import PORE_PROFILE, TUNNEL_PROFILES

        tiling: Tiling = without_faces(micro, blocks, 0, blocks.edge, blocks.origin)
        graph = laid_graph(tiling, (False, False, False))
        points = graph.points * blocks.edge + np.array(blocks.origin)
        middles = points[graph.edges].mean(axis=1)
        at_pores, at_tunnels = self._around.size_at(points), self._around.size_at(middles)
        largest = max(float(at_pores.max(initial=0.0)), float(at_tunnels.max(initial=0.0)))
        edge = max(blocks.edge, micro.reach * largest / HALO)
        profile = micro.pieces.kernels.profile
        scaled = LaidGraph(
            points,
            graph.omega * PORE_PROFILE.scaled_radius(at_pores / edge),
            graph.edges,
            graph.mu * TUNNEL_PROFILES[profile].scaled_radius(at_tunnels / edge),
        )
        made = cloud(scaled, edge, self.curved.box, profile, micro.level, curved=self.curved)
        assert isinstance(made, WarpedTiling)
        return made

    def _changed(
        self, context: Context, number: int, micro: Microstructure, blocks: HexahedralBlocks, change: NDArray[np.int64]
    ) -> Microstructure:
        """Take away pores where there are too many, at random, and add some where there are too few."""
        pores = micro.graph.pores
        points = (pores.centers + blocks.sites[pores.piece]) * blocks.edge + np.array(blocks.origin)
        cell = self.curved.places(points).cell
        order = np.argsort(cell, kind="stable")
        first = np.searchsorted(cell[order], np.arange(self.curved.count + 1))
        keep = np.ones(len(cell), bool)
        for own in np.flatnonzero(change < 0).tolist():
            begin, end = int(first[own]), int(first[own + 1])
            fewer = min(-int(change[own]), max(0, end - begin - FEWEST))
            keep[order[begin + context.rng(number, own).permutation(end - begin)[:fewer]]] = False
        kept = KeptPores(pores.centers[keep], pores.piece[keep])
        return self._drawn(context, replace(blocks, kept=kept, added=np.maximum(change, 0)))
