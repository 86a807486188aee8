"""Residual periodicity: how much of an assembled image still repeats from cell to cell, and where in the cell."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sppm_pipeline.services.arrays import F64


class AxisCorrelation(NamedTuple):
    """Mean correlation coefficient, -1..1, of a cell and the next one along each axis, and over the axes.

    NaN where there is no pair of cells with contrast; `mean` is over the axes that have pairs.
    """

    x: float
    y: float
    z: float
    mean: float


class Folded(NamedTuple):
    """Solid share of the mean cell at the places of the lattice; without a lattice all agree within the deviation."""

    corner: float  # mean within a sixteenth of the cell size, `NEAR`
    edge: float  # over the middle half of the length
    face: float  # over the middle half in both directions
    center: float  # over the middle half of the cell in all three
    deviation: float  # standard deviation of the mean cell over its voxels
    expected: float  # deviation that the mean of as many independent cells would have


NEAR = 1 / 16
"""Distance from a corner, edge or face within which voxels count as lying on it, cell sizes: half a pore's radius."""


def _blocks(image: ArrayLike, cells: tuple[int, int, int]) -> NDArray[np.generic]:
    """View of an image as (cx, nx, cy, ny, cz, nz), cells and voxels inside them."""
    voxels = np.asarray(image)
    (nx, ny, nz), (cx, cy, cz) = voxels.shape, cells
    return voxels.reshape(cx, nx // cx, cy, ny // cy, cz, nz // cz)


class _Statistics(NamedTuple):
    mean_cell: F64  # (nx, ny, nz)
    means: F64  # (cx, cy, cz), mean of each cell
    variances: F64  # (cx, cy, cz), variance inside each cell


def _statistics(blocks: NDArray[np.generic]) -> _Statistics:
    # Cell by cell, so that no float copy of a large boolean image is made.
    cells = blocks.shape[::2]
    mean = np.zeros(blocks.shape[1::2])
    means, variances = np.empty(cells), np.empty(cells)
    for place in np.ndindex(*cells):
        cell = blocks[place[0], :, place[1], :, place[2], :].astype(np.float64)
        mean += cell
        means[place], variances[place] = cell.mean(), cell.var()
    return _Statistics(mean / means.size, means, variances)


def mean_cell(image: ArrayLike, cells: tuple[int, int, int]) -> F64:
    """Average (nx, ny, nz) of all cells of an image (cx nx, cy ny, cz nz), voxel by voxel."""
    return _statistics(_blocks(image, cells)).mean_cell


def folded_shares(image: ArrayLike, cells: tuple[int, int, int]) -> Folded:
    """Fold an image, 1 where it is solid, onto one of its (cx, cy, cz) cells, and compare the lattice places."""
    statistics = _statistics(_blocks(image, cells))
    mean = statistics.mean_cell
    near = [_overlap(n, (0.0, NEAR), (1.0 - NEAR, 1.0)) for n in mean.shape]
    middle = [_overlap(n, (0.25, 0.75)) for n in mean.shape]

    def share(*along: bool) -> float:
        """Mean over the middle half of the axes that are true, and near the lattice along the others."""
        x, y, z = (m if inside else b for inside, m, b in zip(along, middle, near, strict=True))
        # weights along the axes, as voxels may lie half in a span
        return float(np.einsum("ijk,i,j,k", mean, x, y, z))

    edges = share(True, False, False), share(False, True, False), share(False, False, True)
    faces = share(False, True, True), share(True, False, True), share(True, True, False)
    return Folded(
        corner=share(False, False, False),
        edge=sum(edges) / 3,
        face=sum(faces) / 3,
        center=share(True, True, True),
        deviation=float(mean.std()),
        # voxels of independent cells vary about their own cell's mean as much as within it
        expected=float(np.sqrt(statistics.variances.mean() / statistics.variances.size)),
    )


def _overlap(n: int, *spans: tuple[float, float]) -> F64:
    """Weight of each of n voxels along an axis by its overlap with spans of 0..1; the sum is 1."""
    low = np.arange(n) / n
    weight = sum(np.clip(np.minimum(low + 1 / n, end) - np.maximum(low, start), 0.0, None) for start, end in spans)
    return np.asarray(weight / np.sum(weight))


def bragg_share(image: ArrayLike, cells: tuple[int, int, int], *, corrected: bool = True) -> float:
    """Fraction of the variance of an image that repeats from cell to cell: 0 for a random structure, 1 for a crystal.

    The raw fraction is the variance of the mean cell over the variance of the image. By Parseval's theorem it is *the
    same number* as the power of the image at the points of the reciprocal lattice (the Bragg peaks, frequency zero left
    out) over its power at all frequencies but zero, so no Fourier transform is needed.

    Even of M independent cells the raw fraction is about 1/M, since their average keeps a remainder. The corrected
    fraction replaces the variance of the mean cell, which is the mean covariance of all M^2 pairs of cells, by the mean
    over the pairs of *different* cells. Its expectation is zero for independent cells, so single values may fall below
    zero. NaN for an image without contrast.
    """
    blocks = _blocks(image, cells)
    count = cells[0] * cells[1] * cells[2]
    statistics = _statistics(blocks)
    # law of total variance: within cells and between them
    total = float(statistics.variances.mean() + statistics.means.var())
    if total == 0.0:
        return float("nan")
    repeating = float(statistics.mean_cell.var())
    if corrected:
        within = float(statistics.variances.sum())
        # count^2 times the variance of the mean cell is the sum of all covariances; those of a cell with itself go
        repeating = (count * count * repeating - within) / (count * (count - 1))
    return repeating / total


def axis_correlation(image: ArrayLike, cells: tuple[int, int, int]) -> AxisCorrelation:
    """Mean correlation coefficient between a cell and its neighbor one cell further along x, y and z.

    Cells without contrast (all void or all solid) have no coefficient and are left out.
    """
    blocks = _blocks(image, cells)
    _, means, variances = _statistics(blocks)
    deviations = np.sqrt(variances)
    found = []
    for axis in range(3):
        coefficients = []
        for place in np.ndindex(*(n - (a == axis) for a, n in enumerate(cells))):
            beyond = tuple(p + (a == axis) for a, p in enumerate(place))
            spread = deviations[place] * deviations[beyond]
            if spread > 0.0:
                here = blocks[place[0], :, place[1], :, place[2], :].astype(np.float64)
                there = blocks[beyond[0], :, beyond[1], :, beyond[2], :].astype(np.float64)
                coefficients.append(((here * there).mean() - means[place] * means[beyond]) / spread)
        found.append(float(np.mean(coefficients)) if coefficients else float("nan"))
    known = [value for value in found if value == value]
    return AxisCorrelation(found[0], found[1], found[2], float(np.mean(known)) if known else float("nan"))
