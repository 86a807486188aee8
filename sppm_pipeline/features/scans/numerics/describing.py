"""All statistics of an image together, with error bars from its blocks."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from sppm_pipeline.features.scans.numerics import statistics as st
from sppm_pipeline.numerics import find_components, paint_runs
from sppm_pipeline.services.arrays import F64, I64, Bools
from sppm_pipeline.services.local_thickness import limit_sizes, local_thickness, painted_balls, squared_distance

MAX_BALLS = 128
"""Voxels along the longest side of the image in which balls are painted; finer ones are halved until they have less.
The means are those in the limit of fine grids."""


class Phase(NamedTuple):
    """Curves and numbers of a phase; lengths are in voxels."""

    pairs: F64  # curves (m + 1,) over distances from 0 on, means of the axes
    cluster: F64
    path: F64
    chords: F64  # numbers by length (n + 1,), of all axes
    mean_chords: F64  # along x, y, z; NaN where no chord is whole
    connected: float  # share of the largest connected part


def curves_of(phase: Bools, distances: int, wraps: bool) -> Phase:
    """Curves of a phase (x, y, z) along the axes."""
    found = find_components(phase.T, (wraps,) * 3)
    labels = np.zeros(phase.T.shape, np.int32)
    paint_runs(found.runs.rows, found.runs.bounds, found.of_run + 1, labels)
    lines = [st.along_axis(labels, axis, min(distances, n - 1), wraps) for axis, n in enumerate(phase.shape)]
    pairs, cluster, path = (_mean([getattr(line, name) for line in lines]) for name in ("pairs", "cluster", "path"))
    longest = max(len(line.chords) for line in lines)
    chords = sum(np.pad(line.chords, (0, longest - len(line.chords))) for line in lines)
    lengths = [float(line.chords @ np.arange(len(line.chords))) / max(line.chords.sum(), 1e-300) for line in lines]
    whole = np.array([length if line.chords.any() else np.nan for length, line in zip(lengths, lines, strict=True)])
    largest = float(found.sizes[0]) / float(found.sizes.sum()) if len(found.sizes) else 0.0
    return Phase(pairs, cluster, path, np.asarray(chords), whole, largest)


def _mean(curves: list[F64]) -> F64:
    """The mean of curves, as far as all of them reach."""
    length = min(map(len, curves))
    return np.asarray(np.mean([curve[:length] for curve in curves], axis=0))


class Balls(NamedTuple):
    """Local thickness of a phase, in voxels of the image."""

    mean: float  # in the limit of fine grids
    deviation: float  # over the volume
    sizes: F64  # histogram by volume (m,), moved to that limit
    shares: F64
    error: float  # of the mean, over blocks


def balls_of(phase: Bools, wraps: bool, parts: int) -> Balls:
    """Local thickness of a phase (x, y, z)."""
    fine, voxel = phase, 1
    while max(fine.shape) > MAX_BALLS:
        fine, voxel = _halved(fine), 2 * voxel
    thickness = local_thickness(np.ascontiguousarray(fine.T).view(np.uint8), (wraps,) * 3).T
    half = _halved(fine) if min(fine.shape) >= 8 else fine[:0]
    coarse = local_thickness(np.ascontiguousarray(half.T).view(np.uint8), (wraps,) * 3)
    inside = thickness[thickness > 0]
    if not len(inside):
        return Balls(math.nan, math.nan, np.zeros(1), np.zeros(1), math.nan)
    mean = float(inside.mean(dtype=np.float64)) * voxel
    limit = limit_sizes(thickness, coarse, (float(voxel), 2.0 * voxel)).mean if coarse.any() else mean
    sizes, counts = np.unique(inside, return_counts=True)
    blocks = [thickness[block] for block in st.blocks_of(fine.shape, parts)]
    means = [float(block[block > 0].mean(dtype=np.float64)) for block in blocks if (block > 0).any()]
    return Balls(
        limit, float(inside.std(dtype=np.float64)) * voxel, np.maximum(sizes * voxel + limit - mean, 0),
        counts / counts.sum(), voxel * _error(means),
    )  # fmt: skip


def _halved(phase: Bools) -> Bools:
    """Blocks of 2 x 2 x 2 voxels as one, of the phase that half or more of it has; an odd last layer is left out."""
    nx, ny, nz = (n // 2 for n in phase.shape)
    voxels = phase[: 2 * nx, : 2 * ny, : 2 * nz].T.view(np.uint8)
    count = sum(voxels[k::2, j::2, i::2] for i, j, k in np.ndindex(2, 2, 2))
    # half full blocks by turns, so that neither phase gains
    turn = (np.arange(nz)[:, None, None] + np.arange(ny)[:, None] + np.arange(nx)) % 2
    return np.asarray((count > 4) | ((count == 4) & (turn == 1))).T


def entry_of(void: Bools) -> tuple[float, float, float]:
    """Diameters, in voxels, of balls that come from the sides into 90, 50 and 10 % of the void."""
    fine, voxel = void, 1
    while max(fine.shape) > MAX_BALLS:
        fine, voxel = _halved(fine), 2 * voxel
    squared = squared_distance(np.ascontiguousarray(fine.T).view(np.uint8), (False,) * 3)
    if not fine.any() or fine.all():
        return (math.nan,) * 3
    sizes = painted_balls(st.entry_sizes(squared), (False,) * 3).T[fine]
    low, middle, high = (float(np.quantile(sizes, share)) * voxel for share in (0.1, 0.5, 0.9))
    return low, middle, high


def _error(values: Any) -> float:
    """Standard error of a mean; NaN of less than two values."""
    found = np.asarray(values, np.float64)
    return float(found.std(ddof=1) / math.sqrt(len(found))) if len(found) > 1 else math.nan


class Described(NamedTuple):
    """Statistics of an image and of its phases "solid" and "void", lengths in voxels."""

    bars: dict[str, tuple[float, float]]  # values and standard errors of the numbers, and of "solid.chords" ...
    phases: dict[str, tuple[Phase, list[F64]]]  # curves, and errors of `pairs`, `cluster`, `path`
    radial: dict[str, tuple[F64, F64]]  # distances, and S2 over all directions
    fabric: tuple[F64, F64]  # lengths, in the unit of the spacing, and axes


def described(solid: Bools, spacing: tuple[float, float, float], wraps: bool, distances: int, parts: int) -> Described:
    """Describe an image (x, y, z); with `parts` of 1 there are no error bars."""
    blocks = st.blocks_of(solid.shape, parts) if parts > 1 else []
    own = [_numbers(solid[block], st.configurations(solid[block], False), spacing) for block in blocks]
    patterns = st.configurations(solid, wraps)
    numbers = _numbers(solid, patterns, spacing)
    bars = {name: (value, _error([one[name] for one in own])) for name, value in numbers.items()}
    phases = {}
    at, both, rest = st.radial_pairs(solid, distances, wraps)
    for name, phase in (("solid", solid), ("void", ~solid)):
        whole = curves_of(phase, distances, wraps)
        near = min(distances, min(solid.shape) // (2 * parts))
        pieces = [curves_of(phase[block], near, False) for block in blocks]
        errors = [_bars([getattr(piece, kind) for piece in pieces], len(whole.pairs))
                  for kind in ("pairs", "cluster", "path")]  # fmt: skip
        phases[name] = (whole, errors)
        # the mean over the axes hides what only some of the directions have no whole chord of
        bars[f"{name}.chords"] = (
            float(np.nanmean(whole.mean_chords)) if np.isfinite(whole.mean_chords).any() else math.nan,
            _error([np.nanmean(p.mean_chords) for p in pieces if np.isfinite(p.mean_chords).any()]),
        )
    return Described(bars, phases, {"solid": (at, both), "void": (at, rest)}, st.fabric(patterns, spacing))


def _numbers(solid: Bools, patterns: I64, spacing: tuple[float, float, float]) -> dict[str, float]:
    numbers = st.minkowski(patterns, spacing)
    return {"porosity": 1 - float(solid.mean()), **numbers._asdict()}


def _bars(curves: list[F64], length: int) -> F64:
    """Standard errors of a curve of so many distances; NaN beyond those of the blocks."""
    out = np.full(length, np.nan)
    if len(curves) > 1:
        near = min(map(len, curves))
        out[:near] = np.std([curve[:near] for curve in curves], axis=0, ddof=1) / math.sqrt(len(curves))
    return out
