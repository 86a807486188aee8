"""Summary numbers and warnings of a crush run."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from sppm_pipeline.features.crushing.compression import CrushedBody
    from sppm_pipeline.features.crushing.numerics.march import History, March

Table = tuple[tuple[float, float], ...]
"""Pairs of plastic strain and yield stress."""

SHARES = {
    "kinetic": (0.05, "is in motion: the plates are too fast; lower `rate`"),
    "hourglass": (0.10, "bends voxels rather than walls: raise `resolution`, walls want 4 voxels or more"),
    "contact": (0.05, "is stored in overlapping surfaces: raise `resolution`, or lower `rate`"),
    "damping": (0.10, "went into damping, which is numerical: lower `rate`"),
    "unbalanced": (0.02, "is missing from the balance: lower `rate`, and don't trust this run"),
}
"""Fractions of the work of the plates above which a run triggers a warning: heuristics. Each is an error of about as
much in the stress, so that a factor of two is one in the accuracy that passes without a word."""

ADDED_MASS, PLATES = 0.30, 0.05
"""Fraction of mass that may be added to crushed voxels, which slows waves by half as much, and by which the forces of
both plates may differ, twice the error of their mean: heuristics for errors as above."""


PLATEAU = (0.2, 0.4)
"""Strains between which the plateau stress is taken."""


def mean_stress(strain: NDArray[np.float64], stress: NDArray[np.float64], low: float, high: float) -> float:
    """Mean of the stress between two strains, of as many records as there are."""
    return float(stress[(strain >= low - 1e-9) & (strain <= high + 1e-9)].mean())


def numbers_of(history: History, march: March, area: float, rate: float, young: float) -> dict[str, Any]:
    """Summary numbers of a run, with its balance of energy."""
    end = float(history.strain[-1])
    stress = 0.5 * young / area * (history.top + history.bottom)
    later = history.strain >= min(0.05, end / 2)
    nx, ny, nz = march.body.shape
    difference = np.sqrt(np.mean((history.top - history.bottom)[later] ** 2))
    return {
        "plateau": mean_stress(history.strain, stress, *PLATEAU) if end >= PLATEAU[1] - 1e-9 else None,
        "work": float(history.work[-1] * young / (area * nz)),
        "relative_density": len(march.body.corners) / (nx * ny * nz),
        "rate": rate,
        **{name: round(float(share), 6) for name, share in march.shares().items()},
        "plates_differ": round(float(difference / max(np.abs(history.top[later]).mean(), 1e-300)), 6),
        "added_mass": round(march.added_mass, 6),
        **({"released": round(float(march.released.mean()), 6), "fragments": march.fragments()} if march.fails else {}),
    }


def is_quiet(numbers: Mapping[str, Any]) -> bool:
    """True if the balance of energy gives no reason for a lower rate."""
    shares = {name: SHARES[name][0] for name in ("kinetic", "damping", "unbalanced")} | {"plates_differ": PLATES}
    return all(abs(numbers[name]) <= most for name, most in shares.items())


def warnings_of(numbers: Mapping[str, Any], tables: tuple[Table, ...]) -> list[str]:
    """Warnings for a run whose numbers are doubtful."""
    if numbers["work"] <= 0:
        return ["the plates met no resistance"]
    found = [
        f"{abs(numbers[name]):.1%} of the work {what}" for name, (most, what) in SHARES.items()
        if abs(numbers[name]) > most
    ]  # fmt: skip
    if numbers["plates_differ"] > PLATES:
        found.append(f"the forces of both plates differ by {numbers['plates_differ']:.1%}: lower `rate`")
    if numbers["added_mass"] > ADDED_MASS:
        found.append(f"crushed voxels were given {numbers['added_mass']:.0%} more mass: lower `rate`, or end earlier")
    if any(b[1] < a[1] for table in tables for a, b in pairwise(table)):
        found.append("the solid softens: strain gathers in single voxels, so that the result depends on `resolution`")
    return found


def change_between(one: CrushedBody, other: CrushedBody, fails: bool) -> float:
    """Largest relative difference of plateau stress (of a short run, of its second half), highest stress, and work.

    If the solid fails, that of the highest stress alone: which piece breaks next depends on everything.
    """
    end = float(min(one.strain[-1], other.strain[-1]))
    found: list[tuple[float, ...]] = []
    for body in (one, other):
        highest = float(body.stress[body.strain <= PLATEAU[0]].max())
        if fails:
            found.append((highest,))
            continue
        level = mean_stress(body.strain, body.stress, min(PLATEAU[0], end / 2), min(PLATEAU[1], end))
        found.append((level, highest, float(np.interp(end, body.strain, body.energies["external"]))))
    return max((abs(after / before - 1) for before, after in zip(*found, strict=True) if before), default=0.0)
