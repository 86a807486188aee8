"""The grids of a multigrid cycle, and the cycle."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.arrays import F64
from sppm_pipeline.services.multigrid.rows import APPLY, BLOCK, HEAD, LANES, RESIDUAL, SMOOTH, STRIDE
from sppm_pipeline.services.multigrid.transfer import NodalTransfer
from sppm_pipeline.services.multigrid.vectors import dense_product, dot, weighted

COARSEST = 2
"""Maximum number of voxels of the coarsest grid along an axis: its matrix is so small that no library uses threads."""

_CUBE = 1.5
"""Edges up to so many times the shortest one are coarsened with it: after that all lie within a factor of two."""

_SINGULAR = 1e-5
"""Eigenvalues of the coarsest matrix below this part of the largest are rounding."""

_TWICE = 8
"""Coarse grids with longer axes than this are visited twice in a cycle."""

_POWER_STEPS = 10
"""Steps of the power method for the largest eigenvalue of a level."""


class Level(Protocol):
    """One grid of a problem, with its operator.

    Attributes
    ----------
    shape : (nz, ny, nx)
    components : int
        Unknowns of a node.
    weight : (nz * ny * nx,)
        Damped inverse of the diagonal; 0 in the void.
    """

    shape: tuple[int, int, int]
    components: int
    weight: NDArray[Any]

    @property
    def diagonal(self) -> NDArray[Any]:
        """Diagonal of the matrix, the mean of the components of a node, (nz * ny * nx,); 0 in the void."""
        ...

    def apply(self, mode: int, v: NDArray[Any], r: NDArray[Any], out: NDArray[Any], work: Workspace) -> float:
        """Apply the operator in one of the modes of `rows`: APPLY, RESIDUAL, SMOOTH; vectors are flat.

        The residual may take the place of the right-hand side.
        """
        ...


class PlanarLevel(Level, Protocol):
    """A grid whose passes keep what they need in planes, so that a cycle has one vector of it in place of two."""

    def descend(self, r: NDArray[Any], coarse: NDArray[Any], transfer: Transfer, work: Workspace) -> None:
        """Write the restricted residual after a smoothing step from zero to `coarse`."""
        ...

    def ascend(
        self, r: NDArray[Any], coarse: NDArray[Any], transfer: Transfer, out: NDArray[Any], work: Workspace
    ) -> float:
        """Write the step from zero, corrected by `coarse` and smoothed, to `out`; returns ``r . out``."""
        ...

    def turn_apply(self, z: NDArray[Any], beta: float, p: NDArray[Any], work: Workspace) -> float:
        """Update ``p = z + beta p``, write its forces over z, and return their product."""
        ...


class Body(Level, Protocol):
    """A grid that can be loaded, as `solver.load_cases` does.

    Attributes
    ----------
    edges : (hx, hy, hz)
        Of a voxel.
    """

    edges: tuple[float, float, float]

    def forces(self, load: F64, out: NDArray[Any], work: Workspace) -> None:
        """Nodal forces of a constant load, a mean strain or gradient, written to `out`."""
        ...

    def rounding(self) -> float:
        """Rounding error to expect in forces that should be zero, for each node."""
        ...


class Transfer(Protocol):
    """The way between a grid and the next coarser one."""

    def restrict(self, fine: NDArray[Any], out: NDArray[Any], line: NDArray[Any]) -> None:
        """From residuals of the fine grid to those of the coarse one; `line` is scratch, a row and two more."""
        ...

    def interpolate_add(self, coarse: NDArray[Any], out: NDArray[Any], line: NDArray[Any]) -> None:
        """Add a correction of the coarse grid to a vector of the fine one: the transpose."""
        ...


def coarser(
    shape: tuple[int, int, int], edges: tuple[float, float, float] = (1.0, 1.0, 1.0), *, open_ends: bool = False
) -> tuple[int, int, int] | None:
    """Voxels of the next grid; None if `shape` is the coarsest.

    Axes along which voxels are longer than along others wait until those have caught up (semi-coarsening): the smoother
    hardly reduces errors that vary along a long edge only, and coarse grids must therefore keep them.

    Parameters
    ----------
    shape : (nz, ny, nx)
    edges : (hx, hy, hz)
        Of a voxel.
    open_ends : bool
        The last voxels are void, and stay by themselves; see `transfer`.
    """
    if max(shape) <= COARSEST:
        return None
    if open_ends:
        shortest = min(h for h, n in zip(edges[::-1], shape, strict=True) if n > COARSEST)
        z, y, x = (
            n // 2 + 1 if n > COARSEST and h <= _CUBE * shortest else n for h, n in zip(edges[::-1], shape, strict=True)
        )
        return z, y, x
    shortest = min(h for h, n in zip(edges[::-1], shape, strict=True) if n > 1)
    z, y, x = (-(-n // 2) if h <= _CUBE * shortest else n for h, n in zip(edges[::-1], shape, strict=True))
    return z, y, x


def padded(values: NDArray[Any], dtype: Any) -> NDArray[Any]:
    """Rows with room for whole vectors, the last voxel standing before the first, too; flat."""
    nz, ny, nx = values.shape
    rows = np.zeros((nz, ny, HEAD + -(-(nx + 1) // LANES) * LANES), dtype)
    rows[:, :, HEAD : HEAD + nx] = values
    rows[:, :, HEAD - 1] = values[:, :, -1]
    return rows.reshape(-1)


def node_sums(values: NDArray[Any]) -> NDArray[Any]:
    """Sum over the eight voxels around each node of a periodic grid."""
    for axis in range(3):
        values = values + np.roll(values, 1, axis)
    return values


class Workspace:
    """Work arrays of one thread for a cycle.

    Parameters
    ----------
    levels : sequence of Level
    scratch_rows : int
        Rows of scratch of a pass.
    planar : bool
        Whether all levels but the last are of `PlanarLevel`.
    """

    def __init__(self, levels: list[Level], scratch_rows: int, planar: bool = False) -> None:
        dtype = levels[0].weight.dtype
        longest = max(level.shape[2] for level in levels)
        components = levels[0].components
        self.rows = np.zeros(scratch_rows * STRIDE, dtype)
        self.line = np.zeros(longest + 3, dtype)
        # rows of the plane have the distance of rows of scratch, too
        self.plane = np.zeros(components * max(lv.shape[1] * -(-lv.shape[2] // BLOCK) for lv in levels) * STRIDE, dtype)
        layer = components * levels[0].shape[1] * levels[0].shape[2] if planar else 0
        self.ring, self.rest = np.zeros(2 * layer, dtype), np.zeros(layer, dtype)
        sizes = [components * int(np.prod(level.shape)) for level in levels]
        self.z = [np.zeros(size, dtype) for size in sizes]
        self.q = [np.zeros(0 if planar else size, dtype) for size in sizes]
        sizes[0] = 0
        self.r = [np.zeros(size, dtype) for size in sizes]
        self.sum = [np.zeros(size, dtype) for size in sizes]

    def below(self) -> Workspace:
        """The same arrays, for a cycle that begins on the next coarser grid."""
        view = copy(self)
        view.z, view.q, view.r, view.sum = self.z[1:], self.q[1:], self.r[1:], self.sum[1:]
        return view


@dataclass(frozen=True)
class Hierarchy:
    """Grids from the finest to the coarsest, with the inverse on the last.

    Attributes
    ----------
    levels : list of Level
    transfers : list of Transfer
        Between each pair of grids.
    inverse : (m, m) float64
        Of the coarsest matrix.
    scratch_rows : int
    twice : bool
        Whether coarse grids are visited twice in a cycle. That saves iterations, but if a coarse grid is much softer
        than it should be, the cycle is no longer positive definite; with single visits it always is.
    planar : bool
        Whether all levels are of `PlanarLevel`.
    stretch : float
        Factor of corrections from coarse grids, for those that are stiffer than they should be.
    """

    levels: list[Level]
    transfers: Sequence[Transfer]
    inverse: F64
    scratch_rows: int
    twice: bool
    planar: bool = False
    stretch: float = 1.0

    @classmethod
    def of(
        cls,
        levels: list[Level],
        scratch_rows: int,
        largest: float,
        *,
        transfers: Sequence[Transfer] | None = None,
        twice: bool | None = None,
        damping: float = 0.5,
        planar: bool = False,
        stretch: float = 1.0,
    ) -> Hierarchy:
        """Set the damping of all levels and invert the coarsest matrix.

        Parameters
        ----------
        levels : list of Level
        scratch_rows : int
        largest : float
            Bound of the eigenvalues of the matrix over its diagonal; 0 to estimate it.
        transfers : sequence of Transfer, optional
            Those between nodes if omitted.
        twice : bool, optional
            As the attribute; if omitted, with an estimate only.
        damping : float
            Of the smoother, if `largest` allows so much.
        planar, stretch
            As the attributes.
        """
        work = Workspace(levels, scratch_rows, planar)
        for level in levels:
            inverse, diagonal = np.zeros_like(level.weight), level.diagonal
            np.divide(1, diagonal, out=inverse, where=diagonal > 0)
            level.weight[:] = inverse
            # damped Jacobi converges below 2 / (largest eigenvalue), which power steps approach from below
            bound = 1.9 / (largest or _largest_eigenvalue(level, work))
            level.weight *= level.weight.dtype.type(min(damping, bound))
        if transfers is None:
            transfers = [NodalTransfer.between(fine.shape, coarse.shape) for fine, coarse in pairwise(levels)]
        inverse = _inverse(levels[-1], work)
        return cls(levels, transfers, inverse, scratch_rows, largest == 0 if twice is None else twice, planar, stretch)

    def workspace(self) -> Workspace:
        """For one thread."""
        return Workspace(self.levels, self.scratch_rows, self.planar)

    def below(self) -> Hierarchy:
        """Without the finest grid."""
        return replace(self, levels=self.levels[1:], transfers=self.transfers[1:])

    def cycle(self, r: NDArray[Any], work: Workspace, depth: int = 0) -> tuple[NDArray[Any], float]:
        """One V- or W-cycle with damped Jacobi steps before and after: an approximation of the solution for `r`.

        Returns
        -------
        z : flat
            Belongs to `work`.
        product : float
            ``r . z``.
        """
        level = self.levels[depth]
        z, q = work.z[depth], work.q[depth]
        if depth == len(self.levels) - 1:
            dense_product(self.inverse, r, z)
            return z, dot(r, z)
        if self.planar:
            thin = cast(PlanarLevel, level)
            thin.descend(r, work.r[depth + 1], self.transfers[depth], work)
            correction = self._correction(work, depth + 1)
            return z, thin.ascend(r, correction, self.transfers[depth], z, work)
        # a smoothing step from zero is the damped right-hand side alone
        weighted(r, level.weight, z)
        level.apply(RESIDUAL, z, r, q, work)
        self.transfers[depth].restrict(q, work.r[depth + 1], work.line)
        correction = self._correction(work, depth + 1)
        self.transfers[depth].interpolate_add(correction, z, work.line)
        return q, level.apply(SMOOTH, z, r, q, work)

    def _correction(self, work: Workspace, depth: int) -> NDArray[Any]:
        """The solution for ``work.r[depth]`` by one cycle, or two where they save more iterations than they cost."""
        level, r, total = self.levels[depth], work.r[depth], work.sum[depth]
        once, _ = self.cycle(r, work, depth)
        # a grid that is coarser along one axis only would cost as much as the one above it
        costly = 4 * level.weight.size > 1.1 * self.levels[depth - 1].weight.size
        if not self.twice or costly or max(level.shape) <= _TWICE:
            once *= once.dtype.type(self.stretch)
            return once
        total[:] = once
        level.apply(RESIDUAL, total, r, r, work)
        again, _ = self.cycle(r, work, depth)
        total += again
        total *= total.dtype.type(self.stretch)
        return total


def _largest_eigenvalue(level: Level, work: Workspace) -> float:
    """Largest eigenvalue of the matrix over its diagonal, by power steps from fixed pseudo-random numbers."""
    size = level.components * level.weight.size
    numbers = np.arange(size, dtype=np.uint32)
    # a hash in place of random numbers: 2^32 over the golden ratio (Knuth), then a multiplier of xxHash32
    numbers *= np.uint32(2654435769)
    numbers ^= numbers >> np.uint32(15)
    numbers *= np.uint32(2246822519)
    v = (numbers >> np.uint32(8)).astype(level.weight.dtype)
    v -= v.dtype.type(2**23)  # mean zero, as translations have no stiffness
    q = np.empty_like(v)
    largest = 1.0
    weighted(v, level.weight, q)
    v, q = q, v
    for _ in range(_POWER_STEPS):
        norm = np.sqrt(dot(v, v))
        if not norm > 0:
            return 1.0
        v *= v.dtype.type(1 / norm)
        level.apply(APPLY, v, v, q, work)
        weighted(q, level.weight, q)
        largest = np.sqrt(dot(q, q))
        v, q = q, v
    return max(1.0, float(largest))


def _inverse(level: Level, work: Workspace) -> F64:
    """Pseudo-inverse of the matrix of a small level: translations and disconnected parts have no stiffness."""
    size = level.components * level.weight.size
    matrix = np.empty((size, size))
    unit, column = np.zeros(size, level.weight.dtype), np.empty(size, level.weight.dtype)
    for i in range(size):
        unit[i] = 1  # a column of the matrix each
        level.apply(APPLY, unit, unit, column, work)
        unit[i] = 0
        matrix[:, i] = column
    matrix[:, ~matrix.any(axis=1)] = 0  # what is held answers no force
    return np.asarray(np.linalg.pinv((matrix + matrix.T) / 2, rcond=_SINGULAR, hermitian=True), np.float64)
