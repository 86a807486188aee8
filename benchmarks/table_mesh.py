"""The paper's comparison of its two ways: a mesh of the assembly, and layers without a mesh; whole processes.

Usage: python -m benchmarks.table_mesh [MESH [VOXELS]]

27, 216 and 512 units of 32^3 voxels, from nothing to files. With MESH, a part of the reader's own is filled as well,
at VOXELS (32) along a cell edge: as layers, as a mesh from the field, and by a Boolean of two meshes.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from benchmarks.measure import Run, pipeline_command, run, table

CONFIGS = Path(__file__).parent.parent / "configs"
# the paper's own figures, on its machine: seconds and megabytes
PAPER = {
    27: {"mesh": (3.1, 95.0), "layers": (0.811, 1.48)},
    216: {"mesh": (54.0, 801.0), "layers": (1.955, 5.49)},
    512: {"mesh": (344.0, 1945.0), "layers": (3.274, 10.5)},
}
LAYERS = '  - {stage: slice.field, resolution: "${voxels}"}\n  - {stage: write.png, path: out/slices, sheet: 0}\n'
SURFACE = '  - {stage: extract.marching_cubes, resolution: "${voxels}"}\n  - {stage: write.mesh, path: out/part.ply}\n'
BOOLEAN = '  - {stage: fill.boolean, resolution: "${voxels}"}\n  - {stage: write.mesh, path: out/part.ply}\n'


def best(command: list[str], runs: int) -> Run:
    """The least of several runs after one that warms the caches, figure by figure."""
    run(command)
    return Run(*(min(values) for values in zip(*(run(command) for _ in range(runs)), strict=True)))


def measure(scratch: Path, name: str, config: str, runs: int, *parameters: str) -> tuple[Run, float]:
    """Time, memory and megabytes on disk of one way."""
    file, folder = scratch / f"{name}.yaml", scratch / name
    file.write_text(config)
    command = pipeline_command(file, folder)
    for parameter in parameters:
        command += ["-p", parameter]
    spent = best(command, runs)
    return spent, sum(f.stat().st_size for f in (folder / "out").rglob("*") if f.suffix in (".png", ".ply")) / 1e6


def assemblies(scratch: Path) -> None:
    """The paper's table."""
    config = (CONFIGS / "table_mesh_free.yaml").read_text().split("\nsweep:")[0]
    head = config.split("  - {stage: slice.field")[0].replace("params:\n", "params:\n  voxels: 32\n")
    rows = []
    for cells in (3, 6, 8):
        size, units = f"cells=[{cells}, {cells}, {cells}]", cells**3
        for way, tail in (("mesh", SURFACE), ("layers", LAYERS)):
            spent, stored = measure(scratch, f"{way}{units}", head + tail, 3, size)
            rows.append([units, way, *spent, stored, *PAPER[units][way]])
    table(
        "units of 32^3 voxels",
        ["units", "way", "wall s", "CPU s", "peak MB", "files MB", "paper s", "paper MB"],
        rows,
    )


def part(scratch: Path, mesh: Path, voxels: int) -> None:
    """A part of the reader's own."""
    head, rows = (CONFIGS / "bunny.yaml").read_text().split("  - {stage: fill.implicit")[0], []
    implicit = "  - {stage: fill.implicit}\n"
    for way, tail in (
        ("layers from the field", implicit + LAYERS),
        ("mesh from the field", implicit + SURFACE),
        ("Boolean of two meshes", BOOLEAN),
    ):
        spent, stored = measure(scratch, way.split()[0], head + tail, 1, f"mesh={mesh}", f"voxels={voxels}")
        rows.append([way, *spent, stored])
    table(f"{mesh.name}, {voxels} voxels along a cell edge", ["way", "wall s", "CPU s", "peak MB", "files MB"], rows)


def main() -> None:
    with tempfile.TemporaryDirectory() as scratch:
        assemblies(Path(scratch))
        if len(sys.argv) > 1:
            part(Path(scratch), Path(sys.argv[1]).resolve(), int(sys.argv[2]) if len(sys.argv) > 2 else 32)


if __name__ == "__main__":
    main()
