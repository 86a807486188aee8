"""The lattice of an assembly: its cells and the faces between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sppm_pipeline.errors import DesignError

Faces = tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]


def checked_mask(mask: ArrayLike) -> NDArray[np.bool_]:
    """`mask` as a boolean array.

    Raises
    ------
    ValueError
        If it hasn't three axes, or one of them is empty.
    """
    cells = np.asarray(mask, np.bool_)
    if cells.ndim != 3 or 0 in cells.shape:
        raise ValueError(f"the mask of cells must have shape (nx, ny, nz) with no empty axis, got {cells.shape}")
    return cells


def check_count(what: str, count: int, largest: int = 2**31 - 1) -> None:
    """Check the number of colors or interiors that a user asked for.

    Raises
    ------
    DesignError
        If it isn't within 1..largest.
    """
    if not 1 <= count <= largest:
        raise DesignError(
            f"the number of {what} is {count}, allowed are 1 to {largest}",
            hint=f"use at least one, and no more than {largest}, so that every combination has a number of its own"
            if count > largest
            else "use at least one",
        )


def face_presence(mask: NDArray[np.bool_], periodic: bool = False) -> tuple[NDArray[np.bool_], ...]:
    """Which lattice faces have a cell on at least one side.

    Parameters
    ----------
    mask : (nx, ny, nz) bool
        Which cells are filled.
    periodic : bool
        Whether the last plane of each axis is the first one again; both then carry the same entries.

    Returns
    -------
    three bool arrays
        The array of axis a has shape n_a + 1 along a.
    """
    presence = []
    for axis in range(3):
        cells = np.moveaxis(mask, axis, 0)
        there = np.zeros((cells.shape[0] + 1, *cells.shape[1:]), np.bool_)
        there[:-1] = cells
        there[1:] |= cells
        if periodic:
            there[0] |= there[-1]
            there[-1] = there[0]
        presence.append(np.moveaxis(there, 0, axis))
    return tuple(presence)


def faces_of_cells(colors: Faces, mask: NDArray[np.bool_], periodic: bool = False) -> Faces:
    """Faces of cells whose two opposite faces carry one color.

    Parameters
    ----------
    colors : three (nx, ny, nz) int32
        Color that each cell shows along x, y, z. Where two cells meet they must agree; the lower one is read.
    mask : (nx, ny, nz) bool
        Which cells are filled.
    periodic : bool
        Whether the assembly repeats.

    Returns
    -------
    three int32 arrays
        Shape n_a + 1 along axis a; -1 where there is no cell on either side.
    """
    faces = []
    for axis in range(3):
        cells = np.moveaxis(mask, axis, 0)
        shown = np.moveaxis(colors[axis], axis, 0)
        planes = np.full((cells.shape[0] + 1, *cells.shape[1:]), -1, np.int32)
        planes[:-1][cells] = shown[cells]
        planes[1:][cells] = shown[cells]
        if periodic:
            planes[0] = np.where(planes[0] < 0, planes[-1], planes[0])
            planes[-1] = planes[0]
        faces.append(np.ascontiguousarray(np.moveaxis(planes, 0, axis)))
    return faces[0], faces[1], faces[2]
