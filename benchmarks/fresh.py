"""Fresh cells: what drawing one costs, as whole processes that draw more and more of them.

    python -m benchmarks.fresh [CELLS_ALONG_AN_EDGE ...]     # 3 6 10 16 if omitted

The box of cells is periodic, so that exactly that many cells are drawn; nothing is evaluated. The cost of a
cell is the difference to the row before, which takes the start of the process off.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from benchmarks.measure import pipeline_command, run, table

PIPELINE = """
sppm: 1
seed: 1
recipes:
  cell:
    - {stage: sample.mirrored_faces, total: 68, share: 0.6%s}
    - {stage: sample.dart_throwing, total: 68}
    - {stage: connect.mbdst, degree: [3, 5], mode: greedy}
    - {stage: field.gaussian, pore_radius: 0.11, tunnel_radius: 0.03}
pipeline:
  - {stage: tile.fresh, recipe: cell, cells: [%d, %d, %d], periodic: true, limit: 1000000}
"""


def rows(sizes: list[int], faces: str) -> list[list[object]]:
    """A row each: cells, seconds, memory, and what a cell more costs."""
    made: list[list[object]] = []
    before: tuple[int, float, float] | None = None
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "fresh.yaml"
        for n in sizes:
            path.write_text(PIPELINE % (faces, n, n, n))
            done = min((run(pipeline_command(path, f"{folder}/{n}-{k}")) for k in range(2)), key=lambda one: one.cpu)
            more: list[object] = ["", ""]
            if before:
                cells = n**3 - before[0]
                more = [(done.cpu - before[1]) / cells * 1e3, (done.peak - before[2]) / cells * 1e3]
            made.append([n**3, done.wall, done.cpu, done.peak, *more])
            before = n**3, done.cpu, done.peak
    return made


def main(arguments: list[str]) -> None:
    """Print both kinds of faces."""
    sizes = [int(one) for one in arguments] or [3, 6, 10, 16]
    header = ["cells", "wall s", "CPU s", "peak MB", "CPU ms a cell", "kB a cell"]
    for name, faces in (("pores on edges", ""), ("faces_margin: paper", ", faces_margin: paper")):
        table(f"tile.fresh, {name}", header, rows(sizes, faces))


if __name__ == "__main__":
    main(sys.argv[1:])
