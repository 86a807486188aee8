"""A set of pore and tunnel kernels as arrays."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.method.kernels.profiles import DEFAULT_CUTOFF, PORE_PROFILE, TUNNEL_PROFILES
from sppm_pipeline.services.arrays import F64, I64, Bools
from sppm_pipeline.services.metric import PLAIN, half_widths, semi_axes


class Kernels(NamedTuple):
    """Point kernels ``exp(-omega |p - c|^2)`` and segment kernels, say ``exp(-mu d)`` (paper, eq. 1-2).

    ``d`` is the distance of p from the segment. All lengths are in one unit (inside a tile set: the cell size). Where
    pores are stretched, every kernel measures distances in a metric of its own.

    Attributes
    ----------
    centers : (n, 3) float64
        Pore centers.
    omega : (n,) float64
        Pore size parameter, 1 / length^2.
    starts, ends : (m, 3) float64
        End points of the tunnels.
    mu : (m,) float64
        Tunnel size parameter, in the unit of the profile.
    profile : str
        Name of the tunnels' profile, a key of `TUNNEL_PROFILES`.
    pore_metric : (n, 6) float64, optional
        Metrics of the pores, see `services.metric`; plain distances if omitted.
    tunnel_metric : (m, 6) float64, optional
        Metrics of the tunnels; there are both or none.
    """

    centers: F64
    omega: F64
    starts: F64
    ends: F64
    mu: F64
    profile: str = "linear"
    pore_metric: F64 | None = None
    tunnel_metric: F64 | None = None

    def taken(self, pores: slice | NDArray[Any], tunnels: slice | NDArray[Any]) -> Kernels:
        """Some of the pores and some of the tunnels: by slices, by indices or by masks; the latter two make copies."""
        return Kernels(
            _rows(self.centers, pores), _rows(self.omega, pores), _rows(self.starts, tunnels),
            _rows(self.ends, tunnels), _rows(self.mu, tunnels), self.profile,
            None if self.pore_metric is None else _rows(self.pore_metric, pores),
            None if self.tunnel_metric is None else _rows(self.tunnel_metric, tunnels),
        )  # fmt: skip

    def shifted(self, offset: F64) -> Kernels:
        """The same kernels moved by `offset` (3,)."""
        return self._replace(centers=self.centers + offset, starts=self.starts + offset, ends=self.ends + offset)


def _rows(array: NDArray[Any], chosen: slice | NDArray[Any]) -> NDArray[Any]:
    """Some rows of an array; where they are short, `take` is four times as fast as an index or a mask."""
    if isinstance(chosen, slice):
        return array[chosen]
    return array.take(np.flatnonzero(chosen) if chosen.dtype == np.bool_ else chosen, axis=0)


def empty_kernels() -> Kernels:
    """No kernel at all."""
    points, values = np.zeros((0, 3)), np.zeros(0)
    return Kernels(points, values, points, points, values)


def concatenated(parts: Iterable[Kernels]) -> Kernels:
    """All kernels of several sets in order; sets without tunnels fit any. ValueError if tunnel profiles differ."""
    parts = list(parts)
    if not parts:
        return empty_kernels()
    profiles = sorted({part.profile for part in parts if len(part.starts)})
    if len(profiles) > 1:
        raise ValueError(f"a kernel set has one tunnel profile, not {' and '.join(profiles)}")
    # a set with metrics takes plain distances as metrics, too
    stretched = any(part.pore_metric is not None for part in parts)
    return Kernels(
        np.concatenate([part.centers for part in parts]), np.concatenate([part.omega for part in parts]),
        np.concatenate([part.starts for part in parts]), np.concatenate([part.ends for part in parts]),
        np.concatenate([part.mu for part in parts]), profiles[0] if profiles else parts[0].profile,
        np.concatenate([_metrics(p.pore_metric, len(p.omega)) for p in parts]) if stretched else None,
        np.concatenate([_metrics(p.tunnel_metric, len(p.mu)) for p in parts]) if stretched else None,
    )  # fmt: skip


def _metrics(metric: F64 | None, n: int) -> F64:
    return np.tile(PLAIN, (n, 1)) if metric is None else metric


def kernel_reaches(kernels: Kernels, cutoff: float = DEFAULT_CUTOFF) -> tuple[F64, F64]:
    """Distances (n,) and (m,) from centers and axes beyond which pores and tunnels lie below the cut-off."""
    pores = PORE_PROFILE.reach(kernels.omega, cutoff)
    tunnels = TUNNEL_PROFILES[kernels.profile].reach(kernels.mu, cutoff)
    if kernels.pore_metric is None or kernels.tunnel_metric is None:
        return pores, tunnels
    return pores * semi_axes(kernels.pore_metric)[:, 0], tunnels * semi_axes(kernels.tunnel_metric)[:, 0]


def steepest(kernels: Kernels) -> tuple[float, float]:
    """The largest size parameters omega and mu that a pore and a tunnel have along any direction; 0 for none."""
    omega, mu = kernels.omega, kernels.mu
    if kernels.pore_metric is not None and kernels.tunnel_metric is not None:
        # along its shortest semi-axis a stretched kernel is steepest
        omega = omega * PORE_PROFILE.scaled_radius(semi_axes(kernels.pore_metric)[:, 1])
        mu = mu * TUNNEL_PROFILES[kernels.profile].scaled_radius(semi_axes(kernels.tunnel_metric)[:, 1])
    return float(omega.max(initial=0)), float(mu.max(initial=0))


def reach_boxes(kernels: Kernels, cutoff: float = DEFAULT_CUTOFF) -> tuple[F64, F64, F64, F64]:
    """Low and high corners (n, 3) of boxes outside of which pores, then tunnels, lie below the cut-off."""
    pores, tunnels = half_boxes(kernels, slice(None), slice(None), cutoff)
    return (
        kernels.centers - pores,
        kernels.centers + pores,
        np.minimum(kernels.starts, kernels.ends) - tunnels,
        np.maximum(kernels.starts, kernels.ends) + tunnels,
    )


def half_boxes(kernels: Kernels, pores: slice | I64, tunnels: slice | I64, cutoff: float) -> tuple[F64, F64]:
    """Reach of some pores, (n, 1 or 3), and tunnels, (m, 1 or 3), along each axis, or along all."""
    omega, mu = _rows(kernels.omega, pores), _rows(kernels.mu, tunnels)
    reaches = PORE_PROFILE.reach(omega, cutoff), TUNNEL_PROFILES[kernels.profile].reach(mu, cutoff)
    of_pores, of_tunnels = (reach[:, None] for reach in reaches)
    if kernels.pore_metric is None or kernels.tunnel_metric is None:
        return of_pores, of_tunnels
    return (
        of_pores * half_widths(_rows(kernels.pore_metric, pores)),
        of_tunnels * half_widths(_rows(kernels.tunnel_metric, tunnels)),
    )


def boxes_meet(low: F64, high: F64, lower: F64, upper: F64) -> Bools:
    """Which of the boxes from `low` to `high`, both (n, 3), meet the one from `lower` to `upper`, (n,) bool."""
    meet = (low[:, 0] <= upper[0]) & (high[:, 0] >= lower[0])
    for axis in (1, 2):  # the sum over rows of three takes longer than all else
        meet &= low[:, axis] <= upper[axis]
        meet &= high[:, axis] >= lower[axis]
    return np.asarray(meet)


def log_normal_factors(generator: Callable[[], np.random.Generator], spread: float, n: int) -> F64:
    """Factors of radii (n,): log-normal, median 1, cut at two deviations so that no pore swallows a cell.

    The generator is asked for only where there is a spread: equal radii need no seed.
    """
    if not spread:
        return np.ones(n)
    return np.exp(spread * np.clip(generator().standard_normal(n), -2, 2))
