"""Whether hot kernels should leave Numba for one compiled extension: two of them written in C, measured side by side.

Needs a C compiler, ``cc`` or the one that ``CC`` names. Usage: python -m benchmarks.compiled_extension
"""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.kernels import paper_cell
from benchmarks.measure import median, repeat_in_process, run, table
from sppm_pipeline.method.connectivity.runs import find_runs
from sppm_pipeline.method.kernels.kernels import Kernels
from sppm_pipeline.method.kernels.profiles import DEFAULT_CUTOFF, PORE_PROFILE
from sppm_pipeline.method.kernels.splat import add_kernels
from sppm_pipeline.services.grid import cell_centers

SOURCE = Path(__file__).with_name("extension.c")

PROCESS = """
import ctypes, numpy as np
n = 64
{load}
"""
BY_NUMBA = """
from sppm_pipeline.method.kernels.splat import add_kernels
from sppm_pipeline.method.kernels.kernels import Kernels
from sppm_pipeline.method.connectivity.runs import find_runs
from sppm_pipeline.services.grid import cell_centers
none = np.zeros((0, 3))
add_kernels(np.zeros((n, n, n), np.float32), cell_centers(n),
    Kernels(np.full((1, 3), .5), np.full(1, 120.0), none, none, np.zeros(0), "linear"))
find_runs(np.zeros((1, n, n), np.uint8))
"""
BY_EXTENSION = """
library = ctypes.CDLL({path!r})
out, along, box = np.zeros((n, n, n), np.float32), np.empty(1024, np.float32), np.ones(3)
rows, bounds, layer = np.zeros(n + 1, np.int64), np.zeros(n * n, np.int32), np.zeros((n, n), np.uint8)
size, to = ctypes.c_int64, ctypes.c_void_p
library.add_points(to(out.ctypes.data), size(n), size(n), size(n), to(box.ctypes.data), to(box.ctypes.data),
    to(box.ctypes.data), size(0), ctypes.c_double(4.0), to(along.ctypes.data))
library.find_runs(to(layer.ctypes.data), size(n), size(n), to(rows.ctypes.data), to(bounds.ctypes.data), size(n * n))
"""


def built(folder: Path, *flags: str) -> Path:
    """The library, compiled with these flags."""
    library = folder / f"kernels{len(list(folder.iterdir()))}.so"
    compiler = os.environ.get("CC", "cc")
    subprocess.run([compiler, "-O3", "-shared", "-fPIC", *flags, str(SOURCE), "-o", str(library), "-lm"], check=True)
    return library


def pointer(array: NDArray[Any]) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


class Extension:
    """The two kernels of a built library."""

    def __init__(self, path: Path) -> None:
        self._library = ctypes.CDLL(str(path))
        self._library.find_runs.restype = ctypes.c_int64

    def pores(self, n: int, kernels: Kernels) -> NDArray[np.float32]:
        """The sum of the pores of a cell on n^3 samples."""
        grid, size = cell_centers(n), ctypes.c_int64(n)
        points = np.column_stack([kernels.centers, PORE_PROFILE.scale(kernels.omega)])
        out, along = np.zeros((n, n, n), np.float32), np.empty(4 * n + 128, np.float32)
        origin, spacing = np.array(grid.origin), np.array(grid.spacing)
        reach = ctypes.c_double(PORE_PROFILE.scaled_reach(DEFAULT_CUTOFF))
        self._library.add_points(
            pointer(out), size, size, size, pointer(origin), pointer(spacing), pointer(points),
            ctypes.c_int64(len(points)), reach, pointer(along),
        )  # fmt: skip
        return out

    def runs(self, layer: NDArray[np.uint8]) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
        """Rows and bounds as `find_runs` gives them."""
        ny, nx = layer.shape
        rows, bounds = np.empty(ny + 1, np.int64), np.empty(layer.size + 2 * nx, np.int32)
        found = self._library.find_runs(
            pointer(layer), ctypes.c_int64(ny), ctypes.c_int64(nx), pointer(rows), pointer(bounds),
            ctypes.c_int64(bounds.size),
        )  # fmt: skip
        return rows, bounds[:found].copy()


def main() -> None:
    n = 128
    whole = paper_cell()
    none = np.zeros((0, 3))
    kernels = Kernels(whole.centers, whole.omega, none, none, np.zeros(0), whole.profile)
    grid = cell_centers(n)

    def summed() -> NDArray[np.float32]:
        out = np.zeros((n, n, n), np.float32)
        add_kernels(out, grid, kernels)
        return out

    field = summed()
    layer = np.ascontiguousarray(np.tile(field[n // 2] < np.median(field), (8, 8))).view(np.uint8)
    with tempfile.TemporaryDirectory() as scratch:
        libraries = {
            "C, this processor": built(Path(scratch), "-march=native", "-ffast-math"),
            "C, any with AVX2": built(Path(scratch), "-march=x86-64-v3", "-ffast-math"),
        }
        rows: list[list[object]] = []
        _, cpu = repeat_in_process(summed)
        rows.append(["pores of a cell, 128^3", "Numba", cpu * 1e3, "", ""])
        for name, path in libraries.items():
            extension = Extension(path)
            _, cpu = repeat_in_process(lambda: extension.pores(n, kernels))  # noqa: B023
            rows.append(["", name, cpu * 1e3, float(np.abs(extension.pores(n, kernels) - field).max()), ""])
        _, cpu = repeat_in_process(lambda: find_runs(layer[None]), 31)
        expected = find_runs(layer[None])
        rows.append(["runs of a layer of 1024^2", "Numba", cpu * 1e3, "", ""])
        for name, path in libraries.items():
            extension = Extension(path)
            _, cpu = repeat_in_process(lambda: extension.runs(layer), 31)  # noqa: B023
            found = extension.runs(layer)
            differ = sum(int((a != b).sum()) for a, b in zip(found, (expected.rows, expected.bounds), strict=True))
            rows.append(["", name, cpu * 1e3, differ, ""])
        path = libraries["C, any with AVX2"]
        for name, load, kept in (
            ("Numba, from its cache", BY_NUMBA, "off"),
            ("Numba, code kept", BY_NUMBA, "on"),
            ("C, any with AVX2", BY_EXTENSION.format(path=str(path)), "on"),
        ):
            os.environ["SPPM_KEPT_KERNELS"] = kept
            process = median([sys.executable, "-c", PROCESS.format(load=load)])
            rows.append(["start, load and call both", name, process.cpu * 1e3, "", process.peak])
        cold = run(
            [sys.executable, "-c", "import os; os.environ['NUMBA_CACHE_DIR'] = " + repr(scratch) + BY_NUMBA_COLD]
        )
        rows.append(["the same, to be compiled", "Numba", cold.cpu * 1e3, "", cold.peak])
        rows.append(["size of the library, kB", "C, any with AVX2", "", path.stat().st_size / 1e3, ""])
    table("Numba against one compiled extension", ["what", "by", "CPU ms", "differs", "peak MB"], rows)


BY_NUMBA_COLD = "\nimport numpy as np\nn = 64\n" + BY_NUMBA


if __name__ == "__main__":
    main()
