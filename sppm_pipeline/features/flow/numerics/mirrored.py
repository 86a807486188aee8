"""Conduction in a cell with its seven mirror images, solved on the cell alone."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.features.flow.numerics.conduction import (
    NO_FLUX,
    SCRATCH_ROWS,
    Conducted,
    ConductionLevel,
    largest_eigenvalue,
)
from sppm_pipeline.numerics import HeldBody, Solved


class HeldConductor(HeldBody):
    """Voxels of conductivities `k` (nz, ny, nx) between two sides, normal to `axis`, whose potentials are given, or
    between six such sides.
    """

    def __init__(
        self, k: NDArray[Any], edges: tuple[float, float, float], axis: int, dtype: np.dtype[Any],
        everywhere: bool = False,
    ) -> None:  # fmt: skip
        self.fixed = np.zeros((1, *(n + 1 for n in k.shape)), bool)
        for place in range(1, 4) if everywhere else (3 - axis,):
            np.moveaxis(self.fixed, place, 0)[[0, -1]] = True
        self.build(
            np.pad(k, (0, 1)), edges, lambda values, h: ConductionLevel(values, h, dtype),
            lambda _, h: largest_eigenvalue(h), lambda values, mean: mean(values), SCRATCH_ROWS,
        )  # fmt: skip


def mirrored_conductivity(
    k: NDArray[Any], edges: tuple[float, float, float] = (1.0, 1.0, 1.0), *, residual: float = 0.0,
    tolerance: float = 1e-4, iterations: int = 1000, precision: Any = np.float32, threads: int = 1,
) -> Conducted:  # fmt: skip
    """Effective conductivity of a cell and its mirror images at all sides, which repeat: an eighth of the voxels.

    Nothing flows through mirrors along a flow, and those across it have a constant potential; the tensor is diagonal.
    Parameters as for `conduction.conductivity`, of the cell alone.

    Raises
    ------
    ArithmeticError
        If the iteration fails in double precision, too.
    """
    dtype, scale, longest = np.dtype(precision), float(k.max()), max(edges)
    if not scale:
        return Conducted(np.zeros((3, 3)), (Solved(0, 0.0, 0.0, 0.0, True, True),) * 3, dtype.name)
    k = np.asarray(k / scale, dtype)
    h = (edges[0] / longest, edges[1] / longest, edges[2] / longest)
    mean, volume = float(k.mean(dtype=np.float64)), float(np.prod(k.shape) * np.prod(h))

    def case(axis: int) -> tuple[float, Solved]:
        body = HeldConductor(k, h, axis, dtype)
        line = np.arange(k.shape[2 - axis] + 1, dtype=dtype) * dtype.type(h[axis])
        linear = np.broadcast_to(np.expand_dims(line, [d for d in range(3) if d != 2 - axis]), body.fixed.shape)
        found = body.solve(
            np.zeros_like(linear), linear, linear, residual=residual or 1e-30, energy=tolerance, iterations=iterations,
            stored=volume * mean,
        )  # fmt: skip
        u = found.displacement
        return float(np.einsum("i,i", u.ravel(), body.forces(u).ravel(), dtype=np.float64)) / volume, found.solved

    try:
        with ThreadPoolExecutor(min(threads, 3)) as pool:
            found = list(pool.map(case, range(3)))
    except ArithmeticError:
        if dtype == np.float64:
            raise
        return mirrored_conductivity(
            k * scale, edges, residual=residual, tolerance=tolerance, iterations=iterations, precision=np.float64,
            threads=threads,
        )  # fmt: skip
    along = [value if value >= NO_FLUX * mean else 0.0 for value, _ in found]
    return Conducted(np.diag(along) * scale, tuple(solved for _, solved in found), dtype.name)
