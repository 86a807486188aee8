"""The stiffness of voxels on the grids of a multigrid cycle."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.homogenization.elasticity.sweep import SCRATCH_ROWS, sweep
from sppm_pipeline.numerics.homogenization.multigrid.hierarchy import Hierarchy, Workspace, coarser, node_sums, padded
from sppm_pipeline.numerics.homogenization.multigrid.rows import APPLY
from sppm_pipeline.numerics.homogenization.multigrid.transfer import coarsened, coarser_widths, shortness


def coefficients(edges: tuple[float, float, float], strain: NDArray[np.float64] | None = None) -> NDArray[np.float64]:
    """What `sweep` needs to know of a brick, (24,).

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

    def sweep(self, mode: int, v: NDArray[Any], r: NDArray[Any], out: NDArray[Any], work: Workspace) -> float:
        """See `sweep.sweep`."""
        return sweep(mode, v, r, self.weight, self.lam, self.mu, self.c, self.size, out, work.plane, work.rows)

    def forces(self, strain: NDArray[np.float64], out: NDArray[Any], work: Workspace) -> None:
        """Nodal forces of a constant strain (6,), written to `out`."""
        c = coefficients(self.edges, strain).astype(self.c.dtype)
        zero = np.zeros_like(out)
        sweep(APPLY, zero, zero, self.weight, self.lam, self.mu, c, self.size, out, work.plane, work.rows)

    def rounding(self) -> float:
        """What forces of a homogeneous body may come to."""
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

    Coarse grids have the mean Lamé constants of eight voxels. That is stiffer than the truth, but cheap, and conjugate
    gradients make up for it.

    Parameters
    ----------
    lam, mu : (nz, ny, nx)
        Lamé constants of the voxels; both 0 in the void.
    edges : (hx, hy, hz)
    dtype : float32 or float64
        Precision of all vectors.
    safe : bool
        Damp the smoother so that it can't fail, instead of as much as seems needed.
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
