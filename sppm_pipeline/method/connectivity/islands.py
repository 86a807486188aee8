"""Floating islands of one cell: remove them, or see whether they would make the paper reject the cell."""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import numpy as np

from sppm_pipeline.method.connectivity.components import find_components
from sppm_pipeline.services.arrays import F32, I32, I64, U8, Bools
from sppm_pipeline.services.jit.compiled import jit

Mask = TypeVar("Mask", Bools, U8)


class LooseParts(NamedTuple):
    """The components that removing islands would take away."""

    components: int
    at_boundary: int  # those with voxels in the first or last layer along some axis
    removed_share: float  # their share of the phase


def keep_largest(mask: Mask, periodic: tuple[bool, bool, bool] = (True, True, True)) -> Mask:
    """Copy a mask (nz, ny, nx), leaving only the largest component of the phase (anything but 0).

    On the torus this keeps a periodic cell periodic. Of several largest components the one with the first voxel stays.
    """
    found = find_components(mask, periodic)
    kept = np.array(mask, order="C")
    clear_runs(found.runs.rows, found.runs.bounds, found.of_run == 0, kept.view(np.uint8))
    return kept


def loose_parts(mask: Bools | U8) -> LooseParts:
    """Components besides the largest, with labels that do not wrap: what the paper's rejection looks at.

    A cell is rejected if a loose part lies at its surface (`at_boundary` > 0): inside the cell it can be removed
    without a trace, at the surface that would break the match with the neighboring cell.
    """
    found = find_components(mask, (False, False, False))
    total = int(found.sizes.sum())
    loose = found.sizes[1:]
    share = int(loose.sum()) / total if total else 0.0
    # components are sorted by size: the first one stays
    return LooseParts(int(loose.size), int(np.count_nonzero(found.faces[1:].any(axis=1))), share)


@jit
def clear_runs(rows: I64, bounds: I32, keep: Bools, out: U8) -> None:
    """Set the voxels of the runs that are not kept to 0; `out` is (nz, ny, nx)."""
    nz, ny, _ = out.shape
    for z in range(nz):
        for y in range(ny):
            row = out[z, y]
            for r in range(rows[z * ny + y], rows[z * ny + y + 1]):
                if not keep[r]:
                    row[bounds[2 * r] : bounds[2 * r + 1]] = 0


@jit
def negate_runs(rows: I64, bounds: I32, keep: Bools, size: tuple[int, int, int], start: int, values: F32) -> None:
    """Turn the sign of samples (planes, ny, nx) in the runs that are not kept; the first plane has the number `start`.

    `size` is the shape (nz, ny, nx) in which the runs were found; samples beyond it are periodic images, at most one
    along x.
    """
    nz, ny, nx = size
    for k in range(values.shape[0]):
        for y in range(values.shape[1]):
            # samples beyond the shape are periodic images of the first ones
            row = (start + k) % nz * ny + y % ny
            for r in range(rows[row], rows[row + 1]):
                if not keep[r]:
                    for x in range(bounds[2 * r], bounds[2 * r + 1]):
                        values[k, y, x] = -values[k, y, x]
                    if bounds[2 * r] == 0 and values.shape[2] > nx:
                        values[k, y, nx] = -values[k, y, nx]
