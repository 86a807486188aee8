"""``field.walls``: walls between pores, pierced by the tunnels."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from sppm_pipeline import Cell, Context, Length, Palette, Size, Stage, TunnelGraph, option, options
from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.method.assembly.contents import TilingArrays
from sppm_pipeline.method.fields.microstructure import CUTOFF, Microstructure, pieces_from_graph, sampling_tables
from sppm_pipeline.method.kernels.kernels import log_normal_factors
from sppm_pipeline.method.kernels.profiles import PORE_PROFILE
from sppm_pipeline.nouns.size import Geometry
from sppm_pipeline.services.arrays import F32, I32
from sppm_pipeline.services.boolean_model import expected_walls
from sppm_pipeline.services.grid import Grid

if TYPE_CHECKING:
    from sppm_pipeline.features.walls.numerics.walls import WallSampler

_SAMPLERS = 32
"""Layouts of one microstructure whose Voronoi cells are cached, each up to `_KEPT_BYTES`; not measured."""

DEPTH = 0.2
"""Distance from a tunnel, in mean distances of pores, up to which the field accounts for it: no wall is as thick."""


KERNEL = 5.76
"""Parameter omega of the kernels of pores, times the square of their mean distance: that of the paper's cell."""


@dataclass(frozen=True, eq=False)
class WalledMicrostructure(Microstructure):
    """Solid within half a thickness of the faces of the pores' Voronoi cells, but for the tunnels.

    The `opening`, the half thickness above which walls close a point, takes the place of the kernel sum G of other
    microstructures, and the level is half the thickness of the walls, cell sizes. As tunnels stay open at any
    thickness, G jumps at their surface; the sampled field has the same sign and is a distance from walls and tunnels
    near both. Of the pieces only the positions of the kernels are used, and the radii of the tunnels, ``1 / mu``.

    With a share s of `struts`, ``(1 - s) D + s (l - rho)`` takes the place of the distance D from the walls: l is the
    mean distance of pores, and rho that from the nearest of them by the paper's kernels, ``G = exp(-omega rho^2)``. The
    solid then leaves the middle of the walls and gathers along their edges.
    """

    reported: ClassVar[tuple[str, ...]] = (*Microstructure.reported, "thickness", "tunnel_radius")
    follows_metric: ClassVar[bool] = False
    is_sum: ClassVar[bool] = False  # walls have creases

    rounding: float = 0.0  # radius of the fillets where walls meet and of the rims of their openings, cell sizes
    struts: float = 0.0  # share of the kernels of pores in the level set

    @property
    def finest_radius(self) -> float | None:
        mu = self.pieces.kernels.mu
        return 1 / float(mu.max()) if len(mu) else None

    @property
    def reach(self) -> float:
        """Distance beyond which pores and tunnels do not change a sample, cell sizes."""
        from sppm_pipeline.features.walls.numerics.walls import largest_empty_radius

        if self.struts:
            kernels = float(PORE_PROFILE.reach(self.pieces.kernels.omega.min(initial=np.inf), CUTOFF))
            return max(kernels, largest_empty_radius(self.pieces) + self.rounding)
        max_tunnel_radius = 1 / float(self.pieces.kernels.mu.min(initial=np.inf))
        # a face lies between pores that are not farther from it than the largest empty radius
        return max(largest_empty_radius(self.pieces) + 2 * self.level + self.rounding, max_tunnel_radius)

    @property
    def thinnest_wall(self) -> float | None:
        return None if self.struts else 2 * self.level

    def laid_sums(
        self, arrays: TilingArrays, grid: Grid, start: int, stop: int, threads: int = 1, wanted: I32 | None = None
    ) -> F32:
        """Half thickness above which walls close each sample of a layout."""
        from sppm_pipeline.features.walls.numerics.walls import opening

        return opening(*self._distances(arrays, grid, start, stop, threads), self.rounding)

    def laid_values(self, arrays: TilingArrays, grid: Grid, start: int, stop: int, threads: int = 1) -> F32:
        """Larger of the distance from walls and the depth in tunnels, negative in the solid."""
        from sppm_pipeline.features.walls.numerics.walls import wall_field

        distance, depth = self._distances(arrays, grid, start, stop, threads)
        return wall_field(distance, depth, self.level, self.rounding)

    def _distances(self, arrays: TilingArrays, grid: Grid, start: int, stop: int, threads: int) -> tuple[F32, F32]:
        """Distance from walls, or what takes its place, and depth in tunnels, (stop - start, ny, nx)."""
        distance, depth = self._sampler(arrays).sample(grid, start, stop, threads)
        if not self.struts:
            return distance, depth
        from sppm_pipeline.method.assembly.gather import sample_exact

        tables = sampling_tables(self.pieces)
        if "pores" not in tables:
            kernels = self.pieces.kernels.taken(slice(None), slice(0))
            first = np.zeros_like(self.pieces.first_tunnel)
            tables["pores"] = replace(self.pieces, kernels=kernels, first_tunnel=first)
        sums = sample_exact(tables["pores"], arrays, grid, CUTOFF, threads, start, stop).T
        length = self.graph.pores.per_cell ** (-1 / 3)
        nearest = np.sqrt(np.maximum(-np.log(np.maximum(sums, np.float32(CUTOFF))), 0) / np.float32(KERNEL / length**2))
        distance *= np.float32(1 - self.struts)
        distance += np.float32(self.struts) * (np.float32(length) - nearest)
        return distance, depth

    def _sampler(self, arrays: TilingArrays) -> WallSampler:
        """Return the sampler of a layout, shared by microstructures that differ in nothing but the level."""
        from sppm_pipeline.features.walls.numerics.walls import WallSampler

        h = hashlib.sha256(repr((arrays.shape, arrays.periodic, arrays.halo)).encode())
        for values in (arrays.interior, *arrays.faces):
            h.update(np.ascontiguousarray(values).tobytes())
        kept: dict[Any, WallSampler] = sampling_tables(self.pieces).setdefault("walls", {})
        key = h.digest(), self.rounding
        if key not in kept:
            if len(kept) >= _SAMPLERS:
                kept.pop(next(iter(kept)), None)
            depth = max(2 * (self.finest_radius or 0.0), DEPTH * self.graph.pores.per_cell ** (-1 / 3))
            margin = depth + self.rounding
            kept[key] = WallSampler(self.pieces, arrays, self.rounding, margin)
        return kept[key]

    def summary(self) -> dict[str, Any]:
        """Numbers of pores and tunnels, thickness of the walls and radius of the thinnest tunnel."""
        return {**super().summary(), "thickness": 2 * self.level, "tunnel_radius": self.finest_radius}


