"""Crushing of voxel bodies: speed, memory and threads of the march.

    python -m benchmarks.crushing speed [VOXELS]     # a gyroid of 2 x 2 x 2 cells to 60 %, 64 voxels along its edge
    python -m benchmarks.crushing threads [VOXELS]   # the same to 3 % with one and two threads, and the same bytes
    python -m benchmarks.crushing plateau VOXELS RATE [VOXELS RATE ...]  # its plateau stress, resolution and rate

The same voxels in CalculiX: `benchmarks.calculix`.
"""

from __future__ import annotations

import hashlib
import resource
import sys
import time

import numpy as np
from numpy.typing import NDArray
from sppm_crushing.numerics.body import body_of
from sppm_crushing.numerics.march import Load, March
from sppm_crushing.numerics.material import Material

SOLID = Material(1.0, 0.35, ((0.0, 0.02), (1.0, 0.03)))


def gyroid(n: int, cells: int) -> NDArray[np.uint8]:
    """Whole voxels of a gyroid sheet that fills 30 %, (n, n, n)."""
    c = 2 * np.pi * cells * (np.arange(n) + 0.5) / n
    z, y, x = np.meshgrid(c, c, c, indexing="ij")
    field = np.abs(np.sin(x) * np.cos(y) + np.sin(y) * np.cos(z) + np.sin(z) * np.cos(x))
    return np.asarray(field < np.quantile(field, 0.3)).astype(np.uint8)


def speed(n: int) -> None:
    """Processor time, element steps a second and a core, and memory."""
    body = body_of(gyroid(n, 2))
    March(body_of(gyroid(8, 1)), (SOLID,), Load(0.05, 0.05)).to(1)  # compiles
    started = time.process_time()
    march = March(body, (SOLID,), Load(0.6, 0.01))
    march.to(0.6)
    seconds = time.process_time() - started
    history = march.history()
    stress = history.top / n**2
    within = (history.strain > 0.2) & (history.strain < 0.4)
    print(f"{len(body.corners)} elements, {march.steps} steps: {seconds:.1f} CPU-s,")
    print(f"{len(body.corners) * march.steps / seconds / 1e6:.2f} M element steps/s,", end=" ")
    print(f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.3f} GB, plateau {stress[within].mean():.3e}")
    print({name: round(float(share), 5) for name, share in march.shares().items()})


def plateau(n: int, rate: float) -> None:
    """Plateau stress, processor time and memory of the gyroid on so many voxels."""
    body = body_of(gyroid(n, 2))
    started = time.process_time()
    march = March(body, (SOLID,), Load(0.6, rate))
    march.to(0.6)
    history = march.history()
    stress = (history.top + history.bottom) / (2 * n**2)
    mean = stress[(history.strain >= 0.2) & (history.strain <= 0.4)].mean()
    print(
        f"{n} voxels, rate {rate}: plateau {mean:.4e}, {time.process_time() - started:.1f} CPU-s, {march.steps} steps"
    )


def threads(n: int) -> None:
    """Wall time and digest with one, two and three threads."""
    body = body_of(gyroid(n, 2))
    for count in (1, 2, 3):
        march = March(body, (SOLID,), Load(0.03, 0.01), count)
        march.to(0.001)
        started, busy = time.perf_counter(), time.process_time()
        march.to(0.03)
        digest = hashlib.sha256(march.x.tobytes()).hexdigest()[:12]
        wall, cpu = time.perf_counter() - started, time.process_time() - busy
        print(f"{count} threads: {wall:.1f} s, {cpu:.1f} CPU-s, {digest}")
        march.close()


if __name__ == "__main__":
    what, *more = sys.argv[1:] or ["speed"]
    if what == "plateau":
        for voxels, speed_of_plate in zip(more[::2], more[1::2], strict=True):
            plateau(int(voxels), float(speed_of_plate))
    else:
        {"speed": speed, "threads": threads}[what](int(more[0]) if more else 64)
