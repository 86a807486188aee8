"""A cube of 60 mm with a skin and a structure as parts of one project, sliced by PrusaSlicer's command line.

Usage: ``python -m benchmarks.fdm``; `prusa-slicer` must be installed. Printed are the narrowest line that is extruded,
its share of what is extruded, and the weight against the volume of both parts together, sampled on voxels of 0.1 mm,
times the density.
"""

from __future__ import annotations

import math
import re
import subprocess
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

import sppm_pipeline as sppm
from sppm_pipeline.services.grid import Grid

NOZZLE, DENSITY, FILAMENT, VOXEL = 0.4, 1.24, 1.75, 0.1

PIPELINE = """
sppm: 1
name: fdm
recipes:
  cell:
    - {stage: sample.mirrored_faces, total: 68, share: 0.6}
    - {stage: sample.dart_throwing, total: 68}
    - {stage: connect.mbdst}
    - {stage: field.gaussian, pore_radius: 0.11, tunnel_radius: 0.03}
pipeline:
  - {stage: tune.porosity, recipe: cell, target: 0.6}
  - {stage: read.primitive, id: cube, shape: box, size: [60 mm, 60 mm, 60 mm]}
  - {stage: tile.periodic, cell: 30 mm}
  - {stage: fill.implicit, id: lattice, border: round, thinnest: 0.8 mm}
  - {stage: extract.marching_cubes, id: rough, resolution: 64}
  - {stage: mesh.simplify, id: structure, largest_distance: 0.02 mm}
  - {stage: read.primitive, id: inner, shape: box, size: [58.28 mm, 58.28 mm, 58 mm]}
  - {stage: fill.combine, id: skin, operation: difference, from: {mesh: cube, tool: inner}, at: [[0, 0, 1 mm]]}
  - stage: write.project
    path: cube.3mf
    from: {body: skin, structure: structure}
    names: [skin, structure]
    nozzle: 0.4 mm
    settings: ["skin: perimeters = 2", "structure: perimeters = 2", "object: fill_density = 100%",
               "object: fill_pattern = rectilinear"]
"""

PRINTER = {
    "nozzle-diameter": NOZZLE, "filament-diameter": FILAMENT, "filament-density": DENSITY, "layer-height": 0.2,
    "first-layer-height": 0.2, "skirts": 0, "gcode-flavor": "marlin2", "layer-gcode": "G92 E0",
    "bed-shape": "0x0,250x0,250x210,0x210",
}  # fmt: skip


def main() -> None:
    """Make the project, slice it, and print what comes of it."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "fdm.yaml").write_text(PIPELINE)
        start = time.process_time()
        made = sppm.run(str(folder / "fdm.yaml"), output=folder / "out")
        print(f"project of {len(made['structure'].faces)} triangles in {time.process_time() - start:.1f} s")
        arguments = ["--use-relative-e-distances", *(f"--{key}={value}" for key, value in PRINTER.items())]
        start = time.perf_counter()
        subprocess.run(
            ["prusa-slicer", "-g", *arguments, "-o", "cube.gcode", "out/cube.3mf"],
            cwd=folder, check=True, capture_output=True,
        )  # fmt: skip
        print(f"sliced in {time.perf_counter() - start:.1f} s")
        text = (folder / "cube.gcode").read_text()
    lattice = made["lattice"]
    edge, count = lattice.physical_edge(), round(60 / VOXEL)
    low = (lattice.domain.lower + VOXEL / 2 - lattice.origin_mm) / edge
    grid = Grid((float(low[0]), float(low[1]), float(low[2])), (VOXEL / edge,) * 3, (count,) * 3)
    rim, plate = 0.86, 1.0
    across = np.arange(count) * VOXEL + VOXEL / 2
    side = (across < rim) | (across > 60 - rim)
    solid = 0
    for k in range(0, count, 20):
        layers = lattice.solid_zyx(grid, k, k + 20).copy()
        for z, layer in zip(across[k : k + 20], layers, strict=True):
            if z < plate or z > 60 - plate:
                layer[:] = 1
            layer[side], layer[:, side] = 1, 1
        solid += int(np.count_nonzero(layers))
    volume = solid * VOXEL**3
    lines = extruded(text)
    weight = sum(lines.values()) * math.pi * FILAMENT**2 / 4 * DENSITY / 1000
    narrow = sum(length for width, length in lines.items() if width < NOZZLE - 1e-3) / sum(lines.values())
    print(f"narrowest line {min(lines):.3f} mm; {narrow:.2%} of the filament in lines below {NOZZLE} mm")
    expected = volume * DENSITY / 1000
    print(f"weight {weight:.2f} g, volume times density {expected:.2f} g: {weight / expected - 1:+.2%}")


def extruded(text: str) -> Counter[float]:
    """Millimeters of filament in lines, by the width of these."""
    lines: Counter[float] = Counter()
    width = 0.0
    for line in text.splitlines():
        if line.startswith(";WIDTH:"):
            width = float(line[7:])
        elif line.startswith("G1") and (" X" in line or " Y" in line):
            found = re.search(r" E(-?[\d.]+)", line)
            if found and float(found[1]) > 0:
                lines[width] += float(found[1])
    return lines


if __name__ == "__main__":
    main()