TUNNEL_SHARE, THICKNESS_SHARE, ROUNDING_SHARE = 0.1, 0.1, 0.07
"""Radius of tunnels, thickness of walls and rounding, in mean distances of pores, where the user gives none; sharp
walls of a density of 0.3 are 3 to 4 % softer than those with this rounding, extrapolated alike."""


MAX_LENGTH = 4.0
"""Cell sizes that no length of a wall exceeds."""

STRUTS = 0.5
"""Level of struts alone in mean distances of pores, where nothing is tuned."""

PORES_NEAR = 12.0
"""Kernels of pores that are felt at a point."""

FACES, ROUNDED = 20.0, 2.0
"""Work for a sample, in kernels: a Voronoi cell has some 15 faces, and there are the tunnels; fillets multiply it."""


@dataclass(frozen=True, kw_only=True)
class WallsField(Stage):
    """Put walls between neighboring pores, and let the tunnels pierce them: stiff, isotropic and open.

    Solid is what lies within half a thickness of the faces of the pores' Voronoi cells and in no tunnel. A target
    porosity (`tune.porosity`, a tile set's or an assembly's `porosity`) is reached by the thickness. An extension of
    the paper, for any of its pores and tunnels.

    With a share of `struts` the level set is a mean of that of the walls and of that of the paper's pores, weighted by
    it: the solid leaves the middle of the walls and gathers along their edges, which makes the structure softer at the
    same density, and Poisson's ratio smaller. What `thickness` then says is that of walls without struts.

    Where a cell is repeated, its void opens into the next one through tunnels alone. A spanning tree of pores that do
    not lie on faces has none that lead there, which is warned about.
    """

    name: ClassVar[str] = "field.walls"
    libraries: ClassVar[tuple[str, ...]] = ("networkx",)
    reported: ClassVar[tuple[str, ...]] = (
        "thickness", "tunnel_radius", "thinnest_tunnel", "rounding", "mean_pore_distance", "missed",
    )  # fmt: skip

    thickness: Length | None = option(
        None, help="thickness of the walls; a tenth of the mean distance of pores if omitted", unit="cell size",
        minimum=1e-6, maximum=4,
    )  # fmt: skip
    tunnel_radius: Length | None = options.tunnel_radius(None, note="a tenth of the mean distance of pores if omitted")
    tunnel_spread: float = options.tunnel_spread(0.0)
    rounding: Length | None = option(
        None, help="radius of the fillets where walls meet and of the rims of their openings, 0 for sharp ones; "
        "0.07 mean distances of pores if omitted", unit="cell size", minimum=0, maximum=1,
    )  # fmt: skip

    struts: float = option(
        0.0, help="share of the paper's pores in the level set: 0 for walls, 1 for struts", minimum=0, maximum=1
    )

    def estimate(self, palette: Palette, graph: Size) -> Size:
        cell = graph.cell
        length, half, radius, rounding = self._sizes(cell.cell, cell.pores)
        porosity, surface = expected_walls(length, half, radius, cell.tunnels)
        # every sample is compared with the faces of a Voronoi cell; no patches are shared, whatever repeats
        work = (FACES * ROUNDED if rounding else FACES) + (PORES_NEAR if self.struts else 0.0)
        made = Geometry(edge_mm=cell.edge_mm, porosity=porosity, surface=surface, kernels=work, reach=math.inf)
        return Size(
            pores=cell.interiors * cell.pores, tunnels=cell.interiors * cell.tunnels,
            design=replace(cell, radii=(length / 2, radius)), geometry=made,
        )  # fmt: skip

    def run(self, context: Context, graph: TunnelGraph) -> WalledMicrostructure:
        """Give the walls a thickness and every tunnel a radius."""
        graph, missed = joined_to_nearest(graph)
        pores = graph.pores
        if not len(pores.centers):
            raise DesignError("there are no pores to put walls between", hint="sample some, for example `total: 70`")
        _warn_if_closed(context, graph)
        length, half, radius, rounding = self._sizes(pores.cell, pores.per_cell)
        radii = radius * log_normal_factors(lambda: context.rng(1), self.tunnel_spread, len(graph.edges))
        context.report(
            thickness=2 * half, tunnel_radius=radius, thinnest_tunnel=float(radii.min(initial=radius)),
            rounding=rounding, mean_pore_distance=length, missed=missed,
        )  # fmt: skip
        omega = np.full(len(pores.centers), (KERNEL if self.struts else 1.0) * length**-2)
        pieces = pieces_from_graph(graph, omega, 1 / radii, "linear")
        level = (1 - self.struts) * half + self.struts * STRUTS * length
        return WalledMicrostructure(pores.cell, graph, pieces, level, rounding=rounding, struts=self.struts)

    def _sizes(self, cell: Cell, pores: float) -> tuple[float, float, float, float]:
        """Mean distance of pores, half a thickness, radius of the tunnels, rounding; cell sizes."""
        length = max(pores, 1e-9) ** (-1 / 3)

        def given(name: str, share: float) -> float:
            value: Length | None = getattr(self, name)
            found = share * length if value is None else cell.fraction(value)
            if value is not None and not found <= MAX_LENGTH:
                raise ConfigError(
                    f"option {name!r} is {value}, that is {found:.3g} cell sizes; allowed are {MAX_LENGTH:g}"
                )
            return found

        half, radius = given("thickness", THICKNESS_SHARE) / 2, given("tunnel_radius", TUNNEL_SHARE)
        return length, half, radius, given("rounding", ROUNDING_SHARE)


