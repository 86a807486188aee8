"""Corrections of what a test machine writes: its own compliance, preload, the toe where specimen and plates settle."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sppm_pipeline.features.crushing.numerics.compression import Steepest, first_maximum, loading, steepest_window

Array = NDArray[np.float64]


class Blank(NamedTuple):
    """Deflection (n,) of a machine without a specimen over force (n,); neither ever falls, 0 at the smallest force."""

    force: Array
    displacement: Array


def blank_run(force: ArrayLike, displacement: ArrayLike) -> Blank:
    """Monotone curve of least squares through a run without a specimen, loading and unloading taken together."""
    from scipy.optimize import isotonic_regression

    f, d = np.asarray(force, np.float64), np.asarray(displacement, np.float64)
    known, of = np.unique(f, return_inverse=True)
    if len(known) < 2:
        raise ValueError("a run without a specimen needs two or more different forces")
    count = np.bincount(of)
    # isotonic: loading and unloading differ, and readings scatter, but no larger force deflects the machine less
    fitted: Array = isotonic_regression(np.bincount(of, d) / count, weights=count).x
    return Blank(known, fitted - fitted[0])


def without_blank(force: ArrayLike, displacement: ArrayLike, blank: Blank) -> Array:
    """Displacement of the specimen alone; `ValueError` if its forces exceed those of the run without a specimen."""
    f = np.asarray(force, np.float64)
    if f.max() > blank.force[-1]:
        raise ValueError(
            f"the run without a specimen ends at {blank.force[-1]:.4g} N, and the test goes to {f.max():.4g} N"
        )
    return np.asarray(displacement, np.float64) - np.interp(f, blank.force, blank.displacement)


def after_preload(force: ArrayLike, displacement: ArrayLike, preload: float) -> tuple[Array, Array]:
    """Readings from the first force of `preload` on, where displacement becomes zero; `ValueError` without any."""
    f, d = np.asarray(force, np.float64), np.asarray(displacement, np.float64)
    reached = np.flatnonzero(f >= preload)
    if not len(reached):
        raise ValueError(f"the force of the test ends at {f.max():.4g} N, before the preload of {preload:g} N")
    start = int(reached[0])
    return f[start:], d[start:] - d[start]


def without_toe(strain: ArrayLike, stress: ArrayLike, within: float = 0.2) -> tuple[Array, Array, Steepest]:
    """A curve whose strain is zero where the line through its steepest window has no stress, from there on, and that
    line before the shift; `ValueError` if the stress does not rise up to the strain `within`.

    The readings before the window, where specimen and plates settle, are replaced by that line (annex of ASTM D695,
    ASTM D1621, ISO 844). The window is looked for before the first maximum, or up to the strain `within`.
    """
    e, s = np.asarray(strain, np.float64), np.asarray(stress, np.float64)
    curve = loading(e, s)
    peak = first_maximum(curve, within)
    line = steepest_window(curve, within if peak is None else min(peak, within))
    if line is None:
        raise ValueError(f"the stress does not rise up to a strain of {within:g}")
    kept = int(np.argmax(e >= max(line.first, line.root)))
    return np.concatenate([[0.0], e[kept:] - line.root]), np.concatenate([[0.0], s[kept:]]), line


def turned(load: ArrayLike, way: ArrayLike) -> tuple[Array, Array, tuple[bool, bool]]:
    """Load and way with signs such that compression is positive, and which of them were negative."""
    f, d = np.asarray(load, np.float64), np.asarray(way, np.float64)
    # the load is positive where it is largest, and the way has grown by then
    peak = int(np.argmax(np.abs(f)))
    negative = bool(f[peak] < 0), bool(d[peak] < d[0])
    return -f if negative[0] else f, -d if negative[1] else d, negative


def goes_back(way: ArrayLike, by: float, until: float = np.inf) -> float | None:
    """Way from which a test goes back by more than `by` before it goes on, up to `until`; None if it does not."""
    d = np.asarray(way, np.float64)
    farthest = np.maximum.accumulate(d)
    last = int(np.argmax(farthest >= min(until, farthest[-1])))
    back = farthest[: last + 1] - d[: last + 1] > by
    return float(farthest[int(np.argmax(back))]) if back.any() else None


def count_up_to(strain: ArrayLike, limit: float) -> int:
    """Readings up to the largest strain, or to the first beyond a limit."""
    e = np.asarray(strain, np.float64)
    return int(np.argmax(e > limit)) if e.max() > limit else int(np.argmax(e)) + 1
