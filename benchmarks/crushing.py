"""Crushing of voxel bodies: speed, memory and threads of the march, and the same voxels in CalculiX.

    python -m benchmarks.crushing speed [VOXELS]     # a gyroid of 2 x 2 x 2 cells to 60 %, 64 voxels along its edge
    python -m benchmarks.crushing threads [VOXELS]   # the same to 3 % with one and two threads, and the same bytes
    python -m benchmarks.crushing calculix FOLDER    # one cell of 16 voxels to 25 %; needs ccx (calculix-ccx)

The last writes the curve that `tests/numerics/crushing/test_calculix.py` holds.
"""

from __future__ import annotations

import hashlib
import resource
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.crushing.body import body_of
from sppm_pipeline.numerics.crushing.march import Load, March
from sppm_pipeline.numerics.crushing.material import Material

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


def calculix(folder: Path) -> None:
    """The curve of the same voxels as C3D8 in CalculiX, beside ours."""
    n = 16
    body = body_of(gyroid(n, 1))
    # our corner a is at the low side where a bit is set; CalculiX goes around the bottom, then the top
    order = [7, 6, 4, 5, 3, 2, 0, 1]
    lines = ["*NODE, NSET=ALL"]
    lines += [f"{i + 1}, {x}., {y}., {z}." for i, (x, y, z) in enumerate(body.nodes)]
    lines += ["*ELEMENT, TYPE=C3D8, ELSET=SOLID"]
    lines += [f"{i + 1}, " + ", ".join(str(k + 1) for k in row[order]) for i, row in enumerate(body.corners)]
    for name, level in (("BOTTOM", 0), ("TOP", n)):
        lines += [f"*NSET, NSET={name}", *(f"{i + 1}," for i in np.flatnonzero(body.nodes[:, 2] == level))]
    bottom = np.flatnonzero(body.nodes[:, 2] == 0)
    first = bottom[0]
    far = bottom[np.argmax(np.abs(body.nodes[bottom, 0] - body.nodes[first, 0]))]
    lines += ["*MATERIAL, NAME=M", "*ELASTIC", f"{SOLID.young}, {SOLID.poisson}", "*PLASTIC"]
    lines += [f"{stress}, {strain}" for strain, stress in SOLID.yield_stress]
    lines += ["*SOLID SECTION, ELSET=SOLID, MATERIAL=M", "*BOUNDARY", "BOTTOM, 3, 3, 0.", f"{first + 1}, 1, 2, 0.",
              f"{far + 1}, 2, 2, 0.", "*STEP, NLGEOM, INC=1000", "*STATIC", "0.02, 1., 1e-6, 0.02", "*BOUNDARY",
              f"TOP, 3, 3, {-0.25 * n}", "*NODE PRINT, NSET=TOP, TOTALS=ONLY", "RF", "*END STEP"]  # fmt: skip
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "cell.inp").write_text("\n".join(lines) + "\n", encoding="ascii")
    subprocess.run(["ccx", "cell"], cwd=folder, check=True, stdout=subprocess.DEVNULL)
    rows, at = [], 0.0
    for line in (folder / "cell.dat").read_text(encoding="ascii").splitlines():
        words = line.split()
        if "time" in words:
            at = float(words[-1])
        elif len(words) == 3:
            rows.append((0.25 * at, -float(words[2]) / n**2))
    march = March(body, (SOLID,), Load(0.25, 0.005))
    march.to(0.25)
    history = march.history()
    print("strain, CalculiX, ours")
    for strain, stress in rows:
        ours = np.interp(strain, history.strain, 0.5 * (history.top + history.bottom)) / n**2
        print(f"{strain:.4f}, {stress:.6e}, {ours:.6e}")


if __name__ == "__main__":
    what, *more = sys.argv[1:] or ["speed"]
    if what == "calculix":
        calculix(Path(more[0]))
    else:
        {"speed": speed, "threads": threads}[what](int(more[0]) if more else 64)
