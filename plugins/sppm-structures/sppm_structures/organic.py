"""``field.organic``: pores thrown over a whole part, without cells."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import ConfigError, Context, Length, Palette, ScalarField, Size, SurfaceMesh, options
from sppm_pipeline.errors import ResourceError
from sppm_pipeline.nouns import CellDesign, PartFieldMaker, PlacedField
from sppm_pipeline.numerics import Grid, Kernels, Pieces, TilingArrays
from sppm_structures.sizes import field_size

CUTOFF = 1e-5
"""Value below which a single kernel is left out of the sum."""

MAX_PORES = 3_000_000
"""Pores of a part; they take some 300 bytes each."""


@dataclass(frozen=True, eq=False, kw_only=True)
class OrganicField(PlacedField):
    """Sum of pore and tunnel kernels less the level, in a box of cells that is not repeated.

    Pores (n, 3) are centers from the low corner in cell sizes, tunnels (m, 2) pairs of pores; `omega` in 1 / cell
    size^2 and `mu` in 1 / cell size are their size parameters.
    """

    pores: NDArray[np.float64]
    tunnels: NDArray[np.int64]
    omega: float
    mu: float
    level: float
    kept: dict[str, Any] = field(default_factory=dict, compare=False, repr=False)

    @property
    def finest_radius(self) -> float | None:
        return -math.log(self.level) / self.mu if 0 < self.level < 1 else None

    def sample_layers(self, grid: Grid, start: int, stop: int, threads: int = 1) -> NDArray[np.float32]:
        from sppm_pipeline.numerics import make_catalog, sample_exact

        if "pieces" not in self.kept:
            pieces, arrays = self._sorted_by_cell()
            self.kept["pieces"] = pieces, arrays, make_catalog(pieces, CUTOFF)
        pieces, arrays, catalog = self.kept["pieces"]
        values = sample_exact(pieces, arrays, grid, CUTOFF, threads, start, stop, catalog=catalog)
        values -= np.float32(self.level)
        return values

    def _sorted_by_cell(self) -> tuple[Pieces, TilingArrays]:
        """Kernels by the cell they lie in, or that is next to them, so that a slab finds its own at once."""
        shape = np.array(self.cells)
        starts, ends = self.pores[self.tunnels[:, 0]], self.pores[self.tunnels[:, 1]]
        # pores thrown beyond the box count for the cell at its side
        of_pore, of_tunnel = (np.clip(np.floor(p).astype(np.int64), 0, shape - 1) for p in (self.pores, starts))
        number = np.arange(math.prod(self.cells), dtype=np.int32).reshape(self.cells)
        pore_cell, tunnel_cell = number[tuple(of_pore.T)], number[tuple(of_tunnel.T)]
        pore_order, tunnel_order = np.argsort(pore_cell, kind="stable"), np.argsort(tunnel_cell, kind="stable")
        bounds = np.arange(number.size + 1)
        first_pore = np.searchsorted(pore_cell[pore_order], bounds)
        first_tunnel = np.searchsorted(tunnel_cell[tunnel_order], bounds)
        interiors = []
        for cell, corner in enumerate(np.argwhere(number >= 0).astype(np.float64)):
            p = pore_order[first_pore[cell] : first_pore[cell + 1]]
            t = tunnel_order[first_tunnel[cell] : first_tunnel[cell + 1]]
            interiors.append(
                Kernels(
                    self.pores[p] - corner,
                    np.full(len(p), self.omega),
                    starts[t] - corner,
                    ends[t] - corner,
                    np.full(len(t), self.mu),
                )
            )
        faces = []
        for axis in range(3):
            planes = list(self.cells)
            planes[axis] += 1
            faces.append(np.full(planes, -1, np.int32))
        return Pieces.of(interiors), TilingArrays(number, (faces[0], faces[1], faces[2]), False)

    def cut_at(self, value: float) -> OrganicField:
        return replace(self, level=self.level + value)

    def summary(self) -> dict[str, Any]:
        """Numbers of pores and tunnels and the level."""
        return {
            "cells": list(self.cells),
            "pores": len(self.pores),
            "tunnels": len(self.tunnels),
            "level": self.level,
        }


@dataclass(frozen=True, kw_only=True)
class Organic(PartFieldMaker):
    """Organic pores: thrown over the whole part, near ones joined by tunnels, nothing repeats.

    After Tian et al. 2020, "Organic open-cell porous structure modeling", whose design space is the whole part. Darts
    are thrown into the part's box until nothing fits; two pores are joined unless a third is nearer to both than they
    are to each other (relative neighborhood graph, Toussaint 1980), which holds the minimum spanning tree, so all
    pores are connected. Field and kernels are those of `field.gaussian`: ``sum exp(-omega r^2) + sum exp(-mu d)``,
    solid below the level, which ``tune.porosity`` changes.

    What differs from the publication: its pores are stretched along a tensor field, placed by an anisotropic particle
    system, and connected where the Morse-Smale complex of the field says so; those here are round, thrown, and joined
    by tunnels of the paper's kind.

    The cell is only the unit of lengths and resolutions here. Time and memory to draw grow with the part.
    """

    name: ClassVar[str] = "field.organic"
    is_random: ClassVar[bool] = True

    spacing: Length = options.spacing(Length(0.25))
    pore_radius: Length | None = options.pore_radius(None, note="0.45 spacings if omitted")
    tunnel_radius: Length | None = options.tunnel_radius(None, note="0.16 spacings if omitted")
    level: float = options.level(0.25)

    def estimate(self, palette: Palette, cover: Size | None) -> Size:
        spacing, (pore, tunnel) = self.in_cells(self.spacing), self._radii()
        # 0.84 pores and 1.7 tunnels in a spacing cubed, independent of each other (Boolean model); a sum of kernels is
        # wider than the union of its parts
        pores, tunnels, length = 0.84 / spacing**3, 1.7 / spacing**3, 0.85 * spacing
        volume = pores * 4 / 3 * math.pi * pore**3 + tunnels * math.pi * tunnel**2 * length
        area = pores * 4 * math.pi * pore**2 + tunnels * 2 * math.pi * tunnel * length
        solid = math.exp(-1.75 * volume)
        work = 43.0 * ((pore + tunnel) / (0.61 * spacing)) ** 3
        made = field_size(self.edge_mm, solid, area * solid, work, self.cells, cover, pores)
        design = CellDesign(
            edge=self.edge_mm or 1.0, edge_mm=self.edge_mm, interior_pores=pores, tunnels=tunnels, radii=(pore, tunnel)
        )
        return replace(made, design=design)

    def _radii(self) -> tuple[float, float]:
        spacing = self.in_cells(self.spacing)
        return (
            self.in_cells(self.pore_radius) if self.pore_radius is not None else 0.45 * spacing,
            self.in_cells(self.tunnel_radius) if self.tunnel_radius is not None else 0.16 * spacing,
        )

    def run(self, context: Context, cover: SurfaceMesh | None) -> ScalarField:
        """Throw and join the pores; the field is evaluated where it is sampled."""
        from sppm_pipeline.numerics import TUNNEL_PROFILES, omega_from_radius
        from sppm_pipeline.numerics import throw_darts as throw

        region, origin = self.region(cover)
        spacing, (pore, tunnel) = self.in_cells(self.spacing), self._radii()
        if max(pore, tunnel) > 4 * spacing or not 1e-3 < spacing <= max(region):
            raise ConfigError(
                f"pores of radius {pore:g} and tunnels of {tunnel:g} cell sizes don't fit a spacing of {spacing:g}",
                hint=f"radii are below 4 spacings, the spacing lies between 0.001 and {max(region)} cell sizes",
            )
        expected = math.prod(0.75 * (n + 2 * spacing) / spacing for n in region) / 0.75**2
        if expected > MAX_PORES:
            raise ResourceError(
                f"the part would take about {expected:.2g} pores; the limit is {MAX_PORES}",
                hint="give a larger spacing, or repeat a cell, or use `tile.free_faces`, whose cost does not grow",
            )
        # beyond the box, too, so that its sides are like any plane
        pores = throw(
            context.rng(),
            None,
            spacing,
            (-spacing,) * 3,
            tuple(n + spacing for n in region),
            share=1.0,
        )
        tunnels = near_pairs(pores, 2 * spacing)
        return OrganicField(
            edge=self.edge_mm,
            region=region,
            origin=origin,
            pores=pores,
            tunnels=tunnels,
            omega=omega_from_radius(pore, self.level),
            mu=TUNNEL_PROFILES["linear"].mu(tunnel, self.level),
            level=self.level,
        )


def near_pairs(points: NDArray[np.float64], reach: float) -> NDArray[np.int64]:
    """Relative neighborhood graph: pairs (m, 2) with no third point nearer to both than they are to each other.

    Pairs further apart than `reach` are not looked at. Where no ball of half that radius is empty there are none.
    """
    from scipy.spatial import cKDTree

    tree = cKDTree(points)
    pairs = tree.query_pairs(reach, output_type="ndarray").astype(np.int64)
    # a tree returns pairs in no order that is promised
    pairs = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
    lengths = np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1)
    kept = np.ones(len(pairs), bool)
    undecided = np.arange(len(pairs))
    for number in range(2, len(points) + 1):  # the nearest but itself, the next; most pairs fall at the first
        ends, place = np.unique(pairs[undecided, 0], return_inverse=True)
        distance, third = (found[:, 0] for found in tree.query(points[ends], [number]))
        distance, third = distance[place.reshape(-1)], third[place.reshape(-1)]
        # a pore that is nearer to both ends is nearer to the first
        in_reach = distance < lengths[undecided]
        undecided, third = undecided[in_reach], third[in_reach]
        between = np.linalg.norm(points[third] - points[pairs[undecided, 1]], axis=1) < lengths[undecided]
        between &= third != pairs[undecided, 1]
        kept[undecided[between]] = False
        undecided = undecided[~between]
        if not len(undecided):
            break
    joined: NDArray[np.int64] = pairs[kept]
    return joined
