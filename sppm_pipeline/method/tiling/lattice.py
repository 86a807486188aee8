"""The lattice of an assembly: its cells, the faces between them, their numbers, and a hash of their places."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from sppm_pipeline.errors import DesignError
from sppm_pipeline.services.arrays import I32, I64, U64, Bools

Faces = tuple[I32, I32, I32]
Laid = tuple[I32, Faces]
"""Interiors of cells (nx, ny, nz), -1 for none, and the colors of their faces perpendicular to x, y and z."""


def checked_mask(mask: ArrayLike) -> Bools:
    """`mask` as a boolean array; ValueError if it hasn't three axes, or one of them is empty."""
    cells = np.asarray(mask, np.bool_)
    if cells.ndim != 3 or 0 in cells.shape:
        raise ValueError(f"the mask of cells must have shape (nx, ny, nz) with no empty axis, got {cells.shape}")
    return cells


def dilated(cells: Bools, periodic: bool = False) -> Bools:
    """The cells and all that share a face, an edge or a corner with one of them; a copy."""
    for axis in range(3):  # growing along one axis after the other reaches the corners
        along = np.moveaxis(cells, axis, 0)
        more = along.copy(order="K")
        more[1:] |= along[:-1]
        more[:-1] |= along[1:]
        if periodic:
            more[0] |= along[-1]
            more[-1] |= along[0]
        cells = np.moveaxis(more, 0, axis)
    return cells


def with_halo(cells: Bools, halo: int) -> Bools:
    """The cells and those at most `halo` away, in an array with so many more on each side."""
    found = np.pad(cells, halo)
    for _ in range(halo):
        found = dilated(found)
    return found


def check_count(what: str, count: int, largest: int = 2**31 - 1) -> None:
    """Raise DesignError if a number of colors or interiors that a user asked for isn't within 1..largest."""
    if not 1 <= count <= largest:
        raise DesignError(
            f"the number of {what} is {count}, allowed are 1 to {largest}",
            hint=f"use at least one, and no more than {largest}, so that every combination has a number of its own"
            if count > largest
            else "use at least one",
        )


def face_presence(mask: Bools, periodic: bool = False) -> tuple[Bools, ...]:
    """Which lattice faces have a cell on at least one side: three arrays, that of axis a of shape n_a + 1 along a.

    In a periodic lattice the last plane of each axis is the first one again; both then carry the same entries.
    """
    presence = []
    for axis in range(3):
        cells = np.moveaxis(mask, axis, 0)
        there = np.zeros((cells.shape[0] + 1, *cells.shape[1:]), np.bool_)
        there[:-1] = cells
        # plane i is the low side of cell i and the high side of cell i - 1
        there[1:] |= cells
        if periodic:
            there[0] |= there[-1]
            there[-1] = there[0]
        presence.append(np.moveaxis(there, 0, axis))
    return tuple(presence)


def faces_of_cells(colors: Faces, mask: Bools, periodic: bool = False) -> Faces:
    """Faces of cells whose two opposite faces carry one color: three arrays as in `Laid`, -1 where there is no cell.

    `colors`, three (nx, ny, nz), are those that each cell shows along x, y, z; where two cells meet they must agree.
    """
    faces = []
    for axis in range(3):
        cells = np.moveaxis(mask, axis, 0)
        shown = np.moveaxis(colors[axis], axis, 0)
        planes = np.full((cells.shape[0] + 1, *cells.shape[1:]), -1, np.int32)
        planes[:-1][cells] = shown[cells]
        # where two cells meet both show the same color, so the order does not matter
        planes[1:][cells] = shown[cells]
        if periodic:
            planes[0] = np.where(planes[0] < 0, planes[-1], planes[0])
            planes[-1] = planes[0]
        faces.append(np.ascontiguousarray(np.moveaxis(planes, 0, axis)))
    return faces[0], faces[1], faces[2]


#: Streams keep draws made for different purposes at the same place independent. FACE + axis is used for axis 0, 1, 2.
INTERIOR, FACE, CORNER, TIE = 1, 2, 5, 6

# 2^64 / golden ratio, and the two multipliers of variant 13 of D. Stafford's 64-bit finalizers, as in SplitMix64
# (Steele, Lea and Flood 2014, "Fast splittable pseudorandom number generators").
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_FIRST = np.uint64(0xBF58476D1CE4E5B9)
_SECOND = np.uint64(0x94D049BB133111EB)


def _absorbed(state: U64, word: U64) -> U64:
    # For a fixed state this is a bijection of the word, and the other way round: no two places of a row collide.
    bits = (state ^ word) + _GOLDEN
    bits ^= bits >> np.uint64(30)
    bits *= _FIRST
    bits ^= bits >> np.uint64(27)
    bits *= _SECOND
    bits ^= bits >> np.uint64(31)
    return bits


def hash_places(seed: int, stream: int, i: ArrayLike, j: ArrayLike, k: ArrayLike) -> U64:
    """Hash the lattice places (i, j, k).

    Parameters
    ----------
    seed : int
        Taken modulo 2^64.
    stream : int
        Purpose of the draw, one of this module's constants.
    i, j, k : integer array_like
        Indices along x, y, z, negative ones included; broadcast against each other. Open index arrays
        (`numpy.ogrid`) are cheapest.

    Returns
    -------
    (broadcast shape) uint64
        At least one-dimensional. Uniform over all 64-bit numbers; ``% n`` gives a draw from range(n) whose bias is
        below n / 2^64.
    """
    # One-element arrays instead of scalars: array arithmetic wraps modulo 2^64 silently, scalar arithmetic warns.
    state = _absorbed(np.zeros(1, np.uint64), np.array([seed % 2**64], np.uint64))
    state = _absorbed(state, np.array([stream], np.uint64))
    for index in (k, j, i):
        # int64 -> uint64 keeps the bits, so that negative indices are places like any other.
        state = _absorbed(state, np.atleast_1d(np.asarray(index, np.int64)).astype(np.uint64))
    return state


def _numbered(there: Bools) -> I32:
    numbers = np.full(there.shape[::-1], -1, np.int32)
    stored = there.transpose(2, 1, 0)
    numbers[stored] = np.arange(np.count_nonzero(there), dtype=np.int32)
    return np.ascontiguousarray(numbers.transpose(2, 1, 0))


def tile_fresh(mask: ArrayLike, *, periodic: bool = False) -> Laid:
    """Number cells, and the faces across each axis, consecutively in raster order, x fastest; -1 without a cell.

    In a periodic lattice the last plane of faces of each axis is the first one, and is counted once.
    """
    cells = checked_mask(mask)
    faces = []
    for axis, there in enumerate(face_presence(cells, periodic)):
        if periodic:
            # the plane at the end gets the number of the first one
            low = np.take(there, range(cells.shape[axis]), axis)
            numbers = _numbered(low)
            faces.append(np.concatenate([numbers, np.take(numbers, [0], axis)], axis))
        else:
            faces.append(_numbered(there))
    return _numbered(cells), (faces[0], faces[1], faces[2])


def meetings(interior: I32, faces: Faces) -> I64:
    """Rows (interior, axis, side, face) of all meetings in the lattice."""
    rows = []
    filled = interior >= 0
    for axis in range(3):
        for side in range(2):
            planes = [slice(None)] * 3
            planes[axis] = slice(1, None) if side else slice(None, -1)
            own = interior[filled]
            face = faces[axis][tuple(planes)][filled]
            rows.append(np.stack([own, np.full_like(own, axis), np.full_like(own, side), face], 1))
    return np.concatenate(rows).astype(np.int64)
