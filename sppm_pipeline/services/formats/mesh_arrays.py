"""Common parts of the mesh readers: validation of the result, equal positions merged, copies placed."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import InputError
from sppm_pipeline.services.arrays import F32, F64, I32, I64
from sppm_pipeline.services.jit.compiled import jit

DecodedMesh = tuple[F64, I64]

Groups = tuple[tuple[str, int, int], ...]
"""Named stretches of triangles, first <= i < last."""


Matrix = F64
"""(3, 4): turn, scale or shear in the first three columns, the shift in the last one."""

IDENTITY: Matrix = np.eye(3, 4)
IDENTITY.flags.writeable = False

MAX_TRIANGLES = 2**25
"""A few kilobytes can ask for any number of copies; more triangles than this are not made of them."""

MAX_PLACED = 2**17
"""Objects and copies of objects in one file, empty ones included."""

_AT_ONCE = 2**20  # vertices
_LONGEST_NAME = 200  # characters of a group's


_RECENT = 2**15
"""Rows that are remembered beside the table, within half a megabyte: most corners were used a moment ago."""


class GroupLog:
    """Collects named stretches of triangles while a file is read; several kinds of names may hold at once."""

    def __init__(self) -> None:
        self._open: dict[str, tuple[tuple[str, ...], int]] = {}
        self._found: list[tuple[str, int, int]] = []

    def begin(self, kind: str, names: Sequence[bytes], triangle: int) -> None:
        """From this triangle on these names hold, in place of those of the same kind; none for an end."""
        held, first = self._open.pop(kind, ((), 0))
        if triangle > first:
            self._found.extend((name, first, triangle) for name in held)
        self._open[kind] = tuple(name.decode("utf-8", "replace")[:_LONGEST_NAME] for name in names), triangle

    def groups(self, triangles: int) -> Groups:
        """All that was found in a file of so many triangles, by their first triangle."""
        for kind in list(self._open):
            self.begin(kind, (), triangles)
        return tuple(sorted(self._found, key=lambda group: group[1:]))


def require_content(data: bytes | memoryview | bytearray, name: str) -> None:
    """Raise InputError for a file of no bytes."""
    if len(data) == 0:
        raise InputError(f"{name}: the file is empty", hint="was it fully written or downloaded?")


def require_room(name: str, what: str, claimed: int, bytes_each: int, left: int, position: int) -> None:
    """Raise InputError, before anything is allocated, if a header claims more than the rest of the file can hold."""
    if claimed * bytes_each > left:
        raise InputError(
            f"{name}: the header claims {claimed} {what}, which take at least {claimed * bytes_each} bytes, "
            f"but only {max(left, 0)} bytes follow byte {position}",
            hint="the file is cut off or its header is wrong: write or download it again",
        )


def decoded(name: str, coordinates: array[float], corners: array[int]) -> DecodedMesh:
    """The mesh of finite coordinates and of corners (float64 and int64, in rows of three), if it has a face."""
    faces = np.frombuffer(corners, np.int64).reshape(-1, 3)
    require_faces(name, faces)
    return np.frombuffer(coordinates, np.float64).reshape(-1, 3), faces


def require_sound(name: str, where: str, vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> DecodedMesh:
    """The arrays that a library made of a file, as float64 and int64, if finite and if all faces name vertices."""
    with np.errstate(invalid="ignore"):  # signaling NaN complain when they are converted
        points = np.ascontiguousarray(vertices, np.float64).reshape(-1, 3)
    finite = np.isfinite(points).all(axis=1)
    if not finite.all():
        bad = int(np.flatnonzero(~finite)[0])
        raise InputError(f"{name}: {where}, vertex {bad}: a coordinate must be finite, not {points[bad].tolist()}")
    triangles = np.ascontiguousarray(faces, np.int64).reshape(-1, 3)
    wrong = ((triangles < 0) | (triangles >= len(points))).any(axis=1)
    if wrong.any():
        bad = int(np.flatnonzero(wrong)[0])
        raise InputError(
            f"{name}: {where}, triangle {bad}: it names a vertex that does not exist, in {triangles[bad].tolist()}; "
            f"there are {len(points)} vertices, numbered from 0"
        )
    return points, triangles


def require_faces(name: str, faces: NDArray[np.integer]) -> None:
    """Raise InputError for a mesh without a face."""
    if faces.shape[0] == 0:
        raise InputError(f"{name}: the file holds no faces", hint="a surface is needed, not points or lines alone")


def merge_equal(rows: F32 | I32) -> tuple[I64, I32]:
    """Find equal rows (n, 3), bit by bit: 0 and -0 differ.

    The first row of each different one (k,), in the order of appearance, and each row's number among them (n,).
    """
    bits = np.ascontiguousarray(rows).view(np.uint32)
    numbers = np.empty(bits.shape[0], np.int32)
    first = np.empty(1 << max(10, (len(bits) // 8).bit_length()), np.int64)
    recent = np.zeros((_RECENT, 4), np.uint32)
    row = count = 0
    # Corners repeat some six times; the table is made for that, and grows if they repeat less.
    while True:
        slots = np.full(2 * first.size, -1, np.int32)
        _enter(bits, first[:count], slots)
        row, count = _merge(bits, row, recent, slots, first, count, numbers)
        if row == bits.shape[0]:
            return first[:count], numbers
        first = np.concatenate([first, np.empty_like(first)])


@jit
def _merge(
    bits: NDArray[np.uint32], row: int, recent: NDArray[np.uint32], slots: I32, first: I64, count: int, numbers: I32
) -> tuple[int, int]:
    """Number rows from `row` on until all are done, or `first` is full; returns the next row and the count."""
    mask = np.int64(slots.size - 1)
    for i in range(row, bits.shape[0]):
        a, b, c = bits[i, 0], bits[i, 1], bits[i, 2]
        h = _hash(a, b, c)
        near = h >> 40 & np.int64(_RECENT - 1)
        if recent[near, 0] == a and recent[near, 1] == b and recent[near, 2] == c and recent[near, 3] > 0:
            numbers[i] = np.int64(recent[near, 3]) - 1
            continue
        slot = h & mask
        number = np.int64(slots[slot])
        while number >= 0:
            other = first[number]
            if bits[other, 0] == a and bits[other, 1] == b and bits[other, 2] == c:
                break
            slot = (slot + 1) & mask
            number = np.int64(slots[slot])
        if number < 0:
            if count == first.size:
                return i, count
            number = np.int64(count)
            slots[slot] = number
            first[count] = i
            count += 1
        numbers[i] = number
        recent[near, 0], recent[near, 1], recent[near, 2] = a, b, c
        recent[near, 3] = np.uint32(number + 1)
    return bits.shape[0], count


@jit
def _enter(bits: NDArray[np.uint32], first: I64, slots: I32) -> None:
    """Enter rows that are known to differ into an empty table."""
    mask = np.int64(slots.size - 1)
    for number in range(first.size):
        i = first[number]
        slot = _hash(bits[i, 0], bits[i, 1], bits[i, 2]) & mask
        while slots[slot] >= 0:
            slot = (slot + 1) & mask
        slots[slot] = number


@jit
def _hash(a: np.uint32, b: np.uint32, c: np.uint32) -> np.int64:
    h = np.uint64(a) | np.uint64(b) << np.uint64(32)
    # the multipliers of SplitMix64 (Steele, Lea and Flood, 2014)
    h = (h ^ (h >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9)
    h = ((h ^ (h >> np.uint64(32))) + np.uint64(c)) * np.uint64(0x94D049BB133111EB)
    return np.int64((h ^ (h >> np.uint64(31))) & np.uint64(0x7FFFFFFFFFFFFFFF))


def after(outer: Matrix, inner: Matrix) -> Matrix:
    """The transformation that does `inner` first."""
    if outer is IDENTITY:
        return inner
    with np.errstate(over="ignore", invalid="ignore"):
        turned: Matrix = (outer[:, :3, None] * inner[None]).sum(axis=1)
        turned[:, 3] += outer[:, 3]
    return turned


def require_few(name: str, placed: int, vertices: int, triangles: int) -> None:
    """Raise InputError, before anything is allocated, if the copies of a file add up to too much."""
    for count, limit, what in (
        (placed, MAX_PLACED, "copies of objects"),
        (triangles, MAX_TRIANGLES, "triangles"),
        (vertices, MAX_TRIANGLES, "vertices"),
    ):
        if count > limit:
            many = str(count) if count < 10**18 else "more than 10^18"
            raise InputError(
                f"{name}: its objects, placed again and again, add up to {many} {what}; at most {limit} are read",
                hint="place fewer copies, or read one cell and let a `tile` stage repeat it",
            )


def place(name: str, meshes: Sequence[DecodedMesh], placed: Sequence[tuple[int, Matrix]]) -> DecodedMesh:
    """One mesh of all copies (index of a mesh, transformation), in their order; a mirrored copy keeps its outside."""
    vertices = sum(len(meshes[which][0]) for which, _ in placed)
    triangles = sum(len(meshes[which][1]) for which, _ in placed)
    require_few(name, len(placed), vertices, triangles)
    points, faces = np.empty((vertices, 3)), np.empty((triangles, 3), np.int64)
    n = m = 0
    for which, group in groupby(placed, key=lambda copy: copy[0]):
        corners, triangle = meshes[which]
        matrices = np.array([matrix for _, matrix in group])
        step = max(1, _AT_ONCE // max(1, len(corners)))
        for some in (matrices[k : k + step] for k in range(0, len(matrices), step)):
            copies, (v, f) = len(some), (len(corners), len(triangle))
            _move(some, corners, points[n : n + copies * v].reshape(copies, v, 3))
            numbers = faces[m : m + copies * f].reshape(copies, f, 3)
            np.add(triangle, n + v * np.arange(copies)[:, None, None], out=numbers)
            mirrored = _determinants(some) < 0
            numbers[mirrored] = numbers[mirrored][:, :, ::-1]
            n, m = n + copies * v, m + copies * f
    if not np.isfinite(points).all():
        raise InputError(f"{name}: a transformation moves vertices beyond all numbers")
    return points, faces


def _move(matrices: F64, corners: F64, out: F64) -> None:
    x, y, z = corners.T
    with np.errstate(over="ignore", invalid="ignore"):
        for axis in range(3):
            a, b, c, shift = (matrices[:, axis, k, None] for k in range(4))
            out[:, :, axis] = a * x + b * y + c * z + shift


def _determinants(matrices: F64) -> F64:
    a, b, c = (matrices[:, axis, :3] for axis in range(3))
    with np.errstate(over="ignore", invalid="ignore"):
        found: F64 = (a * np.cross(b, c)).sum(axis=1)
    return found
