"""The hot kernels inside one process: the field of a cell, spanning subgraphs, the tile set, marching cubes, PNG.

Usage: python -m benchmarks.kernels
"""

from __future__ import annotations

import numpy as np

from benchmarks.measure import repeat_in_process, table
from sppm_pipeline.method.connecting.bounded import spanning_subgraph
from sppm_pipeline.method.kernels.kernels import Kernels
from sppm_pipeline.method.kernels.splat import add_kernels
from sppm_pipeline.services.grid import cell_centers


def paper_cell() -> Kernels:
    """148 pores and 590 tunnels, the numbers of the paper's figure, omega = mu = 30 in the cell [-1, 1]^3."""
    rng = np.random.default_rng(0)
    pores = rng.random((148, 3))
    a = rng.integers(0, 148, 590)
    near = np.argsort(((pores[a][:, None] - pores[None]) ** 2).sum(-1), 1)[np.arange(590), rng.integers(1, 6, 590)]
    return Kernels(pores, np.full(148, 120.0), pores[a], pores[near], np.full(590, 60.0), "linear")


def obvious_field(kernels: Kernels, n: int) -> np.ndarray:
    """Every kernel on the whole grid."""
    axis = ((np.arange(n) + 0.5) / n).astype(np.float32)
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1)
    total = np.zeros((n, n, n), np.float32)
    for c, w in zip(kernels.centers, kernels.omega, strict=True):
        total += np.exp(-np.float32(w) * ((grid - c.astype(np.float32)) ** 2).sum(-1))
    for a, b, w in zip(kernels.starts, kernels.ends, kernels.mu, strict=True):
        a, b = a.astype(np.float32), b.astype(np.float32)
        t = np.clip(((grid - a) @ (b - a)) / ((b - a) @ (b - a)), 0, 1)
        total += np.exp(-np.float32(w) * np.sqrt(((grid - a - t[..., None] * (b - a)) ** 2).sum(-1)))
    return total


def main() -> None:
    kernels = paper_cell()
    rows = []
    for n in (64, 128):
        grid = cell_centers(n)
        wall, cpu = repeat_in_process(lambda: add_kernels(np.zeros((n, n, n), np.float32), grid, kernels))  # noqa: B023
        rows.append([f"field of 148 pores, 590 tunnels, {n}^3", wall * 1e3, cpu * 1e3, cpu / n**3 * 1e9])
    wall, cpu = repeat_in_process(lambda: obvious_field(kernels, 64), 1)
    rows.append(["  the obvious numpy way, 64^3", wall * 1e3, cpu * 1e3, cpu / 64**3 * 1e9])
    for n in (150, 500):
        points = np.random.default_rng(n).random((n, 3))
        for mode in ("greedy", "exact"):
            wall, cpu = repeat_in_process(lambda: spanning_subgraph(points, (3, 5), mode=mode), 3)  # noqa: B023
            rows.append([f"degree-bounded subgraph, n = {n}, {mode}", wall * 1e3, cpu * 1e3, ""])
    table("inside one process", ["what", "wall ms", "CPU ms", "CPU ns/voxel"], rows)


if __name__ == "__main__":
    main()
