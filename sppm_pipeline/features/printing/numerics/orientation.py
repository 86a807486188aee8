"""A body of voxels in many orientations: what each would cost to print."""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.features.printing.numerics.scan import PrintScan
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.mesh.rotation import rotation

GOLDEN = (1 + math.sqrt(5)) / 2


class Score(NamedTuple):
    """Costs of a body in one orientation; lengths in voxels."""

    supports: int  # area of what hangs farther than a voxel beyond the layer below, summed over the layers
    cups: int  # largest area in a layer of void that is closed while that layer is printed
    height: int  # layers from the first to the last that hold solid
    area: int  # largest area of a layer
    # (nz, nx), depth at which it is met along y, over its box, lowest layer first; NaN where it is not
    view: NDArray[np.float64]


def upward_directions(count: Literal[6, 26]) -> NDArray[np.float64]:
    """Unit vectors, (count, 3): both ways along the axes, +z first; of 26, also to the corners of a dodecahedron."""
    axes = [(0, 0, 1), (0, 0, -1), (1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0)]
    if count == 6:
        return np.array(axes, float)
    both = (1.0, -1.0)
    corners = [(x, y, z) for x in both for y in both for z in both]
    for a in both:
        for b in both:
            p = (0.0, a / GOLDEN, b * GOLDEN)
            corners += [p, (p[2], p[0], p[1]), (p[1], p[2], p[0])]
    return np.concatenate([np.array(axes, float), np.array(corners) / math.sqrt(3)])


def turn_up(direction: NDArray[np.float64]) -> tuple[float, float, float]:
    """Turns about x, then y, then z, in degrees as `rotation` takes them, after which a direction points up."""
    x, y, z = (float(v) for v in direction)
    about_x = math.degrees(math.atan2(y, z))
    about_y = math.degrees(math.atan2(-x, math.hypot(y, z)))
    return (round(about_x, 6) + 0.0, round(about_y, 6) + 0.0, 0.0)


def score_turned(
    solid: NDArray[np.uint8], turn: tuple[float, float, float], plate: Literal["sealed", "supports"], reach: float = 1.0
) -> Score:
    """Turn a body of cubic voxels (nz, ny, nx), which holds some, by nearest voxels and scan its layers.

    `turn` is as for `rotation`; `plate` and `reach`, in voxels, are as for `PrintScan`.
    """
    matrix = rotation(turn)
    low = np.array([np.flatnonzero(solid.any(axes))[0] for axes in ((0, 1), (0, 2), (1, 2))], float)
    high = np.array([np.flatnonzero(solid.any(axes))[-1] + 1 for axes in ((0, 1), (0, 2), (1, 2))], float)
    half = np.abs(matrix) @ (high - low) / 2
    nx, ny, nz = (int(n) + 2 for n in np.ceil(2 * half - 1e-6))  # a margin of void, which is ambient
    middle, center = (low + high) / 2, np.array([nx, ny, nz]) / 2
    # each voxel of the result looks up where it came from, so that no gaps open
    back = np.ascontiguousarray(matrix.T)
    scan = PrintScan((nx, ny, nz), (1.0, 1.0), reach, plate, pictures=0)
    layer = np.empty((ny, nx), np.uint8)
    view = np.full((nz, nx), np.nan)
    for k in range(nz):
        _turned_layer(solid, back, middle, center, k, layer)
        scan.add(layer)
        hit = layer.any(0)
        view[k, hit] = layer.argmax(0)[hit] / ny
    curves = scan.finish().curves
    there = np.flatnonzero(curves["area"])
    height = int(there[-1] - there[0] + 1) if len(there) else 0
    return Score(
        int(curves["overhang"].sum()), int(curves["sealed"].max()), height, int(curves["area"].max()), view
    )  # fmt: skip


@jit
def _turned_layer(
    solid: NDArray[np.uint8], back: NDArray[np.float64], middle: NDArray[np.float64], center: NDArray[np.float64],
    k: int, layer: NDArray[np.uint8],
) -> None:  # fmt: skip
    """Fill a layer with the voxels in which its centers lie once they are turned back."""
    nz, ny, nx = solid.shape
    z = k + 0.5 - center[2]
    for j in range(layer.shape[0]):
        y = j + 0.5 - center[1]
        for i in range(layer.shape[1]):
            x = i + 0.5 - center[0]
            # a hair beside borders of voxels, so that rounding does not choose between them
            a = math.floor(back[0, 0] * x + back[0, 1] * y + back[0, 2] * z + middle[0] + 1e-9)
            b = math.floor(back[1, 0] * x + back[1, 1] * y + back[1, 2] * z + middle[1] + 1e-9)
            c = math.floor(back[2, 0] * x + back[2, 1] * y + back[2, 2] * z + middle[2] + 1e-9)
            inside = 0 <= a < nx and 0 <= b < ny and 0 <= c < nz
            layer[j, i] = solid[c, b, a] if inside else 0


def not_dominated(costs: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Rows (n, m) than which no other is as good in every column and better in one."""
    as_good = (costs[:, None] <= costs[None]).all(2)
    better = (costs[:, None] < costs[None]).any(2)
    return np.asarray(~(as_good & better).any(0))
