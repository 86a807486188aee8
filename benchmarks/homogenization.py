"""Effective stiffness and conductivity of a cell, against what else can be installed, and against memory bandwidth.

Usage: python -m benchmarks.homogenization [sizes...]           (`pip install muGrid pyamg` for the others)
       python -m benchmarks.homogenization elongated [size]   elongated voxels beside cubes, single beside double
"""

from __future__ import annotations

import importlib.util
import resource
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

import sppm_pipeline as sppm
from benchmarks.measure import table
from sppm_pipeline.features.flow.numerics.conduction import conductivity
from sppm_pipeline.features.stiffness.numerics.elasticity import Homogenized, stiffness
from sppm_pipeline.method.porosity.fractions import solid_fractions, stiff_share
from sppm_pipeline.method.stages.connect_mbdst import BoundedDegreeSubgraph
from sppm_pipeline.method.stages.field_gaussian import GaussianField
from sppm_pipeline.method.stages.sample_dart_throwing import DartThrowing
from sppm_pipeline.method.stages.sample_mirrored_faces import MirroredFaces
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.elastic.voigt import lame
from sppm_pipeline.services.grid import cell_centers
from sppm_pipeline.testing.plain_context import PlainContext, recipe_of

PASSES = 24
"""Numbers of single precision per node and component and iteration that have to be moved if nothing is kept."""


def cell(n: int) -> NDArray[np.float32]:
    """A cell with the paper's parameters, porosity one half, binary, (nz, ny, nx)."""
    recipe = recipe_of(
        MirroredFaces(edge=Length(2.0), total=66, share=0.5),
        DartThrowing(total=66),
        BoundedDegreeSubgraph(degree=(3, 5), mode="greedy"),
        GaussianField(omega=30.0, mu=30.0, level=0.25),
    )
    values = recipe.run(PlainContext(7)).sample(cell_centers(n), 2).T
    return (values < np.median(values)).astype(np.float32)


def bandwidth() -> float:
    """Bytes a second of one core, reading two vectors and writing a third."""
    a, b, c = (np.ones(1 << 25, np.float32) for _ in range(3))
    _, best, _ = _best(lambda: np.add(a, b, out=c), 7)
    return 3 * a.nbytes / best


def _best(call: Callable[[], Any], repeats: int) -> tuple[float, float, Any]:
    """Shortest wall and CPU seconds, and the result."""
    wall = cpu = float("inf")
    result = None
    for _ in range(repeats):
        started, used = time.perf_counter(), time.process_time()
        result = call()
        wall, cpu = min(wall, time.perf_counter() - started), min(cpu, time.process_time() - used)
    return wall, cpu, result


def measured(n: int, speed: float) -> list[list[Any]]:
    """Rows of the table for one size."""
    solid = cell(n)
    lam, mu = lame(solid, np.float32(0.3))
    repeats = 3 if n <= 64 else 1
    exact = np.diag(stiffness(lam, mu, tolerance=0.0, residual=1e-7, threads=2).stiffness)
    rows: list[list[Any]] = []

    def add(what: str, call: Callable[[], Any], runs: int, number: int = 4) -> None:
        wall, cpu, result = _best(call, runs)
        per = limit = its = ""
        if isinstance(result, Homogenized):
            its = sum(case.iterations for case in result.solved)
            per, limit = cpu / (its * n**3) * 1e9, PASSES * 3 * number / speed * 1e9
            result = np.diag(result.stiffness)
        error = np.abs(result / exact - 1).max() if isinstance(result, np.ndarray) else ""
        rows.append([f"{n}^3 {what}", wall, cpu, its, error, per, limit])

    stop: dict[str, Any] = {"tolerance": 0.0, "residual": 1e-6}
    for threads in (1, 2):
        add(f"stop at 1e-4 of C, {threads} threads", lambda: stiffness(lam, mu, threads=threads), repeats)  # noqa: B023
        add(f"residual 1e-6, {threads} threads", lambda: stiffness(lam, mu, threads=threads, **stop), repeats)  # noqa: B023
    add("residual 1e-6, double", lambda: stiffness(lam, mu, precision=np.float64, **stop), repeats, 8)
    add("conductivity, stop at 1e-4", lambda: conductivity(solid), repeats)
    if importlib.util.find_spec("muGrid"):
        from benchmarks.rivals.mugrid_homogenization import mugrid_stiffness

        # its single precision gives up above this residual
        a, b = (np.asfortranarray(values.T, np.float64) for values in (lam, mu))
        add("muGrid, residual 1e-6, double", lambda: mugrid_stiffness(a, b, 1e-6, np.float64), 1)
    if n <= 32 and importlib.util.find_spec("pyamg"):
        from benchmarks.rivals.assembled_amg import assembled_stiffness

        add("assembled, pyamg, residual 1e-6", lambda: assembled_stiffness(lam, mu, 1e-6), 1)
    return rows


