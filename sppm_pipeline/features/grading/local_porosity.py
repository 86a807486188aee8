"""Local porosity on a lattice: targets of cells, samples of single cells, and means in a moving window."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.features.grading.numerics.local_level import RUN, CellCodes, Sampled, runs_along_x, void_and_slope
from sppm_pipeline.method.fields.kernel_sum import KernelSum
from sppm_pipeline.method.fields.scalar_field import ScalarField, WrappedField
from sppm_pipeline.method.fields.tiling import Tiling
from sppm_pipeline.method.nouns.maps import Grading
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.services.arrays import F32, F64, I32, I64, U8, Bools
from sppm_pipeline.services.grid import Grid, cell_centers
from sppm_pipeline.services.threads import ordered_map

Cells = list[tuple[int, int, int]]

_PLACES, _WEIGHTS = (0.3399810435848563, 0.8611363115940526), (0.6521451548625461, 0.3478548451374538)
PLACES = np.array([1 - _PLACES[1], 1 - _PLACES[0], 1 + _PLACES[0], 1 + _PLACES[1]]) / 2
WEIGHTS = np.array([_WEIGHTS[1], _WEIGHTS[0], _WEIGHTS[0], _WEIGHTS[1]]) / 2
"""Points along a cell edge and their weights for the mean of a map over a cell: those of Gauss, by
which means of smooth maps are right to 1 in 100 000, and those of steps between cells exactly."""

MIN_SHARE = 0.25
"""A cell of which less lies in the part gets no level of its own, but one that continues those around it."""

BLOCKS = 8
"""Blocks along a cell edge."""

WINDOW = 0.5
"""Standard deviation of the Gaussian window, cell sizes."""


def cell_means(
    grading: Grading, name: str, edge: float, origin: tuple[float, float, float], cells: NDArray[np.integer]
) -> F64:
    """Means (m,) of a map over cells (m, 3) of an edge, mm, of the lattice whose cell (0, 0, 0) begins at `origin`."""
    cells = np.asarray(cells, np.int64)
    key = (name, edge, origin, cells.tobytes())
    kept = _MEANS.get(grading)
    if kept is None or kept[0] != key:
        # Gauss-Legendre quadrature of four points along each axis
        inner = np.stack(np.meshgrid(PLACES, PLACES, PLACES, indexing="ij"), -1).reshape(-1, 3)
        weights = np.einsum("i,j,k->ijk", WEIGHTS, WEIGHTS, WEIGHTS).ravel()
        values, here = np.empty(len(cells)), grading.in_cells(edge, origin)[name]
        for begin in range(0, len(cells), CELLS_AT_A_TIME):  # there may be a hundred thousand
            some = slice(begin, begin + CELLS_AT_A_TIME)
            points = (cells[some, None] + inner).reshape(-1, 3) * edge + np.array(origin)
            values[some] = here.at(points).reshape(-1, len(inner)) @ weights
        kept = _MEANS[grading] = key, values
    return kept[1].copy()


CELLS_AT_A_TIME = 4096
"""Cells whose means are taken together."""

_MEANS: WeakKeyDictionary[Grading, tuple[tuple[object, ...], F64]] = WeakKeyDictionary()
"""The last means: consecutive stages need the same ones, and distances from meshes are slow."""

ALONE = 2**20
"""Samples up to which one thread is faster than two."""

HALF_RANGE = 4.0
"""Range of ln G that is resolved on either side of ln C. Not sensitive: the bounds of a level lie within 1.7 of
the usual ln 0.25, and the range is divided into 65 532 steps."""

RAMP = 1.0
"""Width of the ramp of ln G by which samples near the level count: of those tried on cells of porosities from 0.3 to
0.6 the one with the least error at 32 to 48 samples along an edge."""


class Places(NamedTuple):
    """Cells, the share of each that lies in the part, and bits of the samples inside of those that are not whole."""

    cells: Cells
    shares: F64
    inside: dict[tuple[int, int, int], U8]


class LatticeCells:
    """The cells of a field, or those of a part's field that lie in the part, and samples of one at a time, `n` along
    its edge.

    A `Part` stands for its field, seen where the part is. `only` are the cells to look at, all by default; `places` is
    that attribute of the cells of another field on this lattice and in this part, which are the same. `cells` are
    those that hold something, and of which enough lies in the part: `shares` (m,) of each.
    """

    def __init__(
        self, field: ScalarField, n: int, threads: int = 1, only: Cells | None = None, places: Places | None = None
    ) -> None:
        self.n, self.threads = n, threads
        self.base = field.base if isinstance(field, Part) else field
        self.places = self._places(field, only) if places is None else places
        self.cells, self.shares, self._inside = self.places

    def _places(self, field: ScalarField, only: Cells | None) -> Places:
        filled, inside = filled_cells(self.base), dict[tuple[int, int, int], U8]()
        if only is not None:
            chosen = np.zeros_like(filled)
            chosen[tuple(np.array(only).T)] = True
            filled &= chosen
        share = filled.astype(np.float64)
        if isinstance(field, Part):
            self._see(field, share, inside, all_layers=only is None)
        cells = [(int(i), int(j), int(k)) for i, j, k in np.argwhere(share >= MIN_SHARE)]
        return Places(cells, share[share >= MIN_SHARE], {cell: inside[cell] for cell in cells if cell in inside})

    def _see(self, part: Part, share: F64, inside: dict[tuple[int, int, int], U8], *, all_layers: bool) -> None:
        """Set the share of each cell, where it is not 0, to that in the part; keep bits of cells that are not whole."""
        n, (nx, ny, _) = self.n, self.base.cells
        grid, k, layers = cell_centers(n, self.base.cells), -1, np.zeros((0, 0, 0, 0, 0), bool)
        # layer by layer of all cells; cell by cell pays for a few
        some: Cells = [(i, j, k) for i, j, k in np.argwhere(share > 0).tolist()]
        for cell in sorted(some, key=lambda cell: cell[2]):
            if not all_layers:
                own = part.inside_zyx(self.grid(cell), 0, n).view(bool)
            else:
                if cell[2] != k:
                    k = cell[2]
                    layers = part.inside_zyx(grid, k * n, (k + 1) * n).view(bool).reshape(n, ny, n, nx, n)
                own = np.ascontiguousarray(layers[:, cell[1], :, cell[0]])
            share[cell] = np.count_nonzero(own) / n**3
            if 0 < share[cell] < 1:
                inside[cell] = np.packbits(own)

    def grid(self, cell: tuple[int, int, int], count: int = 1) -> Grid:
        """Centers of the voxels of one cell, or of several along x that begin with it."""
        h = 1.0 / self.n
        x, y, z = (c + h / 2 for c in cell)
        return Grid((x, y, z), (h,) * 3, (count * self.n, self.n, self.n))

    def _threads_for(self, grid: Grid) -> int:
        return self.threads if math.prod(grid.shape) > ALONE else 1

    def inside(self, cell: tuple[int, int, int]) -> Bools | None:
        """Which samples of a cell lie in the part, (n, n, n) indexed z, y, x; None for all."""
        bits = self._inside.get(cell)
        if bits is None:
            return None
        return np.unpackbits(bits, count=self.n**3).reshape((self.n,) * 3).view(np.bool_)

    def _rows_inside(self, run: Sequence[tuple[int, int, int]]) -> I32 | None:
        """For each row of a run the first sample in the part and the one after the last, (n, n, 2); None for all."""
        parts = [self.inside(cell) for cell in run]
        if all(part is None for part in parts):
            return None
        low = np.full((self.n, self.n), len(run) * self.n, np.int32)
        high = np.zeros((self.n, self.n), np.int32)
        for number, part in enumerate(parts):
            begin = number * self.n
            if part is None:
                np.minimum(low, begin, out=low)
                high[:] = begin + self.n
                continue
            some = part.any(2)
            low[some] = np.minimum(low, begin + part.argmax(2))[some]
            high[some] = (begin + self.n - part[:, :, ::-1].argmax(2))[some]
        return np.stack([np.minimum(low, high), high], -1)

    def values(self, run: Sequence[tuple[int, int, int]]) -> F32:
        """Values of cells that follow each other along x, to compare with a level: ln G of a sum G of kernels, or the
        field, (n, n, n len(run)) indexed z, y, x. In rows before the first and beyond the last sample in the part it
        may be anything.
        """
        grid = self.grid(run[0], len(run))
        if isinstance(self.base, KernelSum) and self.base.additive:
            sums = self.base.sums(grid, self._threads_for(grid), self._rows_inside(run)).T
            # ln G is compared with ln C: near the surface it is linear in the distance for pores of any size
            np.maximum(sums, np.float32(1e-9), out=sums)
            return np.log(sums, out=sums)
        return self.base.sample_zyx(grid, 0, self.n, self._threads_for(grid))

    def sampled(self, run: Sequence[tuple[int, int, int]]) -> Iterator[Sampled]:
        """`values` of each cell of a run, and which of them lie in the part."""
        values = self.values(run)
        for number, cell in enumerate(run):
            yield values[:, :, number * self.n : (number + 1) * self.n], self.inside(cell)

    @property
    def across(self) -> int:
        """Threads that look at cells at once, where cells are too small for several threads each."""
        return 1 if RUN * self.n**3 > ALONE else self.threads

    def porosities(self, cells: Cells, progress: Callable[[int], None]) -> F64:
        """Porosities of some cells of a sum of kernels, or of that of them which lies in the part.

        Samples near the level count in part, which takes a third of the samples that counting them whole would.
        """
        level = self.base.sum_level
        assert level is not None
        # the same comparison as in tuning, with nothing kept, since each cell is looked at once
        codes = CellCodes(self.sampled, math.log(level), HALF_RANGE, 0)
        control, runs = np.full(self.base.cells, math.log(level)), runs_along_x(cells, RUN)
        found = dict[tuple[int, int, int], float]()

        def shares(run: Cells) -> list[tuple[float, float]]:
            return void_and_slope(codes, control, run, RAMP)

        for run, pairs in zip(runs, ordered_map(shares, runs, self.across), strict=True):
            found.update(zip(run, (share for share, _ in pairs), strict=True))
            progress(len(found))
        return np.array([found[cell] for cell in cells])

    def counted(self) -> F64:
        """Share of void in each of the cells, or in that of it which lies in the part, by whole samples, (m,)."""
        found = dict[tuple[int, int, int], float]()
        # cells that follow each other along x are sampled together, as long rows cost less than short ones
        for run in runs_along_x(self.cells, len(self.cells)):
            grid = self.grid(run[0], len(run))
            void = self.base.solid_zyx(grid, 0, self.n, self._threads_for(grid)) == 0
            for number, cell in enumerate(run):
                own, inside = void[:, :, number * self.n : (number + 1) * self.n], self.inside(cell)
                found[cell] = float(own.mean() if inside is None else own[inside].mean())
        return np.array([found[cell] for cell in self.cells])


def filled_cells(field: ScalarField) -> Bools:
    """Which cells of a field hold something with all that reaches into it, (nx, ny, nz)."""
    cells, inner = tuple(field.cells), field
    # levels and parts hold what their base holds, on the same lattice
    while isinstance(inner, WrappedField) and tuple(inner.base.cells) == cells:
        inner = inner.base
    if isinstance(inner, Tiling) and tuple(inner.cells) == cells:
        return inner.arrays.surrounded().interior >= 0
    return np.ones(cells, bool)


def error_summary(errors: Sequence[float] | F64) -> dict[str, float]:
    """Bias, rms, 95th percentile of the size, and the largest size of errors."""
    e = np.asarray(errors, np.float64)
    size = np.abs(e)
    return {
        "error_mean": float(e.mean()),
        "error_rms": float(np.sqrt((e**2).mean())),
        "error_p95": float(np.quantile(size, 0.95)),
        "error_max": float(size.max()),
    }


def block_counts(void: Bools, inside: Bools | None, size: int) -> tuple[I64, I64]:
    """Voxels that are void and inside, and all that are inside, in blocks of `size` along each axis.

    Masks are (nz, ny, nx), multiples of `size`; `inside` is None for all.
    """
    nz, ny, nx = (n // size for n in void.shape)

    def summed(mask: Bools) -> I64:
        blocks = mask.reshape(nz, size, ny, size, nx, size)
        found: I64 = blocks.sum((1, 3, 5), dtype=np.int64)
        return found

    if inside is None:
        return summed(void), np.full((nz, ny, nx), size**3, np.int64)
    return summed(void & inside), summed(inside)


def smoothed_means(values: NDArray[np.floating], weights: NDArray[np.floating]) -> F64:
    """Weighted means of block values (nx, ny, nz), `BLOCKS` along a cell edge, in a Gaussian window around each block;
    NaN where nothing has a weight. Beyond the ends there is nothing.
    """
    from scipy.ndimage import gaussian_filter

    def smoothed(of: NDArray[np.floating]) -> F64:
        found: F64 = gaussian_filter(of.astype(np.float64), WINDOW * BLOCKS, mode="constant", truncate=3.0)
        return found

    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(weights > 0, smoothed(values * weights) / smoothed(weights), np.nan)
