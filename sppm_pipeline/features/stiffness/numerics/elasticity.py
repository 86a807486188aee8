"""Effective stiffness of a periodic voxel cell, from six load cases."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.arrays import F64, I16
from sppm_pipeline.services.elastic.elastic_level import ElasticLevel, Moduli, grids_of
from sppm_pipeline.services.elastic.voigt import from_lame
from sppm_pipeline.services.multigrid.hierarchy import Hierarchy, Workspace
from sppm_pipeline.services.multigrid.solver import Solved, Stop, load_cases
from sppm_pipeline.services.multigrid.vectors import dot, pack

_FLOOR = 1e-6
"""Stiffness, over the mean of the voxels, below which no accuracy is requested: single precision has about six
digits."""

NO_LOAD_PATH = 1e-9
"""Stiffness, over the mean of the voxels, below which a direction counts as having no load path."""

_FIRST_ORDER = 0.01
"""Part of the tolerance with expansion, whose error is of first order in that of the displacements; measured on layers
and random blobs, it then keeps to the tolerance, too, or to twice as much."""

_NESTED = 3
"""Iterations on each coarser grid, whose solution is the start on the next one. Other numbers were not measured; each
iteration on the first of them costs about an eighth of one on the finest grid."""


class Homogenized(NamedTuple):
    """Effective stiffness and how it was computed."""

    stiffness: F64  # (6, 6), Voigt order xx, yy, zz, yz, xz, xy, engineering shear; the unit of Young's modulus
    solved: tuple[Solved, ...]  # of each load case
    precision: str  # of the final solution: double, if single precision was not enough
    # (6,), strain of a free cell per kelvin, engineering shear; NaN for strains without a load path
    expansion: F64 | None = None
    # periodic displacements (3 nz ny nx,) of each load case in steps of a float, if they were requested
    fields: tuple[tuple[I16, float], ...] = ()


def stiffness(
    lam: NDArray[Any], mu: NDArray[Any], edges: tuple[float, float, float] = (1.0, 1.0, 1.0), *, residual: float = 0.0,
    tolerance: float = 1e-4, iterations: int = 500, precision: Any = np.float32, threads: int = 1,
    expansion: NDArray[Any] | None = None,
) -> Homogenized:  # fmt: skip
    """Effective stiffness of a periodic cell of isotropic voxels, trilinear bricks with full integration.

    The displacement is that of a constant mean strain plus a periodic one. With the energies of the exact solutions
    the error of the stiffness is of second order in that of the displacements, so that single precision gives about
    six digits. Voids have no stiffness at all. Disconnected parts of the solid move freely and carry no load.

    Parameters
    ----------
    lam, mu : (nz, ny, nx) float
        Lamé constants of the voxels; both 0 in the void, else ``mu > 0`` and ``3 lam + 2 mu > 0``.
    edges : (hx, hy, hz)
        Edge lengths of a voxel, in any unit.
    residual : float
        A load case ends when its relative residual is at most this; 0 for never.
    tolerance : float
        ... or when the estimated relative error of the stiffness along its strain is; 0 for never.
    iterations : int
        ... or after so many iterations.
    precision : float32 or float64
        Precision of the vectors; scalar products are always summed in double precision.
    threads : int
        Load cases that are solved at the same time, each with memory of its own. The result does not depend on it.
    expansion : (nz, ny, nx) float, optional
        Coefficients of thermal expansion of the voxels; ignored in the void.

    Raises
    ------
    ValueError
        If a stiffness is negative or not finite, or the shapes differ.
    ArithmeticError
        If the iteration fails in double precision, too.
    """
    body = ElasticBody.of(lam, mu, edges, precision)
    del lam, mu
    return body.stiffness(
        residual=residual, tolerance=tolerance, iterations=iterations, threads=threads, expansion=expansion
    )


class ElasticBody(NamedTuple):
    """Periodic cell in the form that is solved; the arrays of Lamé constants may be freed."""

    finest: ElasticLevel | None  # its grid, Lamé constants divided by `scale`; None if all of it is void
    mean: F64  # (6, 6), mean stiffness of the voxels, divided by `scale`
    scale: float  # the largest shear modulus, so that numbers are near 1 in any unit
    dtype: np.dtype[Any]  # of the vectors

    @classmethod
    def of(
        cls, lam: NDArray[Any], mu: NDArray[Any], edges: tuple[float, float, float] = (1.0, 1.0, 1.0),
        precision: Any = np.float32,
    ) -> ElasticBody:  # fmt: skip
        """Create from Lamé constants; parameters and errors as for `stiffness`."""
        dtype = np.dtype(precision)
        lam, mu = np.asarray(lam, dtype), np.asarray(mu, dtype)
        if lam.shape != mu.shape or lam.ndim != 3 or not lam.size:
            raise ValueError(f"Lamé constants need three equal axes, got {lam.shape} and {mu.shape}")
        if not (mu.min() >= 0 and (3 * lam + 2 * mu).min() >= 0 and np.isfinite(lam).all() and np.isfinite(mu).all()):
            raise ValueError("the stiffness of a voxel must be finite and not negative")
        if not mu.any():
            return cls(None, np.zeros((6, 6)), 1.0, dtype)
        scale = float(mu.max())
        mean = from_lame(float(lam.mean(dtype=np.float64)) / scale, float(mu.mean(dtype=np.float64)) / scale)
        longest = max(edges)
        unit = (edges[0] / longest, edges[1] / longest, edges[2] / longest)
        moduli = Moduli.of(lam, mu)
        del lam, mu
        moduli = moduli.each(lambda values: values / dtype.type(scale))
        return cls(ElasticLevel(moduli, unit, dtype), mean, scale, dtype)

    def stiffness(
        self, *, residual: float = 0.0, tolerance: float = 1e-4, iterations: int = 500, threads: int = 1,
        expansion: NDArray[Any] | None = None, fields: bool = False,
    ) -> Homogenized:  # fmt: skip
        """See the function `stiffness`; with `fields` displacements are returned, with an error that counts for them.

        The error of a stiffness is of second order in that of displacements, so that they need more iterations.
        """
        if self.finest is None:
            nothing = None if expansion is None else np.full(6, np.nan)
            return Homogenized(np.zeros((6, 6)), (Solved(0, 0.0, 0.0, 0.0, True, True),) * 6, self.dtype.name, nothing)
        finest, mean, measures = self.finest, np.diag(self.mean), list[MutualEnergies]()

        def hierarchy(precision: np.dtype[Any], safe: bool) -> Hierarchy:
            same = precision == self.dtype
            return grids_of(finest if same else ElasticLevel(finest.moduli, finest.edges, precision), safe=safe)

        def measure(hierarchy: Hierarchy) -> MutualEnergies:
            measures[:] = [MutualEnergies(hierarchy, expansion, fields)]
            return measures[0]

        first_order = fields or expansion is not None
        stop = Stop(residual, _FIRST_ORDER * tolerance if first_order else tolerance, iterations)
        matrix, solved, reached = load_cases(hierarchy, measure, mean, stop, _FLOOR, self.dtype, threads, _NESTED)
        # what is left there is rounding
        void = np.diag(matrix) < NO_LOAD_PATH * mean
        matrix[void] = 0
        matrix[:, void] = 0
        if expansion is None:
            kept = tuple(one for one in measures[0].kept if one) if fields else ()
            return Homogenized(matrix * self.scale, solved, reached, None, kept)
        held, heat = measures[0].held, measures[0].heat
        # least squares, as what is left of the matrix may be singular
        strains = np.full(6, np.nan)
        strains[~void] = np.linalg.lstsq(held[np.ix_(~void, ~void)], heat[~void], rcond=1e-9)[0]
        return Homogenized(matrix * self.scale, solved, reached, strains)


class MutualEnergies:
    """Energies and mean stresses of six load cases, and thermal stresses of a clamped cell; see `solver.Measure`.

    With the total strain of case l its stresses have the mean s and the nodal forces f, which an exact solution would
    not have, and the mutual energy with case k is ``s[k] + u[k] . f / volume``, whatever the errors of both. As f is
    only the residual of case l, an error of u[k] counts by its product with that, and 16 bits are enough for u[k].
    `expansion` (nz, ny, nx) are coefficients of thermal expansion; with `last` the last solution is kept, too.
    """

    def __init__(self, hierarchy: Hierarchy, expansion: NDArray[Any] | None = None, last: bool = False) -> None:
        level = hierarchy.levels[0]
        assert isinstance(level, ElasticLevel)
        self.level = level
        self.kept: list[tuple[I16, float] | None] = [None] * (6 if last else 5)
        self.matrix = np.zeros((6, 6))
        #: mean stresses of the cases, a row for each
        self.held = np.zeros((6, 6))
        #: In the load case of a strain the mean of ``strain : C : alpha`` over the cell is the stress of a clamped cell
        #: per kelvin (Rosen and Hashin 1970), and only the constant part of a brick's strain enters. As it is the same
        #: linear functional as a mean stress, the relations of Levin (1967) hold for any error of the displacements.
        self.heat = np.zeros(6)
        self.stress = None if expansion is None else level.bulk(expansion)
        if self.stress is not None:
            # the stress of an isotropic expansion is the same along all axes
            self.heat[:3] = self.stress.mean(dtype=np.float64)

    def target(self, case: int) -> None:
        """No solution is needed after its measurement."""

    def keep(self, case: int, u: NDArray[Any]) -> None:
        """Store a solution in 16 bits; no other is measured against the last one."""
        if case < len(self.kept):
            packed = np.empty(len(u), np.int16)
            self.kept[case] = packed, pack(u, packed)

    def record(self, case: int, u: NDArray[Any], spare: NDArray[Any], work: Workspace) -> None:
        """Compute the mutual energies of a solution with those before it."""
        level, strain = self.level, np.eye(6)[case]
        volume = level.weight.size * float(np.prod(level.edges))
        self.matrix[case, case], self.held[case] = level.energy_and_stress(strain, u)
        level.strained_forces(strain, u, spare, work)
        for k in range(case):
            kept = self.kept[k]
            assert kept is not None
            packed, step = kept
            value = self.held[case, k] + step * dot(packed, spare) / volume
            self.matrix[k, case] = self.matrix[case, k] = value
        if self.stress is not None:
            level.pressure_forces(self.stress, spare)
            self.heat[case] += dot(spare, u) / volume

    def energies(self, threads: int) -> F64:
        """Mutual energies over the volume, (6, 6)."""
        return self.matrix
