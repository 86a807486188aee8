"""``fill.engrave``: a number or a name, engraved in the surface of a part."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from sppm_pipeline import ConfigError, Context, DesignError, Length, Palette, Part, Size, Stage, option
from sppm_pipeline.features.printing.numerics.lettering import ADVANCE, GLYPHS, HIGH, in_pieces, laid_on, strokes

MAX_LETTERS = 40


@dataclass(frozen=True, kw_only=True)
class Engrave(Stage):
    """Engrave a line of digits and letters in the surface of a part, as grooves that a ball leaves along their strokes.

    The text lies on the surface, however that is curved: its strokes are laid on the triangles that face `facing`, near
    the place `middle`. Grooves are as wide as `stroke` at the surface and `groove_depth` deep. They win over skin and
    microstructure as drains do, so they need a skin, or solid faces (`solid_near` of `fill.implicit`), that is thicker.
    """

    name: ClassVar[str] = "fill.engrave"

    text: str = option(help="digits, letters (as capitals), and - . / + : _")
    middle: tuple[Length, Length, Length] = option(
        help="place of the text's middle, on the surface or near it", unit="mm", minimum=-1e5, maximum=1e5
    )
    facing: tuple[float, float, float] = option(
        (0.0, 0.0, 1.0), help="direction [x, y, z] from the surface to who reads it", minimum=-1e6, maximum=1e6
    )
    upward: tuple[float, float, float] = option(
        (0.0, 1.0, 0.0), help="direction [x, y, z] in which letters stand", minimum=-1e6, maximum=1e6
    )
    letter_height: Length = option(Length(5.0), help="height of the letters", unit="mm", minimum=0.1, maximum=1e4)
    stroke: Length | None = option(
        None, help="width of the strokes; an eighth of `letter_height` if omitted", unit="mm", minimum=0.01, maximum=1e3
    )
    groove_depth: Length | None = option(
        None,
        help="depth of the grooves; half of `stroke` if omitted, and at most",
        unit="mm",
        minimum=0.005,
        maximum=500,
    )

    @property
    def _sizes(self) -> tuple[float, float, float]:
        """Height, width of strokes and depth, mm."""
        height = self.letter_height.mm()
        stroke = height / 8 if self.stroke is None else self.stroke.mm()
        return height, stroke, stroke / 2 if self.groove_depth is None else self.groove_depth.mm()

    def check_options(self) -> None:
        """Letters that there are, of distinct strokes, and directions that make a frame."""
        text = self.text.upper()
        if not text.strip() or len(text) > MAX_LETTERS or (unknown := sorted(set(text) - GLYPHS.keys())):
            what = (
                f"has {', '.join(map(repr, unknown))}" if text.strip() and len(text) <= MAX_LETTERS else "is not that"
            )
            raise ConfigError(
                f"`text` is up to {MAX_LETTERS} digits and letters, and {self.text[:60]!r} {what}",
                hint=f"there are {''.join(sorted(GLYPHS)).strip()} and the blank",
            )
        height, stroke, depth = self._sizes
        if stroke > height / 4:
            raise ConfigError(
                f"strokes run together: `stroke` is {stroke:g} mm in letters of {height:g} mm", hint="at most a quarter"
            )
        if depth > stroke / 2 * (1 + 1e-9):
            raise ConfigError(
                f"`groove_depth` is {depth:g} mm, deeper than half of the width of grooves, {stroke:g} mm"
            )
        if not np.linalg.norm(np.cross(self.facing, self.upward)) > 1e-6 * np.linalg.norm(self.facing) * np.linalg.norm(
            self.upward
        ):
            raise ConfigError("`facing` and `upward` are two directions, and neither is 0 or along the other")

    def estimate(self, palette: Palette, part: Size) -> Size:
        return part

    def run(self, context: Context, part: Part) -> Part:
        """Lay the strokes on the surface, and take their grooves away."""
        height, stroke, depth = self._sizes
        toward = np.array(self.facing) / np.linalg.norm(self.facing)
        right = np.cross(self.upward, toward)
        right /= np.linalg.norm(right)
        up = np.cross(toward, right)
        middle = np.array([length.mm() for length in self.middle])
        lines = in_pieces(strokes(self.text.upper()) * (height / HIGH), max(stroke, height / 12))
        flat = np.concatenate(lines)
        points = middle + flat[:, :1] * right + flat[:, 1:] * up
        long = height / HIGH * (ADVANCE * len(self.text) - 2)
        outer = part.domain.outer_surface
        triangles = part.domain.vertices[part.domain.faces] if outer is None else outer.triangles
        places, normals, which = laid_on(points, toward, triangles, max(long, height))
        if (which < 0).any():
            raise DesignError(
                f"the text {self.text!r}, {long:.4g} x {height:.4g} mm, does not fit on {part.domain.name}: "
                f"{(which < 0).mean():.0%} of it meet no surface that faces {list(self.facing)} near {middle.tolist()}",
                hint="move `middle`, turn `facing`, or lower `letter_height`",
            )
        # a ball of this radius, so far below the surface, leaves a groove of that width
        radius = (stroke**2 / 4 + depth**2) / (2 * depth)
        centers = places + (radius - depth) * normals
        first, drains = 0, list(part.drains)
        for line in lines:
            own = centers[first : first + len(line)].tolist()
            drains += [(*a, *b, radius) for a, b in itertools.pairwise(own)]
            first += len(line)
        chosen = part.skin_faces
        # the triangles of the outer surface have other numbers
        covered = chosen is None or (outer is None and bool(np.isin(which, chosen).all()))
        if max(part.skin_mm if covered else 0.0, part.solid_mm) < depth:
            context.warn(
                f"grooves of {depth:g} mm are engraved where there may be no solid: the part has no skin of that "
                "thickness everywhere"
            )
        context.report(strokes=len(drains) - len(part.drains), width_mm=long, depth_mm=depth)
        return replace(part, drains=tuple(drains))
