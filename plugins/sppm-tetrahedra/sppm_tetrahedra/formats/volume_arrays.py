"""Common parts of the volume mesh formats: checked arrays, numbers as rows of text."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics import F64, I32, U8

_CHUNK = 20000
"""Rows that are turned into text together."""


def as_written(
    nodes: NDArray[np.floating], cells: NDArray[np.integer], materials: NDArray[np.integer]
) -> tuple[F64, I32, U8]:
    """The arrays as the encoders need them: (n, 3) float64, (m, 4) or (m, 10) int32, (m,) uint8, C-contiguous."""
    points = np.ascontiguousarray(nodes, np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or cells.ndim != 2 or cells.shape[1] not in (4, 10):
        raise ValueError(f"a mesh is (n, 3) nodes and (m, 4) or (m, 10) cells, not {nodes.shape} and {cells.shape}")
    if not np.isfinite(points).all():
        raise ValueError("the coordinates of a mesh must be finite")
    if cells.size and (cells.min() < 0 or cells.max() >= len(points)):
        raise ValueError(f"cells name nodes {cells.min()} to {cells.max()} of {len(points)}")
    if materials.shape != (len(cells),):
        raise ValueError("each cell needs a material")
    return points, np.ascontiguousarray(cells, np.int32), np.ascontiguousarray(materials, np.uint8)


def number_rows(rows: F64, separator: str, first: int | None = None) -> Iterator[bytes]:
    """Lines of floats, each in the shortest text that reads back the same; numbered from `first` if it is given."""
    for start in range(0, len(rows), _CHUNK):
        part = rows[start : start + _CHUNK].tolist()
        if first is None:
            lines = [separator.join(map(repr, row)) for row in part]
        else:
            lines = [
                f"{number}{separator}{separator.join(map(repr, row))}" for number, row in enumerate(part, first + start)
            ]
        yield ("\n".join(lines) + "\n").encode()


def integer_rows(rows: NDArray[np.integer] | Sequence[Sequence[int]], separator: str) -> Iterator[bytes]:
    """Lines of integers."""
    table = np.asarray(rows)
    if not table.size:
        return
    pattern = separator.join(["%d"] * table.shape[1]) + "\n"
    for start in range(0, len(table), _CHUNK):
        part = table[start : start + _CHUNK]
        yield (pattern * len(part) % tuple(part.ravel().tolist())).encode()
