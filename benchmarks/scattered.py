"""Scattered pores: a hundred thousand blocks, and a part scattered against the same part of 27 tiles.

    python -m benchmarks.scattered [BLOCKS_ALONG_AN_EDGE]     # 47 if omitted: 103 823 blocks, 7 million pores
    python -m benchmarks.scattered part MESH                  # whole processes, from a mesh to layers

The first prints what is thrown, joined and given kernels, each step's processor time and the peak memory until then;
kernels are compiled before.
"""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.measure import pipeline_command, run, table
from sppm_pipeline.method.stages.connect_relative_neighbors import RelativeNeighbors
from sppm_pipeline.method.stages.field_gaussian import GaussianField
from sppm_pipeline.method.stages.sample_dart_throwing import DartThrowing
from sppm_pipeline.nouns.artifact import Artifact
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.nouns.palette import Blocks, Palette
from sppm_pipeline.testing.plain_context import PlainContext

PORES = 70

RECIPE = """
    - {stage: sample.mirrored_faces, total: 68, share: 0.6}
    - {stage: sample.dart_throwing, total: 68}
    - {stage: %s}
    - {stage: field.gaussian, pore_radius: 0.11, tunnel_radius: 0.03}
"""
PART = """
sppm: 1
recipes:
  cell:%s
pipeline:
%s
  - {stage: fill.implicit}
  - {stage: slice.field, resolution: 100}
  - {stage: write.png, path: slices}
"""
MESH = "  - {stage: read.mesh, path: %s, height: 60 mm}"
TILES = """  - {stage: tileset.wang_3color, recipe: cell, porosity: 0.7}
%s
  - {stage: tile.wang_3color, cell: 7.5 mm}"""
SCATTERED = """%s
  - {stage: tile.scattered, recipe: cell, cell: 7.5 mm, porosity: 0.7}"""


def steps(blocks: int) -> list[list[object]]:
    """Throw, join and give kernels, as the recipe's stages do it, and check the result as a run does; a row each."""
    palette = Palette(blocks**3, (0, 0, 0), blocks=Blocks(np.ones((blocks,) * 3, bool), True))
    rows: list[list[object]] = []
    made: Artifact | None = None
    stages = (
        ("thrown", DartThrowing(total=PORES, share=0.55)),
        ("joined", RelativeNeighbors()),
        ("given kernels", GaussianField(pore_radius=Length(0.11), tunnel_radius=Length(0.03))),
    )
    for what, stage in stages:
        wall, cpu = time.perf_counter(), time.process_time()
        made = stage.run(PlainContext(1, threads=2, palette=palette), made)  # type: ignore[arg-type]
        made.check()
        made.summary()
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        rows.append([what, wall, cpu, cpu / (PORES * blocks**3) * 1e6, peak])
    return rows


def part(mesh: str) -> None:
    """The bunny's configuration, tiles against scattered pores, with both connectors."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for connector in ("connect.mbdst, degree: [3, 5], mode: greedy", "connect.relative_neighbors"):
            for name, tiler in (("27 tiles", TILES), ("scattered", SCATTERED)):
                path = Path(folder) / "part.yaml"
                path.write_text(PART % (RECIPE % connector, tiler % (MESH % mesh)))
                out = f"{folder}/{len(rows)}"
                done = min((run(pipeline_command(path, f"{out}-{k}")) for k in range(3)), key=lambda one: one.cpu)
                rows.append([f"{name}, {connector.split(',')[0]}", done.wall, done.cpu, done.peak])
    table(f"{mesh}, 60 mm high, cells of 7.5 mm, 100^3 voxels a cell", ["way", "wall s", "CPU s", "peak MB"], rows)


def main(arguments: list[str]) -> None:
    if arguments[:1] == ["part"]:
        part(arguments[1])
        return
    blocks = int(arguments[0]) if arguments else 47
    steps(3)
    rows = steps(blocks)
    total = [sum(float(str(row[column])) for row in rows) for column in (1, 2, 3)]
    rows.append(["together", *total, rows[-1][-1]])
    table(
        f"{blocks**3} blocks, {PORES * blocks**3} pores, two threads",
        ["what", "wall s", "CPU s", "CPU us a pore", "peak MB"],
        rows,
    )


if __name__ == "__main__":
    main(sys.argv[1:])
