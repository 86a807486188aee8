"""Where a part is held and what pulls at it: regions, conditions and load cases, for any physics of a part."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from sppm_pipeline.errors import ConfigError
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.nouns.artifact import Artifact
from sppm_pipeline.nouns.length import UNITS_IN_MM
from sppm_pipeline.services.arrays import F64

AXES = "xyz"
FORMS = (
    "'plane z at 0 mm' (or 'at low', 'at high': the ends of the part), 'box 0 0 0 to 10 10 5 mm', 'sphere 0 0 5 radius "
    "3 mm', 'cylinder z at 12 0 radius 4 mm' (and 'from 0 to 10'), 'group NAME' of a mesh, '#12', 'holes' or 'color "
    "red' of a CAD file, 'near' the other mesh, or 'surface', all of it"
)
"""What a region may be, for messages."""

UNITS = {"force": {"N": 1.0, "kN": 1e3}, "pressure": {"MPa": 1.0, "kPa": 1e-3, "bar": 0.1}, "displacement": UNITS_IN_MM}
"""Units of conditions, in N, MPa and mm."""

MAX_VALUE = 1e12
"""Of a condition, in the same units: no part has as much, and single precision has room for what follows from it."""


class Region(NamedTuple):
    """A piece of space that selects what lies in it, or within a tolerance of it."""

    kind: str  # plane, box, sphere, cylinder, triangles or surface
    numbers: tuple[float, ...]  # place; low and high corner; center and radius; center, radius and both ends; mm
    axis: int  # of a plane or cylinder
    text: str  # as it was written
    triangles: F64  # corners (n, 3, 3), mm

    def distances(self, points: F64) -> F64:
        """Distances (n,) of points (n, 3), mm, from it; 0 inside."""
        n, p = self.numbers, points
        if self.kind == "surface":
            return np.zeros(len(p))
        if self.kind == "plane":
            return np.asarray(np.abs(p[:, self.axis] - n[0]))
        if self.kind == "box":
            return np.asarray(np.linalg.norm(p - np.clip(p, n[:3], n[3:]), axis=1))
        if self.kind == "sphere":
            return np.asarray(np.maximum(np.linalg.norm(p - np.array(n[:3]), axis=1) - n[3], 0))
        if self.kind == "cylinder":
            across, along = np.delete(p, self.axis, axis=1) - np.array(n[:2]), p[:, self.axis]
            outside = np.maximum(np.linalg.norm(across, axis=1) - n[2], 0)
            return np.asarray(np.hypot(outside, along - np.clip(along, n[3], n[4])))
        from sppm_pipeline.services.mesh.box_tree import box_tree
        from sppm_pipeline.services.nearest import surface_distances

        return surface_distances(box_tree(self.triangles), p)

    @property
    def bounds(self) -> tuple[F64, F64]:
        """Low and high corner of a box, sphere or cylinder, mm."""
        n = self.numbers
        if self.kind == "box":
            return np.array(n[:3]), np.array(n[3:])
        if self.kind == "sphere":
            return np.array(n[:3]) - n[3], np.array(n[:3]) + n[3]
        ends = ([n[0] - n[2], n[1] - n[2]], n[3]), ([n[0] + n[2], n[1] + n[2]], n[4])
        low, high = (np.insert(across, self.axis, along) for across, along in ends)
        return low, high

    def signed_distances(self, points: F64) -> F64:
        """`distances`, but negative inside of a box, sphere or cylinder: less the distance from its surface."""
        n, p = self.numbers, points
        if self.kind == "box":
            depth = np.minimum(p - np.array(n[:3]), np.array(n[3:]) - p).min(1)
        elif self.kind == "sphere":
            depth = n[3] - np.linalg.norm(p - np.array(n[:3]), axis=1)
        else:
            across, along = np.delete(p, self.axis, axis=1) - np.array(n[:2]), p[:, self.axis]
            depth = np.minimum(n[2] - np.linalg.norm(across, axis=1), np.minimum(along - n[3], n[4] - along))
        return np.where(depth > 0, -depth, self.distances(points))


class Condition(NamedTuple):
    """What happens in a region."""

    kind: str  # displacement, force or pressure
    region: Region
    values: tuple[float | None, ...]  # displacement along x, y, z, mm, None where it is free; total force, N; MPa


class LoadCase(NamedTuple):
    """Conditions that hold together."""

    name: str
    weight: float
    conditions: tuple[Condition, ...]
    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0)  # m/s2

    @property
    def held(self) -> tuple[Condition, ...]:
        """Those that hold it."""
        return tuple(one for one in self.conditions if one.kind == "displacement")


@dataclass(frozen=True, eq=False)
class LoadCases(Artifact):
    """Load cases of a part, in the coordinates of its mesh.

    Attributes
    ----------
    cases : tuple of LoadCase
    """

    reported: ClassVar[tuple[str, ...]] = ("cases",)

    cases: tuple[LoadCase, ...]

    def check(self) -> None:
        """Names that differ, weights above zero."""
        names = [case.name for case in self.cases]
        if len(set(names)) < len(names) or not names or not all(case.weight > 0 for case in self.cases):
            raise ValueError(f"load cases need different names and positive weights, got {names}")

    def summary(self) -> dict[str, Any]:
        """Names of the cases and of what is in them."""
        made = {case.name: [f"{one.kind} on {one.region.text}" for one in case.conditions] for case in self.cases}
        return {"cases": len(self.cases), "conditions": made}


class _Words:
    """A text taken word by word; `ConfigError` names what was expected."""

    def __init__(self, text: str, words: list[str]) -> None:
        self.text, self.words = text, words

    def refuse(self, expected: str) -> ConfigError:
        found = f"{self.words[0][:40]!r}" if self.words else "the end"
        return ConfigError(f"{self.text[:100]!r}: expected {expected}, got {found}", hint=f"a region is {FORMS}")

    def next_is(self, *allowed: str) -> str | None:
        return self.words.pop(0) if self.words and self.words[0] in allowed else None

    def take(self, *allowed: str) -> str:
        if (word := self.next_is(*allowed)) is None:
            raise self.refuse(" or ".join(map(repr, allowed)))
        return word

    def numbers(self, count: int, after: str = "") -> list[float]:
        """Lengths, mm, after a word; a unit holds for all numbers before it that have none."""
        if after:
            self.take(after)
        found = list[float]()
        for _ in range(count):
            try:
                number = float(self.words[0])
            except (ValueError, IndexError):
                raise self.refuse("a number") from None
            if not math.isfinite(number):
                raise self.refuse("a finite number")
            self.words.pop(0)
            found.append(number * UNITS_IN_MM[next((word for word in self.words if word in UNITS_IN_MM), "mm")])
            self.next_is(*UNITS_IN_MM)
        return found


def region_of(text: str, part: SurfaceMesh | None, near: SurfaceMesh | None = None) -> Region:
    """The region that a text describes, at the mesh of a part; without one the text alone is checked.

    A `ConfigError` says what was expected instead.
    """
    words = _Words(text, text.split())
    # of a CAD file, `on #12`, `on holes d<6mm`, `on face 3`, `on color red`, `on body plate` are groups, too
    named = words.words and re.match(r"#\d+$|holes?$|face$|color$|body$", words.words[0])
    kind = "group" if named else words.take("plane", "box", "sphere", "cylinder", "group", "near", "surface")
    axis = AXES.index(words.take(*AXES)) if kind in ("plane", "cylinder") else 0
    numbers: list[float] = []
    triangles = np.zeros((0, 3, 3))
    if kind == "plane":
        words.take("at")
        end = words.next_is("low", "high")
        ends = {} if part is None else {"low": part.lower, "high": part.upper}
        numbers = words.numbers(1) if end is None else [float(ends[end][axis]) if ends else 0.0]
    elif kind == "box":
        corner, other = words.numbers(3), words.numbers(3, after="to")
        numbers = [*map(min, corner, other), *map(max, corner, other)]
    elif kind == "sphere":
        numbers = words.numbers(3) + words.numbers(1, after="radius")
    elif kind == "cylinder":
        numbers = words.numbers(2, after="at") + words.numbers(1, after="radius")
        numbers += sorted(
            words.numbers(1) + words.numbers(1, after="to") if words.next_is("from") else [-math.inf, math.inf]
        )
    elif kind == "group":
        name = " ".join(words.words)
        words.words = []
        if part is not None:
            from sppm_pipeline.method.nouns.named_faces import named_triangles

            triangles = part.vertices[part.faces[named_triangles(part, (name,))]]
    elif kind == "near" and part is not None:
        if near is None:
            raise ConfigError(
                f"{text!r} needs another mesh", hint="write `from: {near: id}` of the stage that reads it"
            )
        triangles = near.vertices[near.faces]
    if words.words:
        raise words.refuse("nothing more")
    return Region("triangles" if kind in ("group", "near") else kind, tuple(numbers), axis, text, triangles)


def held_of(text: str, part: SurfaceMesh | None, near: SurfaceMesh | None = None, *, normal: bool = False) -> Condition:
    """What ``"plane z at 0 mm"`` or ``"x y on plane z at 0 mm"`` holds; of a plane of symmetry its normal."""
    before, on, after = text.partition(" on ")
    if not on or text.split()[0] == "group":  # whose name may have an ` on ` of its own
        before, after = "", text
    axes = before.split()
    if any(axis not in AXES for axis in axes):
        raise ConfigError(
            f"{text[:100]!r} holds along {before[:40]!r}", hint="write for example 'x y on plane z at 0 mm'"
        )
    region = region_of(after, part, near)
    if normal:
        if region.kind != "plane" or axes:
            raise ConfigError(f"{text[:100]!r} is no plane of symmetry", hint="write for example 'plane x at 0 mm'")
        axes = [AXES[region.axis]]
    return Condition("displacement", region, tuple(0.0 if not axes or one in axes else None for one in AXES))


def condition_of(kind: str, text: str, part: SurfaceMesh | None, near: SurfaceMesh | None = None) -> Condition:
    """A force, pressure or displacement such as ``"0 0 -200 N on plane z at high"``; else a `ConfigError`."""
    example = {"force": "0 0 -200 N", "pressure": "0.2 MPa", "displacement": "free free -1 mm"}[kind]
    before, _, after = text.partition(" on ")
    *numbers, unit = before.split() or [""]
    if unit not in UNITS[kind] or len(numbers) != (1 if kind == "pressure" else 3) or not after:
        raise ConfigError(
            f"{text[:100]!r} is no {kind}",
            hint=f"write for example '{example} on plane z at high'; units are {', '.join(UNITS[kind])}",
        )
    values: list[float | None] = []
    for word in numbers:
        try:
            value = None if word == "free" and kind == "displacement" else UNITS[kind][unit] * float(word)
        except ValueError:
            value = math.nan
        if value is not None and MAX_VALUE < abs(value) < math.inf:
            raise ConfigError(
                f"{word[:40]!r} in {text[:100]!r} is more than {MAX_VALUE:g} N, MPa or mm", hint="is the unit right?"
            )
        if value is not None and not math.isfinite(value):
            raise ConfigError(
                f"{word[:40]!r} in {text[:100]!r} is no number", hint=f"write for example '{example} on ...'"
            )
        values.append(value)
    return Condition(kind, region_of(after, part, near), tuple(values))
