"""Fine grids interpolated from coarse sums of kernels, against the sum at every sample in the same run; one thread.

Usage: python -m benchmarks.fine_grids [PARTS]
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from itertools import pairwise

import numpy as np

from benchmarks.measure import table
from sppm_pipeline.method.fields.kernel_sum import KernelSum
from sppm_pipeline.method.fields.microstructure import Microstructure
from sppm_pipeline.method.fields.tiling import Tiling
from sppm_pipeline.method.stages.connect_mbdst import BoundedDegreeSubgraph
from sppm_pipeline.method.stages.field_gaussian import GaussianField
from sppm_pipeline.method.stages.sample_dart_throwing import DartThrowing
from sppm_pipeline.method.stages.sample_mirrored_faces import MirroredFaces
from sppm_pipeline.method.stages.tile_fresh import FreshTiling
from sppm_pipeline.method.stages.tile_wang_3color import WangTiling
from sppm_pipeline.method.stages.tileset_wang_3color import WangTileSet
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.grid import Grid, cell_centers
from sppm_pipeline.testing.plain_context import PlainContext, recipe_of

SLAB = 2**22


def recipe(total: int, pore: float, tunnel: float):
    return recipe_of(
        MirroredFaces(total=total, share=0.5),
        DartThrowing(total=total),
        BoundedDegreeSubgraph(degree=(3, 5), mode="greedy"),
        GaussianField(pore_radius=Length(pore), tunnel_radius=Length(tunnel)),
    )


def paper_cell(seed: int) -> Microstructure:
    """One periodic cell of thin tunnels, the hardest to resolve."""
    return recipe(75, 0.1075, 0.0231).run(PlainContext(seed))


def box() -> Tiling:
    """30 x 30 x 20 mm of the README's recipe in cells of 5 mm, 27 tiles."""
    tiles = WangTileSet(porosity=0.7).run(PlainContext(1), recipe(68, 0.11, 0.03))
    return WangTiling(cells=(6, 6, 4), cell=Length(5, "mm")).run(PlainContext(2), tiles, None)


def pixels(field: KernelSum, x: float, y: float, z: float) -> Grid:
    """Pixels of x by y mm and layers of z mm over a whole tiling."""
    h = tuple(v / field.physical_edge() for v in (x, y, z))
    nx, ny, nz = (round(c / v) for c, v in zip(field.cells, h, strict=True))
    return Grid((h[0] / 2, h[1] / 2, h[2] / 2), (h[0], h[1], h[2]), (nx, ny, nz))


def seconds(field: KernelSum, grid: Grid, layers: int | None = None) -> float:
    """Processor seconds for all layers, slab by slab, taken from as many as are asked for."""
    nx, ny, nz = grid.shape
    layers = min(nz, layers or nz)
    step = max(1, SLAB // (nx * ny))
    start = time.process_time()
    for first, last in pairwise([*range(0, layers, step), layers]):
        field.solid_layers(grid, first, last)
    return (time.process_time() - start) * nz / layers


def least(measure: Callable[[], float], times: int = 3) -> float:
    return min(measure() for _ in range(times))


def accuracy(parts: int) -> None:
    flips, shifts = [], []
    for seed in range(parts):
        for cell in (paper_cell(seed), recipe(68, 0.11, 0.03).run(PlainContext(seed))):
            grid = Grid((0.002, 0.003, 0.001), (1 / 190, 1 / 170, 1 / 200), (190, 170, 200))
            fine, exact = cell.solid(grid), cell.exactly().solid(grid)
            flips.append(float((fine != exact).mean()))
            shifts.append(float(fine.mean()) - float(exact.mean()))
    rows = []
    for number, name in enumerate(("tunnels of .0231", "tunnels of .03")):
        some, shift = flips[number::2], np.array(shifts[number::2])
        rows.append([name, parts, float(np.mean(some)), max(some), float(shift.mean()), float(np.abs(shift).max())])
    table("interpolated against summed", ["cells", "number", "flips", "most", "porosity", "most"], rows)


def main() -> None:
    accuracy(int(sys.argv[1]) if len(sys.argv) > 1 else 20)
    rows = []
    cell = paper_cell(0)
    for n in (192, 288, 384):
        grid = cell_centers(n)
        cell.solid(grid.layers(0, 8))
        direct = least(lambda: seconds(cell.exactly(), grid, n // 8), 2)  # noqa: B023
        fine = least(lambda: seconds(cell, grid))  # noqa: B023
        rows.append([f"one periodic cell, {n} an edge", n**3 / 1e6, fine, fine / n**3 * 1e9, direct / fine])
    tiles = box()
    fresh = FreshTiling(cells=(4, 4, 2), cell=Length(5, "mm")).run(PlainContext(3), recipe(68, 0.11, 0.03), None)
    for name, field in (("27 tiles", tiles), ("fresh cells", fresh)):
        for pitch in ((0.05, 0.05, 0.05), (0.047, 0.047, 0.047), (0.05, 0.05, 0.025), (0.019, 0.024, 0.05)):
            grid = pixels(field, *pitch)
            count = float(np.prod(grid.shape, dtype=float))
            direct = seconds(field.exactly(), Grid(*grid[:2], (grid.shape[0], min(300, grid.shape[1]), 40)))
            direct *= count / (grid.shape[0] * min(300, grid.shape[1]) * 40)
            first = seconds(field, grid)
            fine = least(lambda: seconds(field, grid), 2)  # noqa: B023
            what = f"{name}, {' x '.join(map(str, pitch))} mm"
            rows.append([what, count / 1e6, first, fine / count * 1e9, direct / first])
    table(
        "processor time (of tilings: the first time, patches included)",
        ["what", "Mvoxel", "CPU s", "ns/voxel later", "times faster"],
        rows,
    )


if __name__ == "__main__":
    main()
