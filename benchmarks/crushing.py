"""Crushing of voxel bodies: speed, memory and threads of the march, and the same voxels in CalculiX.

    python -m benchmarks.crushing speed [VOXELS]     # a gyroid of 2 x 2 x 2 cells to 60 %, 64 voxels along its edge
    python -m benchmarks.crushing threads [VOXELS]   # the same to 3 % with one and two threads, and the same bytes
    python -m benchmarks.crushing plateau VOXELS RATE [VOXELS RATE ...]  # its plateau stress, resolution and rate
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

from sppm_pipeline.numerics.crushing.body import Body, body_of
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


def calculix(folder: Path) -> None:
    """The curves of the same voxels in CalculiX, which knows nothing of walls that meet, beside ours with and without.

    C3D8 is integrated fully and too stiff where it flows; C3D8I has incompatible modes.
    """
    n = 16
    body = body_of(gyroid(n, 1))
    strains = np.array([0.005, 0.01, 0.015, 0.02, 0.03, 0.05, 0.1, 0.125, 0.15, 0.175, 0.2, 0.22, 0.24])
    columns = {kind: _in_calculix(body, kind, folder / kind, strains) for kind in ("C3D8", "C3D8I")}
    for name, one in {"ours": body, "ours without contact": body._replace(carried=np.zeros_like(body.carried))}.items():
        march = March(one, (SOLID,), Load(0.25, 0.005))
        march.to(0.25)
        history = march.history()
        columns[name] = np.interp(strains, history.strain, 0.5 * (history.top + history.bottom)) / n**2
    print(", ".join(["strain", *columns]))
    for at, *stresses in zip(strains, *columns.values(), strict=True):
        print(f"{at:.4f}", *(f"{stress:.6e}" for stress in stresses))


def _in_calculix(body: Body, kind: str, folder: Path, strains: NDArray[np.float64]) -> NDArray[np.float64]:
    """Stress at some strains, of elements of a kind."""
    n = body.shape[2]
    # our corner a is at the low side where a bit is set; CalculiX goes around the bottom, then the top
    order = [7, 6, 4, 5, 3, 2, 0, 1]
    lines = ["*NODE, NSET=ALL"]
    lines += [f"{i + 1}, {x}., {y}., {z}." for i, (x, y, z) in enumerate(body.nodes)]
    lines += [f"*ELEMENT, TYPE={kind}, ELSET=SOLID"]
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
    rows, at = [(0.0, 0.0)], 0.0
    for line in (folder / "cell.dat").read_text(encoding="ascii").splitlines():
        words = line.split()
        if "time" in words:
            at = float(words[-1])
        elif len(words) == 3:
            rows.append((0.25 * at, -float(words[2]) / n**2))
    return np.interp(strains, *np.array(rows).T)


if __name__ == "__main__":
    what, *more = sys.argv[1:] or ["speed"]
    if what == "calculix":
        calculix(Path(more[0]))
    elif what == "plateau":
        for voxels, speed_of_plate in zip(more[::2], more[1::2], strict=True):
            plateau(int(voxels), float(speed_of_plate))
    else:
        {"speed": speed, "threads": threads}[what](int(more[0]) if more else 64)
