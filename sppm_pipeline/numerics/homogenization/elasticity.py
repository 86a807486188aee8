"""The effective stiffness of a periodic voxel cell, by six load cases."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.homogenization.elastic_energy import ENERGY_ROWS, energies, energy_coefficients
from sppm_pipeline.numerics.homogenization.elastic_operator import SCRATCH_ROWS, apply_stiffness
from sppm_pipeline.numerics.homogenization.multigrid.hierarchy import Hierarchy, Workspace, coarser, node_sums, padded
from sppm_pipeline.numerics.homogenization.multigrid.rows import APPLY, HEAD, STRIDE
from sppm_pipeline.numerics.homogenization.multigrid.solver import Solved, Stop, load_cases
from sppm_pipeline.numerics.homogenization.multigrid.transfer import coarsened, coarser_widths, shortness
from sppm_pipeline.numerics.homogenization.multigrid.vectors import dot
from sppm_pipeline.numerics.homogenization.stiffness.voigt import from_lame

_LAYERS = 8
"""Layers of voxels whose energies are summed at once; a constant, so that sums do not depend on threads."""

_FLOOR = 1e-6
"""Stiffness over the mean of the voxels' stiffness below which no accuracy is requested ..."""

_NO_LOAD_PATH = 1e-9
"""... and below which a direction has no load path."""


class Homogenized(NamedTuple):
    """Effective stiffness and how it was computed.

    Attributes
    ----------
    stiffness : (6, 6) float64
        Voigt order xx, yy, zz, yz, xz, xy, engineering shear strains; the unit of Young's modulus.
    solved : tuple of 6 Solved
        Iterations, residual and error of each load case.
    precision : str
        Of the final solution: double, if single precision was not enough.
    expansion : (6,) float64 or None
        Strain that a free cell takes on for each kelvin, engineering shear; NaN for strains without a load path. None
        if no expansion was given.
    """

    stiffness: NDArray[np.float64]
    solved: tuple[Solved, ...]
    precision: str
    expansion: NDArray[np.float64] | None = None


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
    expansion: NDArray[Any] | None = None,
) -> Homogenized:
    """Effective stiffness of a periodic cell of isotropic voxels, trilinear bricks with full integration.

    The displacement is that of a constant mean strain plus a periodic one. With the energies of the exact solutions
    the error of the stiffness is of second order in that of the displacements, so that single precision gives about
    six digits. Voids have no stiffness at all. Disconnected parts of the solid move freely and carry no load.

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
    expansion : (nz, ny, nx) float, optional
        Coefficients of thermal expansion of the voxels; what it is in the void does not matter.

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
        nothing = None if expansion is None else np.full(6, np.nan)
        return Homogenized(np.zeros((6, 6)), (Solved(0, 0.0, 0.0, 0.0, True, True),) * 6, dtype.name, nothing)
    # numbers near 1, whatever the unit
    scale = float(mu.max())
    lam, mu = lam / dtype.type(scale), mu / dtype.type(scale)
    mean = from_lame(float(lam.mean(dtype=np.float64)), float(mu.mean(dtype=np.float64)))
    longest = max(edges)
    edges = (edges[0] / longest, edges[1] / longest, edges[2] / longest)

    def hierarchy(precision: np.dtype[Any], safe: bool) -> Hierarchy:
        return elastic_hierarchy(lam, mu, edges, precision, safe=safe)

    stresses: list[NDArray[np.float64]] = []

    def mutual(hierarchy: Hierarchy, fields: NDArray[Any], threads: int) -> NDArray[np.float64]:
        if expansion is not None:
            stresses[:] = _mean_stresses(hierarchy, fields, expansion, mean)
        return _energies(hierarchy, fields, threads)

    stop = Stop(residual, tolerance, iterations)
    matrix, solved, reached = load_cases(hierarchy, mutual, np.diag(mean), stop, _FLOOR, dtype, threads)
    void = np.diag(matrix) < _NO_LOAD_PATH * np.diag(mean)
    matrix[void] = 0
    matrix[:, void] = 0
    if expansion is None:
        return Homogenized(matrix * scale, solved, reached)
    held, heat = stresses
    strains = np.full(6, np.nan)
    strains[~void] = np.linalg.lstsq(held[np.ix_(~void, ~void)], heat[~void], rcond=1e-9)[0]
    return Homogenized(matrix * scale, solved, reached, strains)


def _mean_stresses(
    hierarchy: Hierarchy, fields: NDArray[Any], expansion: NDArray[Any], mean: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean stresses of the load cases, a row for each, and those of a held cell for a kelvin; (6, 6) and (6,).

    In the load case of a strain the mean of ``strain : C : alpha`` over the cell is the stress that a held cell answers
    a kelvin with (Rosen and Hashin 1970), and only the constant part of a brick's strain enters. Mean stresses are
    computed by the same linear functionals, not by energies, so that the relations of Levin (1967) between the two
    hold whatever the error of the displacements.
    """
    level = hierarchy.levels[0]
    assert isinstance(level, ElasticLevel)
    work, volume = hierarchy.workspace(), level.weight.size * float(np.prod(level.edges))
    held, heat = mean.copy(), np.zeros(6)
    force = np.empty_like(fields[0])
    for case, strain in enumerate(np.eye(6)):
        level.forces(strain, force, work)
        held[:, case] += [dot(force, field) / volume for field in fields]
    # for a kelvin, the stress is alike along all axes
    stress = level.bulk(expansion)
    heat[:3] = stress.mean(dtype=np.float64)
    level.pressure_forces(stress, force)
    heat += [dot(force, field) / volume for field in fields]
    return held, heat


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


