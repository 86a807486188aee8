"""``field.gaussian``: the sum of pore and tunnel kernels."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

from sppm_pipeline import Cell, Context, Length, Microstructure, Palette, Size, Stage, TunnelGraph, option, options
from sppm_pipeline.errors import ConfigError
from sppm_pipeline.method.fields.microstructure import CUTOFF, LOWEST_LEVEL, finest_pitch, pieces_from_graph
from sppm_pipeline.method.kernels.kernels import log_normal_factors
from sppm_pipeline.method.kernels.profiles import PORE_PROFILE, TUNNEL_PROFILES, TunnelProfile
from sppm_pipeline.nouns.size import Geometry
from sppm_pipeline.services.arrays import F64

MIN_REACH, MAX_REACH = 1e-3, 8.0
"""Cell sizes from the axis of a kernel to where it is cut off. A narrower one is missed by every grid; a wider one
is summed in more than 4000 cells around its own."""


@dataclass(frozen=True, kw_only=True)
class GaussianField(Stage):
    """Sum Gaussian pores ``exp(-omega r^2)`` and tunnels ``exp(-mu d)``, cut at the level C (paper, eq. 1-5).

    Sizes are given either as radii, which an isolated kernel has at the level C, or as omega and mu. These count in
    cell sizes, or in the unit in which the first sampling stage gives the cell an `edge` without a unit: with the
    paper's omega = mu = 30 that is ``edge: 2``. The paper prints tunnels with the plain distance d; with ``tunnel:
    squared`` they fall off like pores. Sizes may vary from pore to pore and from tunnel to tunnel by a log-normal
    factor.
    """

    name: ClassVar[str] = "field.gaussian"
    reported: ClassVar[tuple[str, ...]] = (
        "pore_radius", "tunnel_radius", "pore_radius_mm", "tunnel_radius_mm", "omega", "mu",
    )  # fmt: skip

    pore_radius: Length | None = options.pore_radius(None)
    tunnel_radius: Length | None = options.tunnel_radius(None)
    omega: float | None = option(None, help="pore size parameter", unit="1 / cell size^2", minimum=1e-9, maximum=1e15)
    mu: float | None = option(
        None, help="tunnel size parameter", unit="1 / cell size (linear) or 1 / cell size^2 (squared)", minimum=1e-9,
        maximum=1e15,
    )  # fmt: skip
    level: float = options.level(0.25)
    tunnel: str = option("linear", help="how the distance enters the tunnel kernel", choices=tuple(TUNNEL_PROFILES))
    pore_spread: float = option(0.0, help="standard deviation of the logarithm of the pore radii", minimum=0, maximum=1)
    tunnel_spread: float = options.tunnel_spread(0.0)

    def check_options(self) -> None:
        if (self.pore_radius is None) == (self.omega is None):
            raise ConfigError("give the size of the pores by one of `pore_radius` and `omega`")
        if (self.tunnel_radius is None) == (self.mu is None):
            raise ConfigError("give the size of the tunnels by one of `tunnel_radius` and `mu`")

    def estimate(self, palette: Palette, graph: Size) -> Size:
        from sppm_pipeline.services.boolean_model import expected_structure, kernels_at_a_point

        cell, profile = graph.cell, TUNNEL_PROFILES[self.tunnel]
        omega, mu = self._parameters(cell.cell)
        radii = PORE_PROFILE.radius(omega, self.level), profile.radius(mu, self.level)
        reaches = float(PORE_PROFILE.reach(omega, CUTOFF)), float(profile.reach(mu, CUTOFF))
        porosity, surface = expected_structure(cell.pores, cell.tunnels, *radii)
        kernels = kernels_at_a_point(cell.pores, cell.tunnels, *reaches)
        # what is below this level is summed sample by sample, see `Microstructure.coarse_pitch`
        coarse = 1 / finest_pitch(omega, mu, self.tunnel, self.level) if self.level >= LOWEST_LEVEL else math.inf
        made = Geometry(
            edge_mm=cell.edge_mm, porosity=porosity, surface=surface, kernels=kernels, reach=max(reaches), coarse=coarse
        )
        return Size(
            pores=cell.interiors * cell.pores, tunnels=cell.interiors * cell.tunnels,
            design=replace(cell, radii=radii), geometry=made,
        )  # fmt: skip

    def run(self, context: Context, graph: TunnelGraph) -> Microstructure:
        """Give every pore and tunnel its kernel."""
        cell, profile = graph.pores.cell, TUNNEL_PROFILES[self.tunnel]
        omega, mu = self._parameters(cell)
        pores = log_normal_factors(lambda: context.rng(0), self.pore_spread, len(graph.pores.centers))
        tunnels = log_normal_factors(lambda: context.rng(1), self.tunnel_spread, len(graph.edges))
        all_omega = omega * PORE_PROFILE.scaled_radius(pores)
        all_mu = mu * profile.scaled_radius(tunnels)
        del pores, tunnels  # there may be millions
        self._check_reach("pore_radius" if self.omega is None else "omega", PORE_PROFILE.reach(all_omega, CUTOFF))
        self._check_reach("tunnel_radius" if self.mu is None else "mu", profile.reach(all_mu, CUTOFF))
        radii = {"pore_radius": PORE_PROFILE.radius(omega, self.level), "tunnel_radius": profile.radius(mu, self.level)}
        if cell.physical:
            radii |= {f"{name}_mm": radius * cell.edge for name, radius in radii.items()}
        context.report(**radii, omega=omega, mu=mu)
        return Microstructure(cell, graph, pieces_from_graph(graph, all_omega, all_mu, self.tunnel), self.level)

    def _parameters(self, cell: Cell) -> tuple[float, float]:
        """Omega and mu in cell sizes, from whichever option is there."""
        profile = TUNNEL_PROFILES[self.tunnel]
        return (
            self._parameter(cell, PORE_PROFILE, "omega", self.omega, "pore_radius", self.pore_radius),
            self._parameter(cell, profile, "mu", self.mu, "tunnel_radius", self.tunnel_radius),
        )

    def _parameter(
        self, cell: Cell, profile: TunnelProfile, name: str, value: float | None, other: str, radius: Length | None
    ) -> float:
        if value is None:
            assert radius is not None
            return profile.mu(cell.fraction(radius), self.level, other.replace("_", " "))
        if cell.physical:
            same = f"{profile.radius(value, self.level):.4g}"
            raise ConfigError(
                f"`{name}: {value:g}` has no unit, and the cell has a physical size, {cell.edge:g} mm",
                hint=f"write `{other}: {same} mm` if it counts in millimeters, `{other}: {same} cell` if in cells; "
                "or leave the size to `cell` of a `tile` stage, with `edge: 2` for the numbers of the paper",
            )
        return profile.in_cell_units(value, cell.edge, f"size parameter {name}")

    def _check_reach(self, name: str, reach: F64) -> None:
        """Refuse kernels that no grid shows, and kernels so wide that each is felt in hundreds of cells around it."""
        if len(reach) and not (reach.min() >= MIN_REACH and reach.max() <= MAX_REACH):
            raise ConfigError(
                f"option {name!r} is {getattr(self, name)}, which makes kernels that reach {reach.min():.3g} to "
                f"{reach.max():.3g} cell sizes; allowed are {MIN_REACH:g} to {MAX_REACH:g}",
                hint="lengths without a unit are fractions of the cell size",
            )
