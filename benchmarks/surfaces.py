"""Surface extractors inside one process, on the same stochastic field: voxels a second and core.

Usage: python -m benchmarks.surfaces [N ...]

The field is that of the paper's cell (148 pores, 590 tunnels) on N^3 samples (128 and 256). scikit-image is compared;
manifold3d's extractor works on a lattice of its own with two points for each voxel here.
"""

from __future__ import annotations

import sys

import numpy as np
from skimage.measure import marching_cubes as lewiner

from benchmarks.kernels import paper_cell
from benchmarks.measure import repeat_in_process, table
from sppm_pipeline.features.surface.solids import check_solid, run_boolean, run_level_set
from sppm_pipeline.method.kernels.splat import add_kernels
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.mesh.closing import capped_marching_cubes
from sppm_pipeline.services.mesh.marching_cubes import marching_cubes


def field(n: int) -> np.ndarray:
    """G - C on n nodes along each axis of a cell, both ends included."""
    h = 1 / (n - 1)
    grid = Grid((0.0, 0.0, 0.0), (h, h, h), (n, n, n))
    values = np.full((n, n, n), -0.35, np.float32)
    add_kernels(values, grid, paper_cell())
    return values


def main() -> None:
    sizes = [int(v) for v in sys.argv[1:]] or [128, 256]
    for n in sizes:
        values = field(n)
        faces = len(marching_cubes(values)[1])
        rows = []
        for name, call, runs in (
            ("marching cubes", lambda v=values: marching_cubes(v), 7),
            ("the same, capped, in slabs", lambda v=values: capped_marching_cubes(v), 7),
            ("scikit-image", lambda v=values: lewiner(v, 0.0, gradient_direction="ascent"), 3),
        ):
            wall, cpu = repeat_in_process(call, runs)
            rows.append([name, wall * 1e3, cpu * 1e3, n**3 / cpu / 1e6])
        rows.append(["ratio of scikit-image to ours, capped", "", rows[2][2] / rows[1][2], ""])
        table(
            f"{n}^3 samples, {faces} triangles, {(values < 0).mean():.0%} solid",
            ["way", "wall ms", "CPU ms", "Mvoxel/s"],
            rows,
        )
    n = 129
    values = field(n)
    wall, cpu = repeat_in_process(lambda: run_level_set(values, (0.0,) * 3, 2 / (n - 1)), 1)
    mesh = capped_marching_cubes(values[::2, ::2, ::2].copy())
    check_solid(*mesh, "the cell")
    shifted = mesh[0] + [7.3, 5.1, 3.7], mesh[1]
    _, both = repeat_in_process(lambda: run_boolean(*mesh, *shifted, "intersection"), 1)
    lattice = ((n + 1) // 2) ** 3
    table(
        "manifold3d",
        ["what", "CPU s", ""],
        [
            [f"level set, {lattice} cubes of the lattice", cpu, f"{cpu / (2 * lattice) * 1e6:.2f} us a value"],
            [f"intersection of {2 * len(mesh[1])} triangles", both, f"{both / (2 * len(mesh[1])) * 1e6:.2f} us each"],
        ],
    )


if __name__ == "__main__":
    main()
