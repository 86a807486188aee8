"""Checks before printing: nanoseconds a voxel of each pass, against labels of both phases in memory; flat memory.

Usage: python -m benchmarks.print_ready [voxels along an edge, 256]
"""

from __future__ import annotations

import resource
import subprocess
import sys

import numpy as np

from benchmarks.measure import repeat_in_process, table


def porous(nz: int, n: int) -> np.ndarray:
    """Five cells along an edge, porosity 0.58: the sign of waves of random direction."""
    rng = np.random.default_rng(3)
    waves = rng.standard_normal((60, 3))
    waves *= 2 * np.pi * 12 / np.linalg.norm(waves, axis=1)[:, None]
    phases = rng.uniform(0, 2 * np.pi, 60)
    axis = (np.arange(n) / n).astype(np.float32)
    solid = np.empty((nz, n, n), np.uint8)
    for k in range(nz):
        total = np.zeros((n, n), np.float32)
        for (x, y, z), phase in zip(waves.astype(np.float32), phases.astype(np.float32), strict=True):
            across, along = y * axis + z * np.float32(k / n) + phase, x * axis
            total += np.outer(np.cos(across), np.cos(along)) - np.outer(np.sin(across), np.sin(along))
        solid[k] = total > 0.2 * np.sqrt(30)
    return solid


def tracked(solid: np.ndarray) -> None:
    from sppm_pipeline.features.printing.numerics.tracker import Tracker, complement
    from sppm_pipeline.method.connectivity.runs import find_runs

    phases = Tracker("solid"), Tracker("void")
    for k in range(len(solid)):
        runs = find_runs(solid[k : k + 1])
        phases[0].add(runs, k)
        phases[1].add(complement(runs), k)
    for phase in phases:
        phase.finish(len(solid))


def scanned(solid: np.ndarray) -> None:
    from sppm_pipeline.features.printing.numerics.layers import PrintScan

    nz, ny, nx = solid.shape
    scan = PrintScan((nx, ny, nz), (1.0, 1.0), 1.0)
    for layer in solid:
        scan.add(layer)
    scan.finish()


def measured_throats(solid: np.ndarray) -> None:
    from sppm_pipeline.features.printing.numerics.openings import Throats

    throats = Throats(solid.shape[:0:-1], (1.0, 1.0, 1.0), [4 * 2 ** (i / 2) for i in range(5)])
    for layer in solid:
        throats.add(layer)
    throats.finish()


def measured_features(solid: np.ndarray) -> None:
    from sppm_pipeline.features.printing.numerics.openings import ThinFeatures

    thin = ThinFeatures(solid.shape[:0:-1], (1.0, 1.0, 1.0), 4.0, False)
    for layer in solid:
        thin.add(layer)
    thin.finish()


def labeled(solid: np.ndarray) -> None:
    from scipy import ndimage

    ndimage.label(solid)
    ndimage.label(1 - solid)


def peak(layers: int) -> float:
    """MB resident of a process that scans so many layers of 1920 x 1200 pixels, one after the other."""
    pattern = porous(8, 1200)
    wide = np.concatenate([pattern, pattern[:, :, :720]], 2)
    from sppm_pipeline.features.printing.numerics.layers import PrintScan

    scan = PrintScan((1920, 1200, layers), (1.0, 1.0), 1.0)
    for k in range(layers):
        scan.add(wide[abs(k % 14 - 7)])
    scan.finish()
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main(n: int) -> None:
    solid = porous(n, n)
    rows = []
    costs = {}
    for name, function in (
        ("half-stacks of both phases", tracked), ("the same, overhang, worst layers", scanned),
        ("throats at five levels, up to 16 voxels", measured_throats), ("thin features, 4 voxels", measured_features),
        ("labels of both phases (scipy)", labeled),
    ):  # fmt: skip
        costs[function] = repeat_in_process(lambda: function(solid), 3)[1] / n**3 * 1e9  # noqa: B023
        rows.append([name, costs[function], costs[labeled] / costs[tracked] if function is labeled else ""])
    table(f"{n}^3 voxels, porosity {1 - solid.mean():.2f}", ["pass", "CPU ns/voxel", "times half-stacks"], rows)
    peaks = [
        float(subprocess.check_output([sys.executable, "-m", "benchmarks.print_ready", "--peak", str(layers)]))
        for layers in (200, 400)
    ]
    table("resident", ["layers", "MB"], [[200, peaks[0]], [400, peaks[1]]])


if __name__ == "__main__":
    if sys.argv[1:2] == ["--peak"]:
        print(peak(int(sys.argv[2])))
    else:
        main(int(sys.argv[1]) if len(sys.argv) > 1 else 256)
