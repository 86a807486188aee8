"""How far the statistics of two images are apart."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.features.scans.numerics import statistics as st
from sppm_pipeline.features.scans.numerics.describing import Balls, Phase, balls_of, curves_of

F64 = NDArray[np.float64]

KINDS = ("S2", "chords", "thickness", "fabric")
"""Statistics that are matched; the porosity always is."""


class Look(NamedTuple):
    """Statistics of an image, lengths in voxels.

    Attributes
    ----------
    share : float
        Of the solid.
    pairs : (m,) float64
        S2 over distances.
    phases : (solid, void) of Phase
    balls : (solid, void) of Balls
    fabric : (3,) float64
        Mean intercept lengths of the solid, longest first.
    """

    share: float
    pairs: F64
    phases: tuple[Phase, Phase]
    balls: tuple[Balls, Balls]
    fabric: F64

    @classmethod
    def at(cls, solid: NDArray[np.bool_], wraps: bool, distances: int) -> Look:
        """Look at an image (x, y, z)."""
        void = ~solid
        return cls(
            float(solid.mean()), st.radial_pairs(solid, distances, wraps)[1],
            (curves_of(solid, distances, wraps), curves_of(void, distances, wraps)),
            (balls_of(solid, wraps, 1), balls_of(void, wraps, 1)),
            st.fabric(st.configurations(solid, wraps), (1.0,) * 3)[0],
        )  # fmt: skip

    def chord(self, phase: int) -> float:
        """Mean chord of the solid (0) or void (1); NaN without one."""
        counts = self.phases[phase].chords
        return float(counts @ np.arange(len(counts)) / counts.sum()) if counts.any() else math.nan


def differences(scan: Look, twin: Look) -> dict[str, float]:
    """Relative differences of a twin, with a sign where they are of numbers; of S2 the largest absolute one."""
    m = min(len(scan.pairs), len(twin.pairs))
    found = {"porosity": scan.share - twin.share, "S2": float(np.abs(scan.pairs[:m] - twin.pairs[:m]).max())}
    for number, phase in enumerate(("solid", "void")):
        found[f"chords.{phase}"] = twin.chord(number) / scan.chord(number) - 1
        found[f"thickness.{phase}"] = twin.balls[number].mean / scan.balls[number].mean - 1
    ratios = [look.fabric[0] / look.fabric[2] if look.fabric[2] > 0 else math.nan for look in (scan, twin)]
    found["fabric"] = ratios[1] / ratios[0] - 1
    return found


def distance(scan: Look, twin: Look, kinds: tuple[str, ...]) -> float:
    """Root of the mean square of what is to be matched; 1 stands for another structure altogether.

    S2 counts by the root mean square difference over its range, chords and thickness by the relative difference of
    their means and the area between their distribution functions, over the mean; fabric by that of intercepts.
    """
    parts: list[float] = []
    if "S2" in kinds:
        m = min(len(scan.pairs), len(twin.pairs))
        spread = scan.share * (1 - scan.share)
        parts.append(float(np.sqrt(np.mean((scan.pairs[:m] - twin.pairs[:m]) ** 2))) / spread)
    for number in range(2):
        if "chords" in kinds:
            sizes = [np.arange(len(look.phases[number].chords), dtype=float) for look in (scan, twin)]
            parts.append(_apart(sizes[0], scan.phases[number].chords, sizes[1], twin.phases[number].chords))
        if "thickness" in kinds:
            a, b = scan.balls[number], twin.balls[number]
            parts.append(_apart(a.sizes, a.shares, b.sizes, b.shares))
    if "fabric" in kinds:
        parts.append(float(np.linalg.norm(twin.fabric / twin.fabric.mean() - scan.fabric / scan.fabric.mean())))
    values = np.array(parts)
    return float(np.sqrt(np.mean(values**2))) if np.isfinite(values).all() else 1.0


def _apart(a: F64, weights_a: F64, b: F64, weights_b: F64) -> float:
    """The area between two distribution functions over the mean of the first (the distance of Wasserstein)."""
    if not weights_a.sum() or not weights_b.sum():
        return 1.0
    places = np.unique(np.concatenate([a, b]))
    below = [
        np.cumsum(w)[np.searchsorted(x, places, "right") - 1] * (places >= x[0]) / w.sum()
        for x, w in ((a, weights_a), (b, weights_b))
    ]
    area = float(np.sum(np.abs(below[0] - below[1])[:-1] * np.diff(places)))
    return area / float(a @ weights_a / weights_a.sum())