def coefficients(edges: tuple[float, float, float], strain: NDArray[np.float64] | None = None) -> NDArray[np.float64]:
    """Weights of the modes of a brick for `apply_stiffness`, (24,).

    Parameters
    ----------
    edges : (hx, hy, hz)
        Of a voxel.
    strain : (6,), optional
        A constant strain xx, yy, zz, yz, xz, xy (engineering shear) that is added to that of the displacements.
    """
    h = np.array(edges, np.float64)
    volume = h.prod()
    # from sums over corners to strains times the root of the volume
    g = np.sqrt(volume) / (4 * h)
    q = g * g
    linear = [(2 * q[a] + q[b]) / 3 for a, b in ((0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1))]
    constant = np.zeros(6) if strain is None else np.sqrt(volume) * strain
    return np.concatenate([g, linear, q / 9, (q + q.sum()) / 9, g / 3, constant])


class ElasticLevel:
    """One grid of an elastic body; see `multigrid.hierarchy.Level`.

    Parameters
    ----------
    lam, mu : (nz, ny, nx) float
        Lamé constants of the voxels.
    edges : (hx, hy, hz)
    dtype : float32 or float64
    """

    components = 3

    def __init__(self, lam: NDArray[Any], mu: NDArray[Any], edges: tuple[float, float, float], dtype: Any) -> None:
        nz, ny, nx = lam.shape
        self.shape = (nz, ny, nx)
        self.edges = edges
        self.lam, self.mu = padded(lam, dtype), padded(mu, dtype)
        c = coefficients(edges)
        self.c = c.astype(dtype)
        self.size = np.array([nx, ny, nz], np.int64)
        # the mean over x, y, z of the diagonal of a brick: 16/9 for the weights 1, 1/3, 1/3, 1/9
        self.diagonal = node_sums((16 / 27 * float(c[:3] @ c[:3])) * (lam + 4 * mu)).reshape(-1)
        self.weight = np.zeros(nx * ny * nz, dtype)

    def apply(self, mode: int, v: NDArray[Any], r: NDArray[Any], out: NDArray[Any], work: Workspace) -> float:
        """See `elastic_operator.apply_stiffness`."""
        return apply_stiffness(
            mode, v, r, self.weight, self.lam, self.mu, self.c, self.size, out, work.plane, work.rows
        )

    def forces(self, strain: NDArray[np.float64], out: NDArray[Any], work: Workspace) -> None:
        """Nodal forces of a constant strain (6,), written to `out`."""
        c = coefficients(self.edges, strain).astype(self.c.dtype)
        zero = np.zeros_like(out)
        apply_stiffness(APPLY, zero, zero, self.weight, self.lam, self.mu, c, self.size, out, work.plane, work.rows)

    def bulk(self, expansion: NDArray[Any]) -> NDArray[Any]:
        """Stress along each axis that holds voxels (nz, ny, nx) of some expansion back: three bulk moduli of it."""
        nz, ny, nx = self.shape
        lam, mu = (c.reshape(nz, ny, -1)[:, :, HEAD : HEAD + nx] for c in (self.lam, self.mu))
        return np.asarray((3 * lam + 2 * mu) * expansion.astype(lam.dtype))

    def pressure_forces(self, stress: NDArray[Any], out: NDArray[Any]) -> None:
        """Nodal forces of an equal stress along all axes in each voxel (nz, ny, nx), written to `out`."""
        volume = np.prod(self.edges)
        forces = out.reshape(3, *self.shape)
        for d in range(3):
            around = stress
            for axis in range(3):
                if axis != 2 - d:
                    around = around + np.roll(around, 1, axis)
            forces[d] = (np.roll(around, 1, 2 - d) - around) * out.dtype.type(volume / (4 * self.edges[d]))

    def rounding(self) -> float:
        """Rounding error to expect in the forces of a homogeneous body."""
        largest = float(np.abs(self.c[:3]).max()) * float(self.lam.max() + 2 * self.mu.max())
        return 8 * float(np.finfo(self.c.dtype).eps) * largest * float(np.sqrt(np.prod(self.edges)))


