"""Slice a billion voxels of porous solid inside 1.5 GiB of address space.

    python tests/endurance/gigavoxel.py [VOXELS_ALONG_AN_EDGE]

1000 voxels along each edge of a cube of 20 x 20 x 20 cells, floating islands removed, layers written as PNG. The
process may reserve 1.5 GiB and keep 600 MiB resident. tests/engine/cli/test_address_space.py slices twenty million.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

ADDRESS_SPACE = 3 * 2**29
RESIDENT = 600 * 2**20

CUBE = """sppm: 1
name: cube
seed: 1
recipes:
  cell:
    - {{stage: sample.mirrored_faces, total: 60, share: 0.5}}
    - {{stage: sample.dart_throwing, total: 60}}
    - {{stage: connect.mbdst, mode: greedy}}
    - {{stage: field.gaussian, pore_radius: 0.11, tunnel_radius: 0.04}}
pipeline:
  - {{stage: tileset.wang_3color, recipe: cell, porosity: 0.6, resolution: 16, tolerance: 0.02}}
  - {{stage: tile.wang_3color, cells: [{cells}, {cells}, {cells}], cell: 2 mm}}
  - {{stage: slice.field, resolution: {resolution}}}
  - {{stage: write.png, sheet: 0}}
"""


def slice_cube(folder: Path, cells: int, resolution: int, address_space: int = ADDRESS_SPACE) -> dict[str, float]:
    """Run in a process with limited address space; voxels, layers, resident bytes, seconds of processor."""
    (folder / "cube.yaml").write_text(CUBE.format(cells=cells, resolution=resolution), encoding="utf-8")
    command = [
        sys.executable,
        "-m",
        "sppm_pipeline.engine.cli.main",
        "run",
        "cube.yaml",
        "-q",
        "--no-plugins",
        "--threads",
        "1",
    ]

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (address_space, address_space))

    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [*command, "-o", "out", "--json"], cwd=folder, preexec_fn=limit, capture_output=True, text=True, check=False,
        env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
    )  # fmt: skip
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        raise RuntimeError(f"exit {done.returncode}: {done.stderr}")
    record = json.loads(done.stdout)
    layers = [path for path in (folder / "out" / "slices").iterdir() if path.suffix == ".png"]
    return {
        "voxels": float((cells * resolution) ** 3),
        "layers": len(layers),
        "resident": record["peak_memory_mb"] * 1e6,
        "seconds": after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime,
    }


def main(arguments: list[str]) -> int:
    along = int(arguments[0]) if arguments else 1000
    resolution = 50
    with tempfile.TemporaryDirectory() as folder:
        found = slice_cube(Path(folder), along // resolution, resolution)
    print(
        f"{found['voxels']:.3g} voxels in {found['layers']} layers: {found['resident'] / 2**20:.0f} MiB resident, "
        f"{found['seconds']:.1f} s of processor, {found['seconds'] / found['voxels'] * 1e9:.2f} ns a voxel"
    )
    good = found["layers"] == along and found["resident"] <= RESIDENT
    print(
        "within" if good else "OUTSIDE",
        f"{ADDRESS_SPACE / 2**30:g} GiB of address space, {RESIDENT >> 20} MiB resident",
    )
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
