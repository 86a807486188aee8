"""Digits and letters as strokes, four units wide and six high, and strokes laid on a surface."""

from __future__ import annotations

import itertools

import numpy as np

from sppm_pipeline.services.arrays import F64, I64

HIGH, ADVANCE = 6, 6
"""Height of a letter, and distance from one to the next, in units."""

_O, _P = "10 30 41 45 36 16 05 01 10", "00 06 36 45 44 33 03"
GLYPHS = {
    "0": f"{_O},12 34", "1": "05 26 20,10 30", "2": "05 16 36 45 44 00 40",
    "3": "05 16 36 45 44 33 13,33 42 41 30 10 01",
    "4": "30 36 02 42", "5": "46 06 04 34 43 41 30 10 01", "6": "45 36 16 05 01 10 30 41 42 33 13 02", "7": "06 46 10",
    "8": "13 04 05 16 36 45 44 33 13 02 01 10 30 41 42 33", "9": "01 10 30 41 45 36 16 05 04 13 33 44",
    "A": "00 04 26 44 40,02 42", "B": f"{_P},33 42 41 30 00",
    "C": "45 36 16 05 01 10 30 41", "D": "00 06 26 44 42 20 00",
    "E": "46 06 00 40,03 33", "F": "46 06 00,03 33", "G": "45 36 16 05 01 10 30 41 43 23", "H": "00 06,40 46,03 43",
    "I": "10 30,20 26,16 36", "J": "01 10 30 41 46", "K": "00 06,46 03 40", "L": "06 00 40", "M": "00 06 23 46 40",
    "N": "00 06 40 46", "O": _O, "P": _P, "Q": f"{_O},22 40", "R": f"{_P},23 40",
    "S": "45 36 16 05 04 13 33 42 41 30 10 01", "T": "06 46,26 20", "U": "06 01 10 30 41 46", "V": "06 20 46",
    "W": "06 10 23 30 46", "X": "00 46,06 40", "Y": "06 23 46,23 20", "Z": "06 46 00 40", "-": "13 33", ".": "20 20",
    "/": "00 46", "+": "13 33,22 24", ":": "22 22,24 24", "_": "00 40", " ": "",
}  # fmt: skip
"""Polylines of each letter: points x, y in units, from the low left corner."""


def strokes(text: str) -> F64:
    """Straight strokes (n, 2, 2) of a line of text, both ends x, y in units, its middle at the origin.

    KeyError for a letter that is not in `GLYPHS`.
    """
    found: list[tuple[tuple[int, int], tuple[int, int]]] = []
    for place, letter in enumerate(text):
        for line in filter(None, GLYPHS[letter].split(",")):
            points = [(int(word[0]) + ADVANCE * place, int(word[1])) for word in line.split()]
            found += itertools.pairwise(points)
    middle = np.array([(ADVANCE * len(text) - 2) / 2, HIGH / 2])
    lines: F64 = np.array(found, np.float64).reshape(-1, 2, 2) - middle
    return lines


def in_pieces(lines: F64, longest: float) -> list[F64]:
    """Points (k, 2) along each stroke, whose pieces are no longer than `longest`."""
    made = []
    for start, end in lines:
        count = max(1, int(np.ceil(np.linalg.norm(end - start) / longest)))
        made.append(start + (end - start) * np.linspace(0, 1, count + 1)[:, None])
    return made


def laid_on(points: F64, toward: F64, triangles: F64, reach: float) -> tuple[F64, F64, I64]:
    """Where lines through points (n, 3) along the unit vector `toward` meet triangles (m, 3, 3) that face it.

    The nearest place within `reach` of each point (n, 3), the unit normal there, and its triangle, -1 for none.
    """
    a, u, v = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    normals = np.cross(u, v)
    facing = np.flatnonzero(normals @ toward > 1e-9 * np.linalg.norm(normals, axis=1))
    a, u, v, normals = a[facing], u[facing], v[facing], normals[facing]
    slope = normals @ toward
    places, across, which = points.copy(), np.tile(toward, (len(points), 1)), np.full(len(points), -1)
    for i, point in enumerate(points):
        # height of the triangle's plane above the point, and barycentric coordinates of the place (Moeller, Trumbore)
        offset = a - point
        height = (normals * offset).sum(1) / slope
        turned = np.cross(offset, toward)
        first, second = (turned * v).sum(1) / slope, (turned * u).sum(1) / -slope
        inside = (first >= -1e-9) & (second >= -1e-9) & (first + second <= 1 + 1e-9) & (np.abs(height) <= reach)
        if inside.any():
            best = int(np.flatnonzero(inside)[np.argmin(np.abs(height[inside]))])
            places[i], which[i] = point + height[best] * toward, facing[best]
            across[i] = normals[best] / np.linalg.norm(normals[best])
    return places, across, which
