"""Grids of an elastic body for multigrid."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.arrays import F64, Bools
from sppm_pipeline.services.elastic.elastic_energy import ENERGY_ROWS, energy_and_stress, energy_coefficients
from sppm_pipeline.services.elastic.elastic_operator import SCRATCH_ROWS
from sppm_pipeline.services.elastic.elastic_passes import apply_stiffness, ascend, constant_forces, descend, turn_apply
from sppm_pipeline.services.multigrid.hierarchy import Hierarchy, Transfer, Workspace, coarser, node_sums, padded
from sppm_pipeline.services.multigrid.rows import APPLY, HEAD, STRIDE
from sppm_pipeline.services.multigrid.transfer import NodalTransfer, coarsened, coarser_widths, shortness

STRETCH = 1.2
"""Factor of coarse corrections: grids with mean moduli are too stiff. Measured on foams, lattices and random blobs: up
to a sixth fewer iterations, and none lost, from 1.1 to 1.3; at 1.4 some cycles are no longer positive definite."""


class Moduli(NamedTuple):
    """Lamé constants of voxels.

    Attributes
    ----------
    mu : (nz, ny, nx) float
        0 in the void.
    lam : (nz, ny, nx) float, or None
        None where one Poisson's ratio holds for all voxels.
    ratio : float
        lambda over mu if so, else 1.
    """

    mu: NDArray[Any]
    lam: NDArray[Any] | None
    ratio: float

    @classmethod
    def of(cls, lam: NDArray[Any], mu: NDArray[Any]) -> Moduli:
        """Create from arrays of both; a ratio that is uniform up to rounding is stored as one number."""
        place = np.unravel_index(np.argmax(mu), mu.shape)
        ratio = float(lam[place]) / float(mu[place]) if mu[place] > 0 else 0.0
        slack = 4 * np.finfo(mu.dtype).eps  # rounding of a division and a product, with a margin
        for k, m in zip(lam, mu, strict=True):
            if not (np.abs(k - mu.dtype.type(ratio) * m) <= slack * np.abs(k)).all():
                return cls(mu, lam, 1.0)
        return cls(mu, None, ratio)

    def each(self, change: Callable[[NDArray[Any]], NDArray[Any]]) -> Moduli:
        """Apply a linear map to both."""
        return Moduli(change(self.mu), None if self.lam is None else change(self.lam), self.ratio)

    @property
    def lam_of(self) -> NDArray[Any]:
        """Array that `ratio` multiplies: lambda, or mu in its place."""
        return self.mu if self.lam is None else self.lam


def coefficients(edges: tuple[float, float, float], strain: F64 | None = None, ratio: float = 1.0) -> F64:
    """Weights of the modes of a brick for `apply_stiffness`, (26,).

    Parameters
    ----------
    edges : (hx, hy, hz)
        Edge lengths of a voxel.
    strain : (6,), optional
        Additional constant strain xx, yy, zz, yz, xz, xy (engineering shear).
    ratio : float
        Factor of the first Lamé constant.
    """
    h = np.array(edges, np.float64)
    volume = h.prod()
    # from sums over corners to strains times the root of the volume
    g = np.sqrt(volume) / (4 * h)
    q = g * g
    linear = [(2 * q[a] + q[b]) / 3 for a, b in ((0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1))]
    constant = np.zeros(6) if strain is None else np.sqrt(volume) * strain
    return np.concatenate([g, linear, q / 9, (q + q.sum()) / 9, g / 3, constant, [ratio, 1 / 3]])


class ElasticLevel:
    """One grid of an elastic body; see `multigrid.hierarchy.PlanarLevel`.

    Parameters
    ----------
    moduli : Moduli
    edges : (hx, hy, hz)
        Edge lengths of a voxel.
    dtype : float32 or float64
    """

    components = 3

    def __init__(self, moduli: Moduli, edges: tuple[float, float, float], dtype: Any) -> None:
        nz, ny, nx = moduli.mu.shape
        self.shape = (nz, ny, nx)
        self.edges = edges
        self.ratio = moduli.ratio
        self.mu = padded(moduli.mu, dtype)
        self.lam = self.mu if moduli.lam is None else padded(moduli.lam, dtype)
        self.c = coefficients(edges, None, moduli.ratio).astype(dtype)
        self.size = np.array([nx, ny, nz], np.int64)
        self.weight = np.zeros(nx * ny * nz, dtype)
        self.held, self.first = np.zeros(0, np.int32), np.zeros(nz + 1, np.int64)

    def hold(self, fixed: Bools) -> None:
        """Hold displacements at zero, (3, nz, ny, nx) bool."""
        planes = fixed.transpose(1, 0, 2, 3).reshape(self.shape[0], -1)
        self.held = np.nonzero(planes)[1].astype(np.int32)
        self.first = np.concatenate([[0], np.cumsum(np.count_nonzero(planes, axis=1))]).astype(np.int64)

    @property
    def moduli(self) -> Moduli:
        """Moduli of the voxels, as views without padding."""
        nz, ny, nx = self.shape
        mu, lam = (values.reshape(nz, ny, -1)[:, :, HEAD : HEAD + nx] for values in (self.mu, self.lam))
        return Moduli(mu, None if self.lam is self.mu else lam, self.ratio)

    @property
    def diagonal(self) -> NDArray[Any]:
        """Diagonal of the matrix, averaged over the components of a node, (nz ny nx,)."""
        moduli, dtype = self.moduli, self.c.dtype
        # mean over x, y, z of the diagonal of a brick: 16/9 for the weights 1, 1/3, 1/3, 1/9
        factor = dtype.type(16 / 27 * float(self.c[:3].astype(np.float64) @ self.c[:3]))
        if moduli.lam is None:
            return node_sums(factor * dtype.type(self.ratio + 4) * moduli.mu).reshape(-1)
        return node_sums(factor * (moduli.lam + 4 * moduli.mu)).reshape(-1)

    def apply(self, mode: int, v: NDArray[Any], r: NDArray[Any], out: NDArray[Any], work: Workspace) -> float:
        """See `elastic_passes.apply_stiffness`."""
        return apply_stiffness(
            mode, v, r, self.weight, self.lam, self.mu, self.c, self.size, out, work.plane, work.rows, self.held,
            self.first,
        )  # fmt: skip

    def descend(self, r: NDArray[Any], coarse: NDArray[Any], transfer: Transfer, work: Workspace) -> None:
        """See `elastic_passes.descend`."""
        assert isinstance(transfer, NodalTransfer)
        descend(
            r, self.weight, self.lam, self.mu, self.c, self.size, coarse, transfer.shapes, work.ring, work.rest,
            work.line, work.plane, work.rows, self.held, self.first,
        )  # fmt: skip

    def ascend(
        self, r: NDArray[Any], coarse: NDArray[Any], transfer: Transfer, out: NDArray[Any], work: Workspace
    ) -> float:
        """See `elastic_passes.ascend`."""
        assert isinstance(transfer, NodalTransfer)
        return ascend(
            r, self.weight, self.lam, self.mu, self.c, self.size, coarse, transfer.shapes, work.ring, work.line, out,
            work.plane, work.rows, self.held, self.first,
        )  # fmt: skip

    def turn_apply(self, z: NDArray[Any], beta: float, p: NDArray[Any], work: Workspace) -> float:
        """See `elastic_passes.turn_apply`."""
        return turn_apply(
            z, beta, p, self.weight, self.lam, self.mu, self.c, self.size, work.plane, work.rows, self.held, self.first
        )

    def forces(self, strain: F64, out: NDArray[Any], work: Workspace) -> None:
        """Nodal forces of a constant strain (6,), written to `out`."""
        c = coefficients(self.edges, strain, self.ratio).astype(self.c.dtype)
        nothing = np.zeros(3 * self.shape[1] * self.shape[2], self.c.dtype)
        constant_forces(self.weight, self.lam, self.mu, c, self.size, nothing, out, work.plane, work.rows)

    def strained_forces(self, strain: F64, u: NDArray[Any], out: NDArray[Any], work: Workspace) -> None:
        """Nodal forces of displacements plus a constant strain (6,), written to `out`."""
        c = coefficients(self.edges, strain, self.ratio).astype(self.c.dtype)
        apply_stiffness(
            APPLY, u, u, self.weight, self.lam, self.mu, c, self.size, out, work.plane, work.rows, self.held, self.first
        )

    def energy_and_stress(self, strain: F64, u: NDArray[Any]) -> tuple[float, F64]:
        """Mean energy and mean stresses (6,) of displacements plus a constant strain (6,)."""
        dtype, out = self.c.dtype, np.empty(7)
        root = float(np.sqrt(np.prod(self.edges)))
        c = energy_coefficients(self.edges).astype(dtype)
        energy_and_stress(
            u, self.lam, self.mu, self.c[24], c, (root * strain).astype(dtype), self.size,
            np.zeros(ENERGY_ROWS * STRIDE, dtype), out,
        )  # fmt: skip
        out /= self.weight.size * root
        return float(out[0]) / root, out[1:]

    def bulk(self, expansion: NDArray[Any]) -> NDArray[Any]:
        """Stress along each axis that suppresses an expansion (nz, ny, nx): three bulk moduli times it."""
        moduli, dtype = self.moduli, self.c.dtype
        return np.asarray((3 * (dtype.type(self.ratio) * moduli.lam_of) + 2 * moduli.mu) * expansion.astype(dtype))

    def pressure_forces(self, stress: NDArray[Any], out: NDArray[Any]) -> None:
        """Nodal forces of an equal stress along all axes in each voxel (nz, ny, nx), written to `out`."""
        volume = np.prod(self.edges)
        forces = out.reshape(3, *self.shape)
        for d in range(3):
            # a node is pushed by the difference along d of the sums over the four voxels on either side
            around = stress
            for axis in range(3):
                if axis != 2 - d:
                    around = around + np.roll(around, 1, axis)
            forces[d] = (np.roll(around, 1, 2 - d) - around) * out.dtype.type(volume / (4 * self.edges[d]))

    def rounding(self) -> float:
        """Expected rounding error of the forces of a homogeneous body."""
        stiffest = float((self.c[24] * self.lam.max()) + 2 * self.mu.max())
        largest = float(np.abs(self.c[:3]).max()) * stiffest
        return 8 * float(np.finfo(self.c.dtype).eps) * largest * float(np.sqrt(np.prod(self.edges)))


def largest_eigenvalue(moduli: Moduli, edges: tuple[float, float, float]) -> float:
    """Upper bound of the eigenvalues of the stiffness over its diagonal: the largest of a single brick."""
    q = 1 / np.array(edges) ** 2
    if moduli.lam is None:
        ratios = [moduli.ratio]
    else:
        solid = moduli.mu > 0
        between = moduli.lam[solid] / moduli.mu[solid]  # largest at one of the ends, see below
        ratios = [float(between.min()), float(between.max())]
    largest = 0.0
    for ratio in ratios:
        # constant strains are the stiffest modes; `normal` grows with the ratio, `shear` falls over the diagonal
        normal, shear = max(0.0, ratio) * q.sum() + 2 * q.max(), np.sort(q)[1:].sum()
        largest = max(largest, 8 * max(normal, shear) / (16 / 27 * q.sum() * (ratio + 4)))
    return float(largest)


def grids_of(finest: ElasticLevel, *, safe: bool = False) -> Hierarchy:
    """Build the hierarchy of a periodic body: its finest grid and all coarser ones.

    Coarse grids have the mean Lamé constants of eight voxels. That is stiffer than Galerkin's operator, but cheap, and
    conjugate gradients compensate for it.

    Parameters
    ----------
    finest : ElasticLevel
    safe : bool
        Visit coarse grids once in a cycle, which is then always positive definite.
    """
    moduli, edges, levels = finest.moduli, finest.edges, [finest]
    # power steps approach the largest eigenvalue of a porous cell so slowly that a smoother damped by them may diverge
    bound = largest_eigenvalue(moduli, edges)
    widths = [np.ones(n) for n in finest.shape]
    while (shape := coarser(levels[-1].shape, edges)) is not None:
        fine = levels[-1].shape
        x, y, z = (h * (2 if m < n else 1) for h, n, m in zip(edges, fine[::-1], shape[::-1], strict=True))
        edges = (x, y, z)
        moduli, widths = moduli.each(lambda values: coarsened(values, shape)), coarser_widths(widths, shape)
        # where the last coarse voxel of an axis covers one fine voxel instead of two, it is as much shorter and stiffer
        stiffer = shortness(widths).astype(moduli.mu.dtype)
        levels.append(ElasticLevel(moduli.each(lambda values: values * stiffer), edges, finest.c.dtype))  # noqa: B023
        bound = max(bound, largest_eigenvalue(moduli, edges))
    return Hierarchy.of(list(levels), SCRATCH_ROWS, bound, twice=not safe, planar=True, stretch=STRETCH)
