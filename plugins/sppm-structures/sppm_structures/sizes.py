"""What fields of structures are expected to be like, and what a sample of them costs, for `sppm estimate`."""

from __future__ import annotations

import math

from sppm_pipeline import Size
from sppm_pipeline.nouns import Geometry

KERNEL = 1.3
"""Nanoseconds of a kernel of the paper's field, the unit of the work of a sample: about what the table of rates has."""

MAX_KEPT = 512
"""Cells of a part whose contents are kept."""


def field_size(
    edge_mm: float | None,
    solid: float,
    surface: float,
    nanoseconds: float,
    cells: tuple[int, int, int] | None = None,
    cover: Size | None = None,
    pores: float = 0.0,
    kept: float = 0.0,
) -> Size:
    """The size of a formula's field of a cell, of `cells`, or of those that cover a part.

    `solid` is its share of the volume, `surface` is in cell edges squared per cell, `nanoseconds` are for a sample,
    `pores` are seeds of a cell, for each of which something is prepared, and `kept` are those that what is kept of a
    cell is as large as. `LookupError` if a part's cells are unknown.
    """
    box = (1.0, 1.0, 1.0)
    if cells is not None:
        box = (float(cells[0]), float(cells[1]), float(cells[2]))
    elif cover is not None:
        if edge_mm is None:
            raise LookupError("the size of a cell is unknown")
        x, y, z = (float(max(1, math.ceil(side - 1e-9))) for side in cover.body.in_unit(edge_mm).box)
        box = (x, y, z)
    volume = math.prod(box)
    made = Geometry(
        edge_mm=edge_mm,
        box=box,
        volume=volume,
        envelope=2 * (box[0] * box[1] + box[1] * box[2] + box[2] * box[0]),
        porosity=1 - min(max(solid, 0.0), 1.0),
        surface=surface,
        kernels=nanoseconds / KERNEL,
        reach=math.inf,
    )
    return Size(cells=volume, pores=pores * volume, resident=kept * min(volume, MAX_KEPT), geometry=made)


def of_struts(length: float, radius: float) -> tuple[float, float]:
    """Solid share and surface of struts of this total length in a cell, as if they lay at random (Boolean model)."""
    void = math.exp(-math.pi * radius**2 * length)
    return 1 - void, 2 * math.pi * radius * length * void


def near_struts(length: float, reach: float) -> float:
    """Mean number of struts nearer than `reach` to a point."""
    return math.pi * reach**2 * length
