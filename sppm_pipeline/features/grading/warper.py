"""Base class of stages that bend cells to another shape."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.grading.curved_cells import BentBox, CurvedCells, Mapped
from sppm_pipeline.features.grading.laid_graph import LaidGraph, cloud, laid_graph
from sppm_pipeline.features.grading.warped_field import WarpedField, cells_sampled, warped_field
from sppm_pipeline.method.families import options
from sppm_pipeline.method.families.tiler import HALO
from sppm_pipeline.method.fields.scalar_field import ScalarField
from sppm_pipeline.method.fields.tiling import Tiling
from sppm_pipeline.nouns.palette import Palette
from sppm_pipeline.nouns.size import Size
from sppm_pipeline.services.arrays import F64, Bools
from sppm_pipeline.stage import Context, Stage

SAMPLES, FINE_SAMPLES = 64, 128
"""Samples along an edge of a cell that others are interpolated from; a single cell takes 9 MB and about 0.05 s with the
larger number. Of octets with sharp joints 8 in 100 000 points change sides then, with the smaller one 35."""


@dataclass(frozen=True, kw_only=True)
class Warper(Stage):
    """Common base of the family ``warp``: implement `curved`, and `wraps` if the ends of the box may meet.

    Stochastic cells are bent by mapping their graph: pores move, tunnels stay straight between them. Any other field is
    bent itself: its value at a point is that at the place in the box from which the point came.
    """

    version: ClassVar[int] = 2

    sizes: str = options.sizes("cell")
    resolution: int | None = options.resolution(
        None,
        note="from which fields other than stochastic cells are interpolated; if omitted, 128 in a single cell that "
        "repeats, and 64 in each of several",
        minimum=16,
        maximum=256,
    )

    @abstractmethod
    def curved(self, field: ScalarField) -> CurvedCells:
        """The bent cells of a field."""

    def mapped(self, field: ScalarField, places: F64) -> Mapped:
        """Points at places (n, 3) of the box, in cell sizes from its low corner; also beyond the box."""
        curved = self.curved(field)
        assert isinstance(curved, BentBox)
        return curved.mapped(places)

    def wraps(self, field: ScalarField) -> tuple[bool, bool, bool]:
        """Axes along which the end of the box meets its beginning."""
        return (False, False, False)

    def estimate(self, palette: Palette, field: Size) -> Size:
        return field

    def run(self, context: Context, field: ScalarField) -> ScalarField:
        """Map the graph and lay it in blocks, or bend the field."""
        if field.edge_mm is None:
            raise ConfigError("the size of a cell is missing", hint="give the `tile` stage `cell: 5 mm`")
        wraps = self.wraps(field)
        if any(wraps) and not field.periodic:
            raise ConfigError(
                "a full turn brings the last cell to the first one, and they do not fit",
                hint="lay the cells with `periodic: true`, or turn less",
            )
        if isinstance(field, Tiling) and field.additive and not field.tileset.micro.stretched:
            return self._with_graph(context, field, wraps)
        return self._with_field(context, field, self.curved(field))

    def _with_field(self, context: Context, field: ScalarField, curved: CurvedCells) -> WarpedField:
        if self.sizes == "fixed":
            raise ConfigError(
                f"a {type(field).__name__} is bent as it is, and has no sizes that could stay", hint="leave out `sizes`"
            )
        resolution = self.resolution or (FINE_SAMPLES if cells_sampled(field) == 1 else SAMPLES)
        made = warped_field(field, curved, resolution)
        of_cell = curved.volumes / field.physical_edge() ** 3
        context.report(volume_min=float(of_cell.min()), volume_max=float(of_cell.max()))
        return made

    def _with_graph(self, context: Context, field: Tiling, wraps: tuple[bool, bool, bool]) -> Tiling:
        micro, edge = field.tileset.micro, field.physical_edge()
        graph = laid_graph(field, wraps)
        there = self.mapped(field, graph.points)
        middles = self.mapped(field, _middles(graph, field.cells, wraps))
        stretch = np.cbrt(np.maximum(there.volume, 1e-9)), np.cbrt(np.maximum(middles.volume, 1e-9))
        if self.sizes == "fixed":
            stretch = np.ones_like(stretch[0]), np.ones_like(stretch[1])
        # beyond the axis of a tube the mapping turns inside out: what lies there is left out
        good = there.volume > 0
        # blocks that kernels do not reach beyond
        block = edge * max(1.0, micro.reach * float(np.max(stretch[0][good], initial=1.0)) / HALO)
        profile = micro.pieces.kernels.profile
        moved = graph._replace(points=np.where(good[:, None], there.points, np.inf))
        sized = _without_lost(moved.resized(profile, stretch[0] * edge / block, stretch[1] * edge / block))
        curved = self.curved(field)
        made = cloud(sized, block, curved.box, profile, micro.level, exact=field.exact, curved=curved)
        if made.tileset.micro.reach > HALO + 1e-9:
            raise DesignError(
                "the kernels reach farther than the next block", hint="give smaller radii or larger cells"
            )
        context.report(volume_min=float(there.volume[good].min()), volume_max=float(there.volume[good].max()))
        return made


def _middles(graph: LaidGraph, cells: tuple[int, int, int], wraps: tuple[bool, bool, bool]) -> F64:
    """Middles of the tunnels in the box; those that go around by the shorter way."""
    start, end = (graph.points[graph.edges[:, k]] for k in range(2))
    way = end - start
    for axis in range(3):
        if wraps[axis]:
            way[:, axis] -= cells[axis] * np.round(way[:, axis] / cells[axis])
    middle: F64 = start + way / 2
    return middle


def _without_lost(graph: LaidGraph) -> LaidGraph:
    """The graph without pores that have no place, and their tunnels."""
    kept: Bools = np.isfinite(graph.points[:, 0])
    number = np.cumsum(kept) - 1
    whole = kept[graph.edges].all(axis=1)
    return LaidGraph(graph.points[kept], graph.omega[kept], number[graph.edges[whole]], graph.mu[whole])