def safe_eigenvalue(lam: NDArray[Any], mu: NDArray[Any], edges: tuple[float, float, float]) -> float:
    """A bound of the eigenvalues of the stiffness over its diagonal: the largest of a single brick."""
    h = np.array(edges)
    solid = mu > 0
    ratios = lam[solid] / mu[solid]
    q = 1 / h**2
    largest = 0.0
    for ratio in (float(ratios.min()), float(ratios.max())):
        # constant strains are the stiffest modes
        normal, shear = max(0.0, ratio) * q.sum() + 2 * q.max(), np.sort(q)[1:].sum()
        largest = max(largest, 8 * max(normal, shear) / (16 / 27 * q.sum() * (ratio + 4)))
    return float(largest)


def elastic_hierarchy(
    lam: NDArray[Any], mu: NDArray[Any], edges: tuple[float, float, float], dtype: Any, *, safe: bool = False
) -> Hierarchy:
    """All grids of a periodic body.

    Coarse grids have the mean Lamé constants of eight voxels. That is stiffer than Galerkin's
    operator, but cheap, and conjugate gradients make up for it.

    Parameters
    ----------
    lam, mu : (nz, ny, nx)
        Lamé constants of the voxels; both 0 in the void.
    edges : (hx, hy, hz)
    dtype : float32 or float64
        Precision of all vectors.
    safe : bool
        Damp the smoother by a bound of the eigenvalues instead of an estimate.
    """
    bound = safe_eigenvalue(lam, mu, edges)
    levels = [ElasticLevel(lam, mu, edges, dtype)]
    widths = [np.ones(n) for n in lam.shape]
    while coarser(levels[-1].shape) is not None:
        doubled = [h * (2 if n > 1 else 1) for h, n in zip(edges, lam.shape[::-1], strict=True)]
        edges = (doubled[0], doubled[1], doubled[2])
        lam, mu, widths = coarsened(lam), coarsened(mu), coarser_widths(widths)
        stiffer = shortness(widths).astype(lam.dtype)
        levels.append(ElasticLevel(lam * stiffer, mu * stiffer, edges, dtype))
        bound = max(bound, safe_eigenvalue(lam, mu, edges))
    return Hierarchy.of(list(levels), SCRATCH_ROWS, bound if safe else 0.0)
