"""Coarse grids for the pressure in channels: one unknown for each connected piece of a block.

A block of 2 x 2 x 2 voxels may hold pieces of several channels. One unknown for all of them would let pressure pass
where there is a wall, and a coarse grid of such blocks is useless in narrow channels. So a block has as many
unknowns as pieces, and coarse grids are graphs. From the voxels to the first graph values are constant in each piece,
and half the sum of the weights joins two, as their distance is twice that of voxels. Below that, interpolation is
smoothed (smoothed aggregation: Vanek, Mandel and Brezina 1996), which in channels of changing width, whose weights span
orders of magnitude, saves half of the iterations.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.features.flow.numerics.seven_point import SevenPointLevel
from sppm_pipeline.numerics import RESIDUAL, SMOOTH, Workspace, dense_product, inline_jit, jit, weighted

_DENSE = 60
"""Unknowns of the coarsest graph, unless it is one block; so few that no library uses threads for its matrix."""

_SINGULAR = 1e-10
"""Eigenvalues of that matrix below this part of the largest are rounding. Narrow throats have small ones, too."""

_NARROW = 0.2
"""Share of voxels in the fluid below which graphs are visited twice in turn. Measured: that saves a third of the
iterations at a porosity of 0.15, one of twenty at 0.2, where it costs as much as it saves, and above none."""

_DAMPING = 0.8
"""Of the Jacobi steps on voxels, whose bound is 1."""

_SMOOTHED = 4 / 3
"""Of the step that smooths interpolation, over the largest eigenvalue; the factor of Vanek, Mandel and Brezina."""


class _Graph(NamedTuple):
    """One coarse grid: a sparse matrix by rows, and the interpolation from the next coarser one."""

    starts: NDArray[np.int32]
    columns: NDArray[np.int32]
    values: NDArray[np.float32]
    #: Inverse of the diagonal; 0 where nothing joins an unknown to others.
    inverse: NDArray[np.float32]
    #: Interpolation by rows: starts, columns, values.
    up: tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.float32]]


class ChannelWork(NamedTuple):
    """Vectors of one thread: solution, right-hand side and sum for each graph, and for the coarsest matrix."""

    z: list[NDArray[np.float32]]
    r: list[NDArray[np.float32]]
    total: list[NDArray[np.float32]]


class ChannelGrids:
    """A multigrid cycle for the pressure, positive definite by construction.

    Graphs have cycles with Gauss-Seidel sweeps forward before and backward after, whose coarse matrices are
    Galerkin's: what a cycle takes of an error is never more than all of it, so that two in turn are still positive
    definite. Two are made where the fluid is a small part of the voxels: its channels are narrow, and graphs cost
    little. `weights` are three arrays (nz, ny, nx) between each voxel and the one before it along x, y, z; 0 across
    walls. Voxels without any have no unknown.
    """

    def __init__(self, weights: tuple[NDArray[np.float32], ...]) -> None:
        self.level = SevenPointLevel(np.zeros_like(weights[0]), weights)
        diagonal = self.level.diagonal
        np.divide(_DAMPING, diagonal, out=self.level.weight, where=diagonal > 0)
        shape = self.level.shape
        blocks = tuple(-(-n // 2) for n in shape)
        self.twice = np.count_nonzero(diagonal) < _NARROW * diagonal.size
        self.piece = np.full(diagonal.size, -1, np.int32)
        block = np.empty(np.count_nonzero(diagonal), np.int64)
        wx, wy, wz = self.level.weights
        count = pieces_of_blocks(diagonal, wx, wy, wz, self.level.size, self.piece, block)
        place = np.stack(np.unravel_index(block[:count], blocks), axis=1)
        self.graphs, self.inverse = _graphs(_joined(self.piece.reshape(shape), weights, count), place, blocks)
        self.sizes = [len(graph.inverse) for graph in self.graphs] + [len(self.inverse)]

    def workspace(self) -> ChannelWork:
        """For one thread."""
        z, r, total = ([np.zeros(size, np.float32) for size in self.sizes] for _ in range(3))
        return ChannelWork(z, r, total)

    def cycle(self, r: NDArray[np.float32], work: Workspace, own: ChannelWork) -> NDArray[np.float32]:
        """One cycle, two steps of the smoother before and after: an approximation of the solution for `r` (flat),
        which belongs to `work`, the workspace of any grids of these voxels with one unknown each.
        """
        level, z, q = self.level, work.z[0], work.q[0]
        weighted(r, level.weight, z)
        level.apply(SMOOTH, z, r, q, work)
        # smoothers before and after mirror each other, so that the cycle is a symmetric operator, as MINRES requires
        level.apply(RESIDUAL, q, r, z, work)
        collect_pieces(z, self.piece, own.r[0])
        spread_pieces(self._correction(0, own), self.piece, q)
        level.apply(SMOOTH, q, r, z, work)
        level.apply(SMOOTH, z, r, q, work)
        return q

    def _correction(self, depth: int, own: ChannelWork) -> NDArray[np.float32]:
        """One cycle for ``own.r[depth]``, or two in turn, and then it is lost."""
        if depth == len(self.graphs):
            dense_product(self.inverse, own.r[depth], own.z[depth])
            return own.z[depth]
        graph, r, total = self.graphs[depth], own.r[depth], own.total[depth]
        if not self.twice:
            return self._cycle(depth, own)
        total[:] = self._cycle(depth, own)
        leave(graph.starts, graph.columns, graph.values, total, r)
        total += self._cycle(depth, own)
        return total

    def _cycle(self, depth: int, own: ChannelWork) -> NDArray[np.float32]:
        graph, r, z = self.graphs[depth], own.r[depth], own.z[depth]
        relax_from_zero(graph.starts, graph.columns, graph.values, graph.inverse, r, z, *graph.up, own.r[depth + 1])
        correction = self._correction(depth + 1, own)
        relax_back(graph.starts, graph.columns, graph.values, graph.inverse, r, *graph.up, correction, z)
        return z


def _joined(piece: NDArray[np.int32], weights: tuple[NDArray[np.float32], ...], count: int) -> Any:
    """The matrix of the first graph, scipy.sparse.csr_array of float64."""
    from scipy.sparse import coo_array

    parts = []
    for d, weight in enumerate(weights):
        before = np.roll(piece, 1, 2 - d)
        # weights within a piece vanish from the coarse matrix, as its values are constant there
        apart = (weight > 0) & (piece != before)
        shares = np.float32(0.5) * weight[apart]
        parts.append(coo_array((shares.astype(np.float64), (piece[apart], before[apart])), (count, count)).tocsr())
    total = parts[0] + parts[1] + parts[2]
    return _laplacian(total + total.T)


def _laplacian(joins: Any) -> Any:
    """A matrix whose rows have no sum, from the weights off its diagonal."""
    from scipy.sparse import diags_array

    return (diags_array(joins.sum(axis=1)) - joins).tocsr()


def _graphs(matrix: Any, place: NDArray[np.int64], blocks: tuple[int, ...]) -> tuple[list[_Graph], NDArray[np.float64]]:
    """Graphs and inverse of the coarsest matrix from the first one, whose unknowns lie in the blocks `place` (n, 3)."""
    from scipy.sparse import coo_array, csr_array, diags_array
    from scipy.sparse.csgraph import connected_components

    graphs = []
    # pieces of eight blocks that are joined become one unknown of the next graph
    while matrix.shape[0] > _DENSE and max(blocks) > 1:
        place, blocks = place >> 1, tuple(-(-n // 2) for n in blocks)
        block = np.ravel_multi_index(tuple(place.T), blocks)
        size = matrix.shape[0]
        rows = np.repeat(np.arange(size, dtype=np.int32), np.diff(matrix.indptr))
        inside = block[rows] == block[matrix.indices]
        ends = (rows[inside], matrix.indices[inside])
        count, piece = connected_components(coo_array((np.ones(len(ends[0]), np.int8), ends), matrix.shape), False)
        starts = np.arange(size + 1, dtype=np.int32)
        constant = csr_array((np.ones(size), piece.astype(np.int32), starts), (size, count))
        # the sum of absolute values in a row bounds the eigenvalues; it is twice the diagonal where all signs differ
        bound = abs(matrix).sum(axis=1)
        step = np.divide(_SMOOTHED, bound, out=np.zeros(size), where=bound > 0)
        # one damped Jacobi step on the piecewise constant interpolation: smoothed aggregation
        up = (constant - diags_array(step) @ (matrix @ constant)).tocsr()
        coarse = (up.T @ matrix @ up).tocsr()
        joins = diags_array(coarse.diagonal()) - coarse
        joins.eliminate_zeros()
        place = place[np.unique(piece, return_index=True)[1]]
        # a whole channel in one piece has no error left; of thousands beside each other the last matrix would be huge
        joined = np.diff(joins.indptr) > 0
        if not joined.all():
            up, joins, place = up[:, joined].tocsr(), joins[joined][:, joined].tocsr(), place[joined]
        graphs.append(_graph(matrix, up))
        matrix = _laplacian(joins)
    # symmetrized below, since rounding of the products leaves differences that `eigh` would ignore on one side
    dense = matrix.toarray()
    values, vectors = np.linalg.eigh((dense + dense.T) / 2)
    # pressures are known up to a constant for each piece: the pseudo-inverse leaves these modes out
    whole = values > _SINGULAR * values.max(initial=0.0)
    inverse = (vectors[:, whole] / values[whole]) @ vectors[:, whole].T
    return graphs, np.asarray(inverse, np.float64)


def _graph(matrix: Any, up: Any) -> _Graph:
    diagonal = matrix.diagonal()
    inverse = np.divide(1, diagonal, out=np.zeros_like(diagonal), where=diagonal > 0)
    arrays = [(m.indptr.astype(np.int32), m.indices.astype(np.int32), m.data.astype(np.float32)) for m in (matrix, up)]
    return _Graph(*arrays[0], inverse.astype(np.float32), arrays[1])


@jit
def pieces_of_blocks(
    diagonal: NDArray[np.float32], wx: NDArray[np.float32], wy: NDArray[np.float32], wz: NDArray[np.float32],
    shape: NDArray[np.int64], piece: NDArray[np.int32], block: NDArray[np.int64],
) -> int:  # fmt: skip
    """Number the connected pieces within each block of 2 x 2 x 2 voxels; returns how many there are.

    `diagonal` and weights are those of a `SevenPointLevel`, (nz, ny, nx) flat; where the diagonal is 0, there is no
    unknown. `shape` is (nx, ny, nz). `piece`, (nz, ny, nx) flat, receives numbers in the order of blocks, and `block`
    the block of each piece.
    """
    nx, ny, nz = shape[0], shape[1], shape[2]
    found, number = 0, 0
    root = np.empty(8, np.int64)
    at = np.empty(8, np.int64)
    for z in range(0, nz, 2):
        for y in range(0, ny, 2):
            for x in range(0, nx, 2):
                for k in range(8):
                    px, py, pz = x + (k & 1), y + ((k >> 1) & 1), z + (k >> 2)
                    root[k], at[k] = -1, -1
                    if px < nx and py < ny and pz < nz:
                        at[k] = (pz * ny + py) * nx + px
                        if diagonal[at[k]] > 0:
                            root[k] = k
                for k in range(1, 8):
                    if root[k] < 0:
                        continue
                    for bit in range(3):
                        other = k - (1 << bit)
                        if (k >> bit) & 1 == 0 or root[other] < 0:
                            continue
                        w = wx[at[k]] if bit == 0 else (wy[at[k]] if bit == 1 else wz[at[k]])
                        if w > 0:
                            low, high = min(root[k], root[other]), max(root[k], root[other])
                            # eight labels: relabeling all of them is cheaper than a union-find structure
                            for one in range(8):
                                if root[one] == high:
                                    root[one] = low
                for k in range(8):
                    if root[k] == k:
                        block[found] = number
                        for one in range(k, 8):
                            if root[one] == k:
                                piece[at[one]] = found
                        found += 1
                number += 1
    return found


@jit
def collect_pieces(fine: NDArray[np.float32], piece: NDArray[np.int32], coarse: NDArray[np.float32]) -> None:
    """Sums over pieces."""
    coarse[:] = 0
    for i in range(len(piece)):
        if piece[i] >= 0:
            coarse[piece[i]] += fine[i]


@jit
def spread_pieces(coarse: NDArray[np.float32], piece: NDArray[np.int32], fine: NDArray[np.float32]) -> None:
    """Add to each voxel the value of its piece."""
    for i in range(len(piece)):
        if piece[i] >= 0:
            fine[i] += coarse[piece[i]]


@inline_jit
def _row(starts: Any, columns: Any, values: Any, i: int, x: NDArray[np.float32]) -> Any:
    total = np.float32(0)
    for at in range(starts[i], starts[i + 1]):
        total += values[at] * x[columns[at]]
    return total


@jit
def leave(
    starts: NDArray[np.int32], columns: NDArray[np.int32], values: NDArray[np.float32], x: NDArray[np.float32],
    r: NDArray[np.float32],
) -> None:  # fmt: skip
    """Take a matrix times a vector from another one."""
    for i in range(len(r)):
        r[i] -= _row(starts, columns, values, i, x)


@jit
def relax_from_zero(
    starts: NDArray[np.int32], columns: NDArray[np.int32], values: NDArray[np.float32], inverse: NDArray[np.float32],
    r: NDArray[np.float32], z: NDArray[np.float32], up_starts: NDArray[np.int32], up_columns: NDArray[np.int32],
    up_values: NDArray[np.float32], coarse: NDArray[np.float32],
) -> None:  # fmt: skip
    """A sweep of Gauss and Seidel forward from zero, and the restriction of what it leaves of the right-hand side."""
    z[:] = 0
    for i in range(len(r)):
        z[i] = inverse[i] * (r[i] - _row(starts, columns, values, i, z))
    coarse[:] = 0
    for i in range(len(r)):
        left = r[i] - _row(starts, columns, values, i, z)
        for at in range(up_starts[i], up_starts[i + 1]):
            coarse[up_columns[at]] += up_values[at] * left


@jit
def relax_back(
    starts: NDArray[np.int32], columns: NDArray[np.int32], values: NDArray[np.float32], inverse: NDArray[np.float32],
    r: NDArray[np.float32], up_starts: NDArray[np.int32], up_columns: NDArray[np.int32],
    up_values: NDArray[np.float32], coarse: NDArray[np.float32], z: NDArray[np.float32],
) -> None:  # fmt: skip
    """Add what is interpolated from a coarse correction, and sweep backward."""
    for i in range(len(r)):
        z[i] += _row(up_starts, up_columns, up_values, i, coarse)
    for back in range(len(r)):
        i = len(r) - 1 - back
        z[i] += inverse[i] * (r[i] - _row(starts, columns, values, i, z))
