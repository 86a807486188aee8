"""Two-point statistics of twins against those of the process that made the scan, which are known exactly.

With `e` the largest difference of S2 up to a quarter of the cell: a single draw, such as the scan, is off by as much as
"e of the scan" says, and a twin can't be asked for less.
"""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np

_SPEC = importlib.util.spec_from_file_location("stochbench_twin_scan", Path(__file__).with_name("scan.py"))
scans = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(scans)


def s2(solid):
    """Distances in cell edges, up to a quarter, and S2 of the solid there: means over shells one voxel thick."""
    n = len(solid)
    product = np.fft.irfftn(np.abs(np.fft.rfftn(solid)) ** 2, solid.shape, axes=(0, 1, 2)) / solid.size
    axis = np.minimum(np.arange(n), n - np.arange(n))
    length = np.sqrt(np.add.outer(np.add.outer(axis**2, axis**2), axis**2))
    shell = np.rint(length).astype(int).ravel()
    count = np.bincount(shell)
    distance, found = (np.bincount(shell, values.ravel()) / count for values in (length, product))
    return distance[: n // 4 + 1] / n, found[: n // 4 + 1]


def check(cells, inputs, truth):
    """Means over the scans, each with its twin."""
    specimens = [scans.scan(**one["scan"], radius=truth["radius"], balls=truth["balls"]) for one in inputs]
    off, known, porosity = [], [], []
    for cell, specimen in zip(cells, specimens, strict=True):
        distance, found = s2(cell)
        exact = scans.exact_s2(distance, truth["radius"], truth["balls"])
        off.append(np.abs(found - exact).max())
        known.append(np.abs(s2(specimen)[1] - exact).max())
        porosity.append(abs(cell.mean() - specimen.mean()))
    return {
        "e of the twin": float(np.mean(off)),
        "e of the scan": float(np.mean(known)),
        "largest difference of porosity": float(max(porosity)),
        "is the scan": sum(bool((a == b).all()) for a, b in zip(cells, specimens, strict=True)),
    }