def _warn_if_closed(context: Context, graph: TunnelGraph) -> None:
    """Warn if the tunnels of a cell do not lead to the next one: walls leave no other way."""
    from sppm_pipeline.method.connecting.statistics import wraps

    if graph.pores.interiors > 1 or graph.pores.blocks is not None:
        return
    through = wraps(len(graph.pores.centers), graph.edges, graph.shift)
    closed = ", ".join(axis for axis, open_ in zip("xyz", through, strict=True) if not open_)
    if closed:
        context.warn(
            f"no tunnel leads from cell to cell along {closed}: where this cell is repeated, walls close its void off; "
            "put pores on its faces by `sample.mirrored_faces`, or join by `connect.relative_neighbors` or `.mbdst`"
        )


def joined_to_nearest(graph: TunnelGraph) -> tuple[TunnelGraph, int]:
    """The graph with a tunnel from each pore that has none to the nearest of its piece, and how many those are.

    The only pore of a periodic cell is joined to its image; the only one of another piece stays closed.
    """
    pores = graph.pores
    lone = pores.interiors == 1 and pores.blocks is None
    edges, shifts = [], []
    for i in np.flatnonzero(np.bincount(graph.edges.ravel(), minlength=len(pores.centers)) == 0):
        others = pores.indices(int(pores.piece[i]))
        step = pores.centers[others] - pores.centers[i]
        image = -np.round(step) if lone and pores.piece[i] == 0 else np.zeros_like(step)
        if lone and len(pores.centers) == 1:
            image[0, 0] = 1.0
        squared = ((step + image) ** 2).sum(1)
        squared[squared == 0] = np.inf
        nearest = int(squared.argmin())
        if np.isfinite(squared[nearest]):
            edges.append((i, others[nearest]))
            shifts.append(image[nearest])
    if not edges:
        return graph, 0
    joined = TunnelGraph(pores, np.concatenate([graph.edges, edges]), np.concatenate([graph.shift, shifts]))
    return joined, len(edges)
