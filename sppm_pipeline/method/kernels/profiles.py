"""The profile of a kernel: how its value falls with the distance, and what follows from that (paper, section 2.3).

An isolated kernel has the value C, the level, at its radius: a pore on a sphere, a tunnel on a tube. Radii and size
parameters of one call share one unit of length. A further profile is one entry in `TUNNEL_PROFILES`: the compiled sums
are specialized for each profile on its first use, so that its exponent is inlined into the loop over samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sppm_pipeline.errors import DesignError
from sppm_pipeline.services.arrays import F32, F64

#: Kernel values below this fraction of their maximum are dropped: 2 voxels in 100 000 change sides, against 2 in
#: 100 at a cut-off of 1e-2 (measured on cells of the paper).
DEFAULT_CUTOFF = 1e-5


def _plain(squared_distance: np.float32) -> np.float32:
    return np.float32(math.sqrt(squared_distance))


def _squared(squared_distance: np.float32) -> np.float32:
    return squared_distance


@dataclass(frozen=True)
class TunnelProfile:
    """A kernel ``exp(-mu d^power)`` of the distance d (paper, eq. 1-2); `mu` counts in 1 / length^power."""

    name: str  # what configurations and stored pieces call it
    power: int
    # ``d^power`` of the squared distance, float32 to float32; compiled and inlined into the sum
    exponent: Callable[[np.float32], np.float32]

    def value(self, mu: F64, squared_distance: F64) -> F64:
        """The kernel at a squared distance, in float64: what the compiled sums approximate."""
        distance = np.sqrt(squared_distance) if self.power == 1 else squared_distance ** (self.power / 2)
        value: F64 = np.exp(-mu * distance)
        return value

    def mu(self, radius: float, level: float, name: str = "tunnel radius") -> float:
        """Size parameter of the kernel that has the value `level` at `radius`: ``ln(1 / level) / radius^power``.

        Raises DesignError if the radius is not positive or the level lies outside (0, 1).
        """
        return _log_of_level(level) / float(_positive(radius, name, "length") ** self.power)

    def radius(self, mu: float, level: float, name: str = "tunnel size parameter mu") -> float:
        """Distance at which the kernel has the value `level`, the inverse of `mu`, with the same errors."""
        return float(self.root(_log_of_level(level) / _positive(mu, name, self.unit)))

    def in_cell_units(self, mu: float, edge: float, name: str = "tunnel size parameter mu") -> float:
        """`mu` for lengths counted in cell sizes: ``mu * edge^power``; DesignError if either is not positive."""
        return _positive(mu, name, self.unit) * float(_positive(edge, "cell size", "length") ** self.power)

    def reach(self, mu: F64 | float, cutoff: float = DEFAULT_CUTOFF) -> F64:
        """Distance at which the kernel falls to the cut-off, shape of `mu`."""
        return self.root(math.log(1.0 / cutoff) / np.asarray(mu, dtype=np.float64))

    def scale(self, mu: F64) -> F64:
        """Factor s of lengths such that the kernel is ``2^-((s d)^power)``, the form of the compiled sums."""
        return self.root(np.asarray(mu, dtype=np.float64) * math.log2(math.e))

    def scaled_reach(self, cutoff: float) -> float:
        """`reach` after lengths were multiplied by `scale`: the same for every mu."""
        return float(self.root(math.log2(1.0 / cutoff)))

    def scaled_radius(self, factor: F64) -> F64:
        """Factor of mu that multiplies the radius by `factor`."""
        return factor ** -float(self.power)

    def root(self, x: F64 | float) -> F64:
        """``x^(1 / power)``, the distance at which ``d^power`` is x."""
        # the built-in profiles need no general power
        if self.power == 1:
            return np.asarray(x)
        return np.sqrt(x) if self.power == 2 else np.asarray(x) ** (1.0 / self.power)

    @property
    def unit(self) -> str:
        """Unit of mu."""
        return "1 / length" if self.power == 1 else f"1 / length^{self.power}"


TUNNEL_PROFILES = {
    profile.name: profile
    for profile in (
        TunnelProfile("linear", 1, _plain),  # the form the paper prints (eq. 2)
        TunnelProfile("squared", 2, _squared),  # tunnels that fall off like pores
    )
}
"""The profiles that `field.gaussian` offers, by name."""

PORE_PROFILE = TUNNEL_PROFILES["squared"]
"""Pores are Gaussians (paper, eq. 1); their mu is called omega."""


def omega_from_radius(radius: float, level: float) -> float:
    """Pore size parameter omega of a pore radius: ``ln(1 / level) / radius^2``."""
    return PORE_PROFILE.mu(radius, level, "pore radius")


def _log_of_level(level: float) -> float:
    """ln(1 / level), after a check of the level."""
    if not 0.0 < level < 1.0:
        raise DesignError(
            f"the level is {level!r}, but a level between 0 and 1 (both excluded) is needed",
            hint="a single pore has the value 1 in its center and falls to 0; the paper uses the level 0.25",
        )
    return math.log(1.0 / level)


def _positive(value: float, name: str, unit: str) -> float:
    if not (value > 0.0 and math.isfinite(value)):
        raise DesignError(f"the {name} is {value!r}, but a positive, finite number is needed", hint=f"unit: {unit}")
    return float(value)


MIN_SUM = 1e-5
"""Sums below this are the cut-off of the kernels, not data."""


def log_of_sums(values: F32, level: float) -> F32:
    """``ln(G / C)`` of samples of ``G - C``, with the same signs; in place."""
    values *= np.float32(1 / level)
    np.maximum(values, np.float32(MIN_SUM / level - 1), out=values)
    return np.log1p(values, out=values)
