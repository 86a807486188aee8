"""Microstructure of walls between pores, pierced by tunnels, for any layout of interiors and faces."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.method.assembly.contents import TilingArrays
from sppm_pipeline.method.fields.microstructure import CUTOFF, Microstructure, sampling_tables
from sppm_pipeline.method.kernels.profiles import PORE_PROFILE
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

    rounding: float = 0.0  # radius of the fillets where walls meet and of the rims of their openings, cell sizes
    struts: float = 0.0  # share of the kernels of pores in the level set

    @property
    def additive(self) -> bool:
        return False

    @property
    def coarse_pitch(self) -> None:
        """None: walls have creases, across which nothing may be interpolated."""
        return None

    def own_values(self, grid: Grid, start: int, stop: int, threads: int = 1) -> NDArray[np.float32]:
        return self.alone(0, (0, 0, 0)).own_values(grid, start, stop, threads)

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
        self, arrays: TilingArrays, grid: Grid, start: int, stop: int, threads: int = 1,
        wanted: NDArray[np.int32] | None = None,
    ) -> NDArray[np.float32]:  # fmt: skip
        """Half thickness above which walls close each sample of a layout."""
        from sppm_pipeline.features.walls.numerics.walls import opening

        return opening(*self._distances(arrays, grid, start, stop, threads), self.rounding)

    def laid_values(
        self, arrays: TilingArrays, grid: Grid, start: int, stop: int, threads: int = 1
    ) -> NDArray[np.float32]:
        """Larger of the distance from walls and the depth in tunnels, negative in the solid."""
        from sppm_pipeline.features.walls.numerics.walls import wall_field

        distance, depth = self._distances(arrays, grid, start, stop, threads)
        return wall_field(distance, depth, self.level, self.rounding)

    def _distances(
        self, arrays: TilingArrays, grid: Grid, start: int, stop: int, threads: int
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
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
