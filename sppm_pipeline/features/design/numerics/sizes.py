"""Search of the porosity at which struts and pores have a ratio of sizes, on fixed draws of a cell."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import takewhile

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.method.connectivity.components import find_components
from sppm_pipeline.services.local_thickness import LimitSizes, limit_sizes, local_thickness

TORUS = (True, True, True)

POROSITIES = (0.05, 0.95)
"""Porosities that are searched; beyond, one phase of every cell measured was in pieces."""

MIN_CONNECTED = 0.9
"""Least share of a phase in its largest component: later stages refuse to remove 10 % of the solid or more."""

CLOSE = 0.01
"""Relative error of the ratio at which the corrections end; each size gets half of it, a fifth of what a draw scatters.
Half of it takes about one more evaluation."""

CORRECTIONS = 8
"""Most evaluations on the fine grid; cells took one to three, more only where a phase measures few voxels."""

SCAN = 0.02
"""Step of the porosity with which the reachable range is looked for; it only decides how near the named ratio is."""


@dataclass
class Draws:
    """Sampled fields of the same draws on two grids, cut at any porosity: every evaluation sees the same pores."""

    fine: Sequence[NDArray[np.float32]]  # values (n, n, n) of periodic cells, solid below a level
    coarse: Sequence[NDArray[np.float32]]  # about half as many samples along an edge
    known: dict[float, tuple[LimitSizes, ...]] = field(default_factory=dict)

    def coarse_ratio(self, porosity: float) -> float:
        """Ratio of solid to void on the coarse grid, within some percent, but quick: balls are a voxel too small."""
        solid, void = (_thickness(phases) for phases in _phases(self.coarse, porosity))
        return float((solid[solid > 0].mean(dtype=np.float64) + 1) / (void[void > 0].mean(dtype=np.float64) + 1))

    def ratio(self, porosity: float) -> float:
        """Mean size of the solid over that of the void, in the limit of fine grids."""
        solid, void = self.sizes(porosity)
        return solid.mean / void.mean

    def sizes(self, porosity: float) -> tuple[LimitSizes, ...]:
        """Sizes of solid and void in the limit of fine grids, in cell sizes."""
        if porosity not in self.known:
            spacings = (1 / self.fine[0].shape[0], 1 / self.coarse[0].shape[0])
            fine = [_thickness(phases) for phases in _phases(self.fine, porosity)]
            coarse = [_thickness(phases) for phases in _phases(self.coarse, porosity)]
            self.known[porosity] = tuple(limit_sizes(f, c, spacings) for f, c in zip(fine, coarse, strict=True))
        return self.known[porosity]

    def connected(self, porosity: float) -> bool:
        """Test whether solid and void run through in x, y and z and are in one piece but for small rests."""
        for phases in _phases(self.fine, porosity):
            found = [find_components(phase, TORUS) for phase in phases]
            if not all(len(one.sizes) and one.wraps[0].all() for one in found):
                return False
            if sum(float(one.sizes[0] / one.sizes.sum()) for one in found) < MIN_CONNECTED * len(found):
                return False
        return True

    def porosity_for(self, ratio: float) -> float | None:
        """The porosity at which solid over void has a ratio; None if there is none in `POROSITIES`.

        Bisected on the coarse grid; the fine one is corrected by its slope, and by secants once it is enclosed.
        """
        start = self._bisected(ratio)
        if start is None:
            return None
        # near the start both grids have nearly the same relative slope
        low, high = max(start - 0.02, POROSITIES[0]), min(start + 0.02, POROSITIES[1])
        slope = math.log(self.coarse_ratio(high) / self.coarse_ratio(low)) / (high - low)
        errors: dict[float, float] = {}
        at = start
        while len(errors) < CORRECTIONS and at not in errors:
            errors[at] = math.log(self.ratio(at) / ratio)
            if abs(errors[at]) < CLOSE:
                return at
            # the ratio falls: too large a one needs more porosity
            denser = max((p for p in errors if errors[p] > 0), default=None)
            lighter = min((p for p in errors if errors[p] <= 0), default=None)
            if denser is None or lighter is None:
                at = min(max(at - errors[at] / slope, POROSITIES[0]), POROSITIES[1])
            else:
                # ln r is nearly straight over the logit of the porosity
                a, b = (math.log(p / (1 - p)) for p in (denser, lighter))
                share = errors[denser] / (errors[denser] - errors[lighter])
                share = min(max(share, 0.1), 0.9)  # one end that stays would slow the search down
                at = 1 / (1 + math.exp(-(a + (b - a) * share)))
        return None

    def _bisected(self, ratio: float) -> float | None:
        low, high = POROSITIES
        # the coarse ratio is not exact at the ends: the fine grid decides there
        if not self.coarse_ratio(high) * 0.5 < ratio < self.coarse_ratio(low) * 2:
            return None
        while high - low > 0.01:
            middle = (low + high) / 2
            low, high = (middle, high) if self.coarse_ratio(middle) > ratio else (low, middle)
        return (low + high) / 2

    def reachable(self, progress: Callable[[int, int], None]) -> tuple[float, float] | None:
        """Lowest and highest ratio of cells that are connected; None if no cell is.

        The ratio falls with the porosity, and cells break into pieces at both ends. The range is followed outwards from
        the middle: beyond its ends single porosities may be connected by chance.
        """
        steps = np.arange(POROSITIES[0] + SCAN, POROSITIES[1] - SCAN / 2, SCAN)
        outwards = np.argsort(np.abs(steps - 0.5), kind="stable")
        middle = next((int(i) for i in outwards if self.connected(float(steps[i]))), None)
        if middle is None:
            return None
        progress(1, 2)
        below, above = steps[:middle][::-1], steps[middle + 1 :]
        densest, lightest = (
            [float(steps[middle]), *takewhile(self.connected, map(float, side))][-1] for side in (below, above)
        )
        return self.ratio(lightest), self.ratio(densest)


def _phases(values: Sequence[NDArray[np.float32]], porosity: float) -> tuple[list[NDArray[np.uint8]], ...]:
    """Solid and void of all draws at a porosity, which each of them has exactly."""
    solid = [(one < np.quantile(one, 1 - porosity)).view(np.uint8) for one in values]
    return solid, [1 - one for one in solid]


def _thickness(phases: Sequence[NDArray[np.uint8]]) -> NDArray[np.float32]:
    """Local thickness of one phase of all draws, in voxels."""
    return np.concatenate([local_thickness(phase, TORUS) for phase in phases])
