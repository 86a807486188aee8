"""The effective stiffness of a periodic voxel cell, by six load cases."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.homogenization.elasticity.energy import ENERGY_ROWS, energies, energy_coefficients
from sppm_pipeline.numerics.homogenization.elasticity.levels import ElasticLevel, elastic_hierarchy
from sppm_pipeline.numerics.homogenization.multigrid.hierarchy import Hierarchy
from sppm_pipeline.numerics.homogenization.multigrid.load_cases import load_cases
from sppm_pipeline.numerics.homogenization.multigrid.pcg import Solved, Stop
from sppm_pipeline.numerics.homogenization.multigrid.rows import STRIDE
from sppm_pipeline.numerics.homogenization.stiffness.voigt import from_lame

_LAYERS = 8
"""Layers of voxels whose energies are summed in one go; a constant, so that sums do not depend on threads."""

_FLOOR = 1e-6
"""Stiffness over the mean of the voxels' stiffness below which no digits are asked for ..."""

_NOTHING = 1e-9
"""... and below which a direction is said to carry nothing."""


class Homogenized(NamedTuple):
    """Effective stiffness and how it was reached.

    Attributes
    ----------
    stiffness : (6, 6) float64
        Voigt order xx, yy, zz, yz, xz, xy, engineering shear strains; the unit of Young's modulus.
    solved : tuple of 6 Solved
        How the load cases went.
    precision : str
        In which it was solved in the end: double, if single precision did not do.
    """

    stiffness: NDArray[np.float64]
    solved: tuple[Solved, ...]
    precision: str


def lame(young: Any, poisson: Any) -> tuple[Any, Any]:
    """Lamé constants λ and μ from Young's modulus and Poisson's ratio, scalars or arrays."""
    return young * poisson / ((1 + poisson) * (1 - 2 * poisson)), young / (2 * (1 + poisson))


def stiffness(
    lam: NDArray[Any],
    mu: NDArray[Any],
    edges: tuple[float, float, float] = (1.0, 1.0, 1.0),
    *,
    residual: float = 0.0,
    tolerance: float = 1e-4,
    iterations: int = 500,
    precision: Any = np.float32,
    threads: int = 1,
) -> Homogenized:
    """Effective stiffness of a periodic cell of isotropic voxels, trilinear bricks with full integration.

    The displacement is that of a constant mean strain plus a periodic one. With the energies of the exact solutions
    the error of the stiffness is of second order in that of the displacements, so that single precision gives about
    six digits. Voids have no stiffness at all. Parts of the solid that hang on nothing move along freely.

    Parameters
    ----------
    lam, mu : (nz, ny, nx) float
        Lamé constants of the voxels; both 0 in the void, else ``mu > 0`` and ``3 lam + 2 mu > 0``.
    edges : (hx, hy, hz)
        Of a voxel, in any unit.
    residual : float
        A load case ends when its residual is this part of the right-hand side; 0 for never.
    tolerance : float
        ... or when the estimated error of the stiffness along its strain is this part of that stiffness; 0 for never.
    iterations : int
        ... or after so many iterations.
    precision : float32 or float64
        Of the vectors; scalar products are always summed in double precision.
    threads : int
        Load cases that are solved at the same time, each with memory of its own. The result does not depend on it.

    Raises
    ------
    ValueError
        If a stiffness is negative or not finite, or the shapes differ.
    ArithmeticError
        If the iteration fails in double precision, too.
    """
    dtype = np.dtype(precision)
    lam, mu = np.asarray(lam, dtype), np.asarray(mu, dtype)
    if lam.shape != mu.shape or lam.ndim != 3 or not lam.size:
        raise ValueError(f"Lamé constants need three equal axes, got {lam.shape} and {mu.shape}")
    if not (mu.min() >= 0 and (3 * lam + 2 * mu).min() >= 0 and np.isfinite(lam).all() and np.isfinite(mu).all()):
        raise ValueError("the stiffness of a voxel must be finite and not negative")
    if not mu.any():
        return Homogenized(np.zeros((6, 6)), (Solved(0, 0.0, 0.0, 0.0, True, True),) * 6, dtype.name)
    # numbers near 1, whatever the unit
    scale = float(mu.max())
    lam, mu = lam / dtype.type(scale), mu / dtype.type(scale)
    mean = from_lame(float(lam.mean(dtype=np.float64)), float(mu.mean(dtype=np.float64)))
    longest = max(edges)
    edges = (edges[0] / longest, edges[1] / longest, edges[2] / longest)

    def hierarchy(precision: np.dtype[Any], safe: bool) -> Hierarchy:
        return elastic_hierarchy(lam, mu, edges, precision, safe=safe)

    stop = Stop(residual, tolerance, iterations)
    matrix, solved, reached = load_cases(hierarchy, _energies, np.diag(mean), stop, _FLOOR, dtype, threads)
    void = np.diag(matrix) < _NOTHING * np.diag(mean)
    matrix[void] = 0
    matrix[:, void] = 0
    return Homogenized(matrix * scale, solved, reached)


def _energies(hierarchy: Hierarchy, fields: NDArray[Any], threads: int) -> NDArray[np.float64]:
    level = hierarchy.levels[0]
    assert isinstance(level, ElasticLevel)
    nz, ny, nx = level.shape
    root = np.sqrt(np.prod(level.edges))
    c = energy_coefficients(level.edges).astype(fields.dtype)
    strains = (np.eye(6) * root).astype(fields.dtype)

    def layers(first: int) -> NDArray[np.float64]:
        out = np.zeros((6, 6))
        scratch = np.zeros(ENERGY_ROWS * STRIDE, fields.dtype)
        last = min(first + _LAYERS, nz)
        energies(fields, level.lam, level.mu, c, strains, level.size, first, last, scratch, out)
        return out

    with ThreadPoolExecutor(threads) as pool:
        parts = list(pool.map(layers, range(0, nz, _LAYERS)))
    total = np.zeros((6, 6))
    for part in parts:
        total += part
    total /= nz * ny * nx * float(np.prod(level.edges))
    return total