def elongated(n: int) -> list[list[Any]]:
    """Presets cut into elongated voxels, and stretched: precision, iterations, time beside single and cubes."""
    rows: list[list[Any]] = []
    long, wide = round(n / 9 ** (1 / 3)), round(n / 3 ** (1 / 3))
    shapes = (
        ((n, n, n), (1, 1, 1)), ((3 * long, 3 * long, long), (1, 1, 3)), ((3 * wide, wide, wide), (1, 3, 3)),
        ((n, n, n), (3, 1, 1)), ((n, n, n), (3, 3, 1)),
    )  # fmt: skip
    for preset, porosity in (("paper", 0.5), ("paper", 0.7), ("stiff", 0.5), ("stiff", 0.7)):
        field = sppm.cell(preset, porosity=porosity, seed=1)
        cubes = 0.0
        for (nx, ny, nz), edges in shapes:
            share = stiff_share(
                solid_fractions(
                    lambda grid, start, stop: field.sample_zyx(grid, start, stop),  # noqa: B023
                    (nx, ny, nz), (float(nx), float(ny), float(nz)),
                )
            )  # fmt: skip
            lam, mu = lame(np.asarray(share, np.float32), np.float32(0.3))
            _, single, found = _best(lambda: stiffness(lam, mu, edges), 2)  # noqa: B023
            _, double, _ = _best(lambda: stiffness(lam, mu, edges, precision=np.float64), 2)  # noqa: B023
            cubes = cubes or single / share.size
            rows.append([
                f"{preset} {porosity}, {nx} x {ny} x {nz}", ":".join(map(str, edges)), found.precision,
                sum(case.iterations for case in found.solved), 1e6 * single / share.size, double / single,
                single / share.size / cubes,
            ])  # fmt: skip
    return rows


def main() -> None:
    if sys.argv[1:2] == ["elongated"]:
        columns = ["cell, voxels", "edges", "precision", "iterations", "CPU us/voxel", "double/single", "over cubes"]
        table("elongated voxels", columns, elongated(int(sys.argv[2]) if len(sys.argv) > 2 else 48))
        return
    sizes = [int(word) for word in sys.argv[1:]] or [32, 64]
    speed = bandwidth()
    print(f"memory: {speed / 1e9:.1f} GB/s for one thread (a + b -> c)")
    for missing in ("muGrid", "pyamg"):
        if not importlib.util.find_spec(missing):
            print(f"{missing} is not installed: one rival less")
    small = lame(cell(8), np.float32(0.3))
    stiffness(*small)
    stiffness(*small, precision=np.float64)
    table(
        "six load cases (three for conductivity)",
        ["what", "wall s", "CPU s", "iterations", "error", "CPU ns/voxel/it", "bandwidth limit"],
        [row for n in sizes for row in measured(n, speed)],
    )
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")


if __name__ == "__main__":
    main()
