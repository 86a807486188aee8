"""Radii of pores and tunnels at a level, and kernels of other radii at the same level."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sppm_pipeline.method.fields.microstructure import Microstructure
from sppm_pipeline.method.kernels.profiles import PORE_PROFILE, TUNNEL_PROFILES

MAX_CHANGE = 0.1
"""Change of a radius, as a fraction, that triggers a warning; a factor of two changes only who is warned."""


class Radii(NamedTuple):
    """Radii of isolated pores and tunnels, cell sizes: geometric means where they vary.

    0 if there is none, and at levels of 1 or more, which no isolated kernel reaches.
    """

    pore: float
    tunnel: float

    def in_words(self, edge_mm: float | None) -> tuple[str, str]:
        """Both of them, in mm, too, if the size of the cell is known."""
        pore, tunnel = (f"{r:.4g}" + ("" if edge_mm is None else f" ({r * edge_mm:.4g} mm)") for r in self)
        return pore, tunnel


def radii_of(micro: Microstructure) -> Radii:
    """Radii at the level of the microstructure."""
    kernels, level = micro.pieces.kernels, micro.level
    # an isolated kernel is 1 at its center and nowhere more
    if level >= 1:
        return Radii(0.0, 0.0)
    # radii are log-normal: their median is the geometric mean
    omega, mu = (float(np.exp(np.log(of).mean())) if len(of) else 0.0 for of in (kernels.omega, kernels.mu))
    profile = TUNNEL_PROFILES[kernels.profile]
    return Radii(PORE_PROFILE.radius(omega, level) if omega else 0.0, profile.radius(mu, level) if mu else 0.0)


def with_radii(micro: Microstructure, pore: float = 1.0, tunnel: float = 1.0) -> Microstructure:
    """The same pores and tunnels at the same level, with their radii multiplied by a factor each."""
    kernels = micro.pieces.kernels
    profile = TUNNEL_PROFILES[kernels.profile]
    changed = kernels._replace(
        omega=kernels.omega * PORE_PROFILE.scaled_radius(np.array([pore])),
        mu=kernels.mu * profile.scaled_radius(np.array([tunnel])),
    )
    return replace(micro, pieces=replace(micro.pieces, kernels=changed))


def reported_radii(micro: Microstructure, asked: Radii) -> dict[str, float]:
    """Radii obtained beside those asked for, in mm, too, if the size of the cell is known."""
    found: dict[str, float] = {}
    for name, obtained, before in zip(Radii._fields, radii_of(micro), asked, strict=True):
        found |= {f"{name}_radius": obtained, f"{name}_radius_asked": before}
        if micro.edge_mm is not None:
            found[f"{name}_radius_mm"] = obtained * micro.edge_mm
            found[f"{name}_radius_asked_mm"] = before * micro.edge_mm
    return found


def radius_warning(micro: Microstructure, asked: Radii) -> str | None:
    """Warning if pores or tunnels have become more than `MAX_CHANGE` larger or smaller; None otherwise."""
    obtained = radii_of(micro)
    if all(abs(now - before) <= MAX_CHANGE * before for now, before in zip(obtained, asked, strict=True)):
        return None
    texts = zip(Radii._fields, obtained.in_words(micro.edge_mm), asked.in_words(micro.edge_mm), strict=True)
    changed = " and ".join(f"the {name} radius is {now} cell sizes instead of {before}" for name, now, before in texts)
    return (
        f"the level {micro.level:.3g} changes the radii: {changed}; `hold: tunnel_radius` or `hold: pore_radius` keeps "
        "one of them, and `fit_count: true` takes a number of pores that fits both"
    )
