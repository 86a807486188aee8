"""Triangles of a mesh chosen by words: names of groups, and what is known of the faces of a CAD file.

Such a face is a group whose name holds what is known of it, in this order, as far as it is known::

    #12 cylinder hole d=5 color=#ff0000 body=plate name=bearing seat
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from sppm_pipeline.errors import InputError
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.nouns.length import UNITS_IN_MM
from sppm_pipeline.services.arrays import Bools

WORDS = (
    "the name of a group, or of a CAD file '#12', 'holes', 'plane', 'cylinder d<6mm', 'color red', 'body NAME', "
    "'name NAME', also together: 'cylinder hole d>=5mm color red'"
)
"""What faces may be chosen by, for messages."""

COLORS = {
    "red": "#ff0000", "green": "#00ff00", "blue": "#0000ff", "yellow": "#ffff00", "orange": "#ff8000",
    "cyan": "#00ffff", "magenta": "#ff00ff", "white": "#ffffff", "gray": "#808080", "black": "#000000",
}  # fmt: skip
"""A face has the color of these that is nearest to its own."""

_FACE = re.compile(
    r"#(?P<number>\d+) (?P<kind>[a-z]+)(?P<hole> hole)?(?: d=(?P<d>\S+))?(?: color=#(?P<color>[0-9a-f]{6}))?"
    r"(?: body=(?P<body>.*?))?(?: name=(?P<name>.*))?"
)
_TERM = re.compile(
    r"\s*(?:(?:#|face\s+)(?P<number>\d+)\b|(?P<hole>holes?)\b|(?P<kind>plane|cylinder|cone|sphere|torus|freeform)s?\b"
    r"|d\s*(?P<how><=|>=|<|>|=)\s*(?P<d>\d+\.?\d*|\.\d+)(?![\d.])\s*(?P<unit>[a-zµ]*)"
    r"|color\s+(?P<color>#[0-9a-f]{6}|[a-z]+)|body\s+(?P<body>.+?)(?=\s+name\s|$)|name\s+(?P<name>.+)$)"
)
_EQUAL = 1e-4  # of diameters, as a fraction: they are written with six digits


def named_triangles(mesh: SurfaceMesh, texts: tuple[str, ...]) -> Bools:
    """Triangles (m,) bool that one of some texts chooses.

    Raises
    ------
    InputError
        If a text can't be read, or the mesh has no such group or face.
    """
    chosen = np.zeros(len(mesh.faces), np.bool_)
    for text in texts:
        found = [group[1:] for group in mesh.groups if group[0] == text]
        if not found and (terms := _terms(text)):
            faces = [(_FACE.fullmatch(name), first, last) for name, first, last in mesh.groups]
            found = [(first, last) for face, first, last in faces if face and all(_holds(face, term) for term in terms)]
        if not found:
            known = list(dict.fromkeys(name for name, _, _ in mesh.groups))
            hint = "OBJ, 3MF and ASCII STL files name groups, and CAD files faces; this one has none"
            if known:
                hint = f"it has {', '.join(known[:20])}" + (", ..." if len(known) > 20 else "")
                hint += f"; choose by {WORDS}" if _FACE.fullmatch(known[0]) else ""
            raise InputError(f"{mesh.name} has no group {text[:60]!r}", hint=hint)
        for first, last in found:
            chosen[first:last] = True
    return chosen


def _terms(text: str) -> list[dict[str, Any]]:
    """The conditions that a text states; none if it is no such text."""
    terms, at, text = [], 0, " ".join(text.split())
    while at < len(text):
        if (match := _TERM.match(text, at)) is None or match["unit"] not in (None, "", *UNITS_IN_MM):
            return []
        if match["color"] and match["color"][0] != "#" and match["color"] not in COLORS:
            return []
        terms.append({key: value for key, value in match.groupdict().items() if value})
        at = match.end()
    return terms


def _holds(face: re.Match[str], term: dict[str, Any]) -> bool:
    for key, wanted in term.items():
        found = face[key] if key in ("number", "kind", "hole", "color", "body", "name") else ""
        if found is None:
            return False
        if key == "color":
            rgb = _rgb("#" + found)
            nearest = min(COLORS, key=lambda name: float(np.abs(_rgb(COLORS[name]) - rgb).sum()))
            if not (np.abs(_rgb(wanted) - rgb).max() <= 2 if wanted[0] == "#" else nearest == wanted):
                return False
        elif key in ("number", "kind", "body", "name") and found != wanted:
            return False
    if "how" in term:
        if face["d"] is None:
            return False
        limit, d = float(term["d"]) * UNITS_IN_MM[term.get("unit", "mm")], float(face["d"])
        if abs(d - limit) <= _EQUAL * limit:
            return "=" in term["how"]
        return (d < limit and "<" in term["how"]) or (d > limit and ">" in term["how"])
    return True


def _rgb(text: str) -> Any:
    return np.array([int(text[n : n + 2], 16) for n in (1, 3, 5)])
