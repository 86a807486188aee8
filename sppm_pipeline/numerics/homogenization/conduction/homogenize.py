"""The effective conductivity of a periodic voxel cell, by three load cases."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.homogenization.conduction.sweep import (
    SCRATCH_ROWS,
    conduction_coefficients,
    flow_energies,
    sweep,
)
from sppm_pipeline.numerics.homogenization.multigrid.hierarchy import Hierarchy, Workspace, coarser, node_sums, padded
from sppm_pipeline.numerics.homogenization.multigrid.load_cases import load_cases
from sppm_pipeline.numerics.homogenization.multigrid.pcg import Solved, Stop
from sppm_pipeline.numerics.homogenization.multigrid.rows import APPLY
from sppm_pipeline.numerics.homogenization.multigrid.transfer import coarsened, coarser_widths, shortness

_LAYERS = 8
_FLOOR = 1e-6
_NOTHING = 1e-9


class Conducted(NamedTuple):
    """Effective conductivity and how it was reached.

    Attributes
    ----------
    conductivity : (3, 3) float64
        Mean flow over mean gradient; the unit of the voxels' conductivity.
    solved : tuple of 3 Solved
    precision : str
    """

    conductivity: NDArray[np.float64]
    solved: tuple[Solved, ...]
    precision: str


class ConductionLevel:
    """One grid of a conductor; see `multigrid.hierarchy.Level`.

    Parameters
    ----------
    k : (nz, ny, nx) float
        Conductivities.
    edges : (hx, hy, hz)
        Of a voxel.
    dtype : float32 or float64
    """

    components = 1

    def __init__(self, k: NDArray[Any], edges: tuple[float, float, float], dtype: Any) -> None:
        nz, ny, nx = k.shape
        self.shape = (nz, ny, nx)
        self.edges = edges
        self.k = padded(k, dtype)
        self.c = conduction_coefficients(edges).astype(dtype)
        self.size = np.array([nx, ny, nz], np.int64)
        self.diagonal = node_sums(16 / 9 * float(self.c[:3] @ self.c[:3]) * k).reshape(-1)
        self.weight = np.zeros(nx * ny * nz, dtype)

    def sweep(self, mode: int, v: NDArray[Any], r: NDArray[Any], out: NDArray[Any], work: Workspace) -> float:
        """See `sweep.sweep`."""
        return sweep(mode, v, r, self.weight, self.k, self.c, self.size, out, work.plane, work.rows)

    def forces(self, gradient: NDArray[np.float64], out: NDArray[Any], work: Workspace) -> None:
        """Flows out of the nodes for a constant gradient (3,), written to `out`."""
        c = conduction_coefficients(self.edges, gradient).astype(self.c.dtype)
        zero = np.zeros_like(out)
        sweep(APPLY, zero, zero, self.weight, self.k, c, self.size, out, work.plane, work.rows)

    def rounding(self) -> float:
        """What flows of a homogeneous conductor may come to."""
        largest = float(np.abs(self.c[:3]).max()) * float(self.k.max())
        return 8 * float(np.finfo(self.c.dtype).eps) * largest * float(np.sqrt(np.prod(self.edges)))


def conduction_hierarchy(k: NDArray[Any], edges: tuple[float, float, float], dtype: Any, *, safe: bool) -> Hierarchy:
    """All grids of a periodic conductor, coarse ones with the mean conductivity of eight voxels."""
    levels, bound = [ConductionLevel(k, edges, dtype)], _largest(edges)
    widths = [np.ones(n) for n in k.shape]
    while coarser(levels[-1].shape) is not None:
        doubled = [h * (2 if n > 1 else 1) for h, n in zip(edges, k.shape[::-1], strict=True)]
        edges = (doubled[0], doubled[1], doubled[2])
        k, widths = coarsened(k), coarser_widths(widths)
        levels.append(ConductionLevel(k * shortness(widths).astype(k.dtype), edges, dtype))
        bound = max(bound, _largest(edges))
    return Hierarchy.of(list(levels), SCRATCH_ROWS, bound if safe else 0.0)


def _largest(edges: tuple[float, float, float]) -> float:
    """A bound of the eigenvalues over the diagonal: that of the stiffest mode of a brick."""
    q = 1 / np.array(edges) ** 2
    return float(8 * max(q.max(), np.sort(q)[1:].sum() / 3, q.sum() / 9) / (16 / 9 * q.sum()))


def conductivity(
    k: NDArray[Any],
    edges: tuple[float, float, float] = (1.0, 1.0, 1.0),
    *,
    residual: float = 0.0,
    tolerance: float = 1e-4,
    iterations: int = 1000,
    precision: Any = np.float32,
    threads: int = 1,
) -> Conducted:
    """Effective conductivity of a periodic cell of isotropic voxels, trilinear bricks with full integration.

    Parameters
    ----------
    k : (nz, ny, nx) float
        Conductivities of the voxels; 0 for insulators.
    edges : (hx, hy, hz)
        Of a voxel, in any unit.
    residual, tolerance, iterations, precision, threads
        As for `elasticity.homogenize.stiffness`.

    Raises
    ------
    ValueError
        If a conductivity is negative or not finite.
    ArithmeticError
        If the iteration fails in double precision, too.
    """
    dtype = np.dtype(precision)
    k = np.asarray(k, dtype)
    if k.ndim != 3 or not k.size:
        raise ValueError(f"conductivities need three axes, got {k.shape}")
    if not (k.min() >= 0 and np.isfinite(k).all()):
        raise ValueError("the conductivity of a voxel must be finite and not negative")
    if not k.any():
        return Conducted(np.zeros((3, 3)), (Solved(0, 0.0, 0.0, 0.0, True, True),) * 3, dtype.name)
    scale = float(k.max())
    k = k / dtype.type(scale)
    longest = max(edges)
    edges = (edges[0] / longest, edges[1] / longest, edges[2] / longest)
    mean = np.full(3, float(k.mean(dtype=np.float64)))

    def hierarchy(precision: np.dtype[Any], safe: bool) -> Hierarchy:
        return conduction_hierarchy(k, edges, precision, safe=safe)

    matrix, solved, reached = load_cases(
        hierarchy, _energies, mean, Stop(residual, tolerance, iterations), _FLOOR, dtype, threads
    )
    nothing = np.diag(matrix) < _NOTHING * mean
    matrix[nothing] = 0
    matrix[:, nothing] = 0
    return Conducted(matrix * scale, solved, reached)


def _energies(hierarchy: Hierarchy, fields: NDArray[Any], threads: int) -> NDArray[np.float64]:
    level = hierarchy.levels[0]
    assert isinstance(level, ConductionLevel)
    nz, ny, nx = level.shape
    c = conduction_coefficients(level.edges, np.ones(3))
    k, u = level.k.reshape(nz, ny, -1), fields.reshape(3, nz, ny, nx)

    def layers(first: int) -> NDArray[np.float64]:
        out = np.zeros((3, 3))
        flow_energies(u, k, c, level.size, first, min(first + _LAYERS, nz), out)
        return out

    with ThreadPoolExecutor(threads) as pool:
        parts = list(pool.map(layers, range(0, nz, _LAYERS)))
    total = np.zeros((3, 3))
    for part in parts:
        total += part
    total /= nz * ny * nx * float(np.prod(level.edges))
    return total


def tortuosity(effective: NDArray[np.float64], share: float, bulk: float = 1.0) -> list[float | None]:
    """``share * bulk / effective`` along x, y, z: how much longer the way is, squared; None where nothing flows.

    Parameters
    ----------
    effective : (3, 3)
        Effective conductivity of a phase in an insulator.
    share : float
        Volume share of the phase.
    bulk : float
        Its conductivity.
    """
    return [share * bulk / float(value) if value > 0 else None for value in np.diag(effective)]
