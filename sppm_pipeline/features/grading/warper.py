"""Base class of stages that bend a tiling to another shape: one method maps points."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.grading.curved_cells import CurvedCells
from sppm_pipeline.features.grading.warped import LaidGraph, cloud, laid_graph
from sppm_pipeline.features.grading.warped_field import WarpedField, cells_sampled, warped_field
from sppm_pipeline.method.families import options
from sppm_pipeline.method.families.tiler import HALO
from sppm_pipeline.method.fields.scalar_field import ScalarField
from sppm_pipeline.method.fields.tiling import Tiling
from sppm_pipeline.nouns.palette import Palette
from sppm_pipeline.nouns.size import Size
from sppm_pipeline.stage import Context, Stage

SEAMS = 17
"""Places along an edge of the box at which it is mapped to find what box it fills: a choice."""


SAMPLES, FINE_SAMPLES = 64, 128
"""Samples along an edge of a cell from which others are interpolated: choices. A lone cell takes 9 MB and some .05 s
with the larger number; of octets with joints that are not rounded 8 in 100 000 points change sides then, else 35.
"""


class Mapped(NamedTuple):
    """Points of the box in the part.

    Attributes
    ----------
    points : (n, 3) float64, mm
    volume : (n,) float64
        Volume of what was a cell there over that of a cell.
    """

    points: NDArray[np.float64]
    volume: NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Warper(Stage):
    """Common base of the family ``warp``: implement `mapped`, and `wraps` if the box bites its tail.

    Of stochastic cells the graph is mapped: pores go where the mapping puts them, tunnels stay straight between them.
    Any other field is mapped itself, if the stage knows the way back (`curved`).
    """

    version: ClassVar[int] = 2

    sizes: str = options.sizes("cell")
    resolution: int | None = options.resolution(
        None,
        note="from which fields other than stochastic cells are interpolated; if omitted, 128 in a lone cell that "
        "repeats, and 64 in each of several",
        minimum=16,
        maximum=256,
    )

    @abstractmethod
    def mapped(self, tiling: ScalarField, places: NDArray[np.float64]) -> Mapped:
        """Where places (n, 3) of the box go, which are in cell sizes from its low corner."""

    def wraps(self, tiling: ScalarField) -> tuple[bool, bool, bool]:
        """Axes along which the end of the box meets its beginning."""
        return (False, False, False)

    def curved(self, tiling: ScalarField) -> CurvedCells | None:
        """The bent cells of a field, by which places in them are found; None if the stage knows no way back."""
        return None

    def estimate(self, palette: Palette, field: Size) -> Size:
        return field

    def run(self, context: Context, field: ScalarField) -> ScalarField:
        """Map the graph, and lay it in blocks; or map the field."""
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
        return self._with_field(context, field)

    def _with_field(self, context: Context, field: ScalarField) -> WarpedField:
        curved = self.curved(field)
        if curved is None:
            raise ConfigError(
                f"{self.name} maps pores and tunnels alone, and can't bend a {type(field).__name__}",
                hint="warp structures that end with `field.gaussian`",
            )
        if self.sizes == "fixed":
            raise ConfigError(
                f"a {type(field).__name__} is bent as it is, and has no sizes that could stay",
                hint="leave out `sizes`",
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
        good = there.volume > 0
        block = edge * max(1.0, micro.reach * float(np.max(stretch[0][good], initial=1.0)) / HALO)
        from sppm_pipeline.method.kernels.profiles import PORE_PROFILE, TUNNEL_PROFILES

        profile = TUNNEL_PROFILES[micro.pieces.kernels.profile]
        changed = LaidGraph(
            np.where(good[:, None], there.points, np.inf),
            graph.omega * PORE_PROFILE.scaled_radius(stretch[0] * edge / block),
            graph.edges,
            graph.mu * profile.scaled_radius(stretch[1] * edge / block),
        )
        made = cloud(
            _without_lost(changed),
            block,
            self._box(field),
            micro.pieces.kernels.profile,
            micro.level,
            exact=field.exact,
            curved=self.curved(field),
        )
        if made.tileset.micro.reach > HALO + 1e-9:
            raise DesignError(
                "the kernels reach farther than the next block", hint="give smaller radii or larger cells"
            )
        context.report(volume_min=float(there.volume[good].min()), volume_max=float(there.volume[good].max()))
        return made

    def _box(self, tiling: Tiling) -> NDArray[np.float64]:
        """Low and high corner of the mapped box, (2, 3) mm."""
        curved = self.curved(tiling)
        if curved is not None:
            return curved.box
        axes = [np.linspace(0, n, SEAMS * 2 - 1) for n in tiling.cells]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
        points = self.mapped(tiling, grid).points
        return np.array([points.min(axis=0), points.max(axis=0)])


def _middles(graph: LaidGraph, cells: tuple[int, int, int], wraps: tuple[bool, bool, bool]) -> NDArray[np.float64]:
    """Middles of the tunnels in the box; those that go around by the shorter way."""
    start, end = (graph.points[graph.edges[:, k]] for k in range(2))
    way = end - start
    for axis in range(3):
        if wraps[axis]:
            way[:, axis] -= cells[axis] * np.round(way[:, axis] / cells[axis])
    middle: NDArray[np.float64] = start + way / 2
    return middle


def _without_lost(graph: LaidGraph) -> LaidGraph:
    """The graph without pores that have no place, and their tunnels."""
    kept: NDArray[np.bool_] = np.isfinite(graph.points[:, 0])
    number = np.cumsum(kept) - 1
    whole = kept[graph.edges].all(axis=1)
    return LaidGraph(graph.points[kept], graph.omega[kept], number[graph.edges[whole]], graph.mu[whole])
