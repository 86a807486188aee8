"""Writers and readers of mesh files against trimesh, on a mesh of about a million triangles, in one run.

Usage: python -m benchmarks.mesh_files [samples along an edge]
"""

from __future__ import annotations

import importlib.util
import io
import sys
from collections.abc import Callable

import numpy as np
import trimesh

from benchmarks.measure import repeat_in_process, table
from sppm_pipeline.features.files.formats.detect import FORMATS, decode_mesh
from sppm_pipeline.services.mesh.closing import capped_marching_cubes


def gyroid(n: int) -> tuple[np.ndarray, np.ndarray]:
    """A closed labyrinth in a cube of 20 mm."""
    axis = np.linspace(-1, 1, n, dtype=np.float32) * 18
    z, y, x = np.meshgrid(axis, axis, axis, indexing="ij")
    field = np.cos(x) * np.sin(y) + np.cos(y) * np.sin(z) + np.cos(z) * np.sin(x)
    return capped_marching_cubes(field, 0.0, (0.0, 0.0, 0.0), (20 / (n - 1),) * 3)


def seconds(function: Callable[[], object], runs: int) -> float:
    return repeat_in_process(function, runs)[1]


def main() -> None:
    vertices, faces = gyroid(int(sys.argv[1]) if len(sys.argv) > 1 else 130)
    rows = []
    for name, module in FORMATS.items():
        data = b"".join(module.encode(vertices, faces))
        write = seconds(lambda module=module: sum(map(len, module.encode(vertices, faces))), 5)
        read = seconds(lambda data=data, name=name: decode_mesh(data, f"a.{name}"), 5)
        row: list[object] = [name, len(data) / 1e6, write, read]
        if name != "3mf" or importlib.util.find_spec("lxml"):
            # a new object each time: it keeps what it has computed
            rival_write = seconds(
                lambda name=name: trimesh.Trimesh(vertices, faces, process=False).export(file_type=name), 2
            )
            rival_read = seconds(lambda data=data, name=name: trimesh.load(io.BytesIO(data), file_type=name), 2)
            row += [rival_write / write, rival_read / read]
        else:
            row += ["no lxml", "no lxml"]
        rows.append(row)
    header = ["format", "MB", "write CPU s", "read CPU s", "trimesh writes, times as long", "reads, times as long"]
    table(f"{len(faces)} triangles, one thread", header, rows)


if __name__ == "__main__":
    main()
