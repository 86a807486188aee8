"""Report on a stack of layers, in millimeters: numbers, events, curves over the height, and rules."""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import ConfigError
from sppm_pipeline.services.arrays import F64, I32, U8, Array

if TYPE_CHECKING:
    from sppm_pipeline.method.nouns.mesh import SurfaceMesh
    from sppm_pipeline.services.pictures.shading import Color

MARKS: tuple[tuple[str, Color], ...] = (
    ("void", (24, 26, 30)),
    ("solid", (236, 238, 241)),
    ("overhang", (150, 156, 166)),
    ("island", (255, 221, 51)),
    ("suction cup", (51, 136, 255)),
    ("resin trap", (255, 128, 0)),
)
"""Meaning and color of each code, in the order of `numerics.printing.scan`: those that users of UVtools know."""

_PANEL = 460

_VIEW = 320
"""Pixels along the side of the picture of an orientation: six of them fill the width of a screen."""


def marked_layer(codes: U8) -> U8:
    """A layer (ny, nx) of codes as a picture (ny, nx, 3), the side of largest y on top."""
    return np.array([color for _, color in MARKS], np.uint8)[codes[::-1]]


def marked_sheet(layers: Sequence[tuple[int, U8]], pixel: tuple[float, float], columns: Mapping[str, Array]) -> U8:
    """Marked layers side by side, with what is wrong with each below it, and the meaning of the colors above.

    `layers` are numbers and codes (ny, nx), shown in the ratio of the pitches `pixel` along x and y; `columns` the
    curves of the report, (n,) each, whose areas are shown.
    """
    from PIL import Image, ImageDraw  # only pictures with text need Pillow

    from sppm_pipeline.services.pictures.sheets import contact_sheet, font

    pictures, labels = [], []
    for k, codes in layers:
        ny, nx = codes.shape
        scale = _PANEL / max(nx, ny * pixel[1] / pixel[0])
        size = (max(1, round(nx * scale)), max(1, round(ny * pixel[1] / pixel[0] * scale)))
        way = Image.Resampling.BOX if scale < 1 else Image.Resampling.NEAREST
        pictures.append(np.asarray(Image.fromarray(marked_layer(codes)).resize(size, way)))
        areas = [
            f"{word} {columns[name][k]:.3g} mm^2"
            for word, name in (("sealed", "sealed_mm2"), ("floating", "floating_mm2"), ("overhang", "overhang_mm2"))
            if columns[name][k]
        ]
        labels.append(f"layer {k} ({columns['top_mm'][k]:.4g} mm): {', '.join(areas)}")
    sheet = contact_sheet(pictures, labels, columns=min(3, len(pictures)), text_size=15)
    legend = Image.new("RGB", (sheet.shape[1], 44), (255, 255, 255))
    pen, x = ImageDraw.Draw(legend), 20
    for word, color in MARKS:
        pen.rectangle((x, 14, x + 18, 32), fill=color, outline=(90, 90, 90))
        pen.text((x + 26, 23), word, fill=(52, 58, 66), font=font(15), anchor="lm")
        x += 26 + int(font(15).getlength(word)) + 26
    return np.concatenate([np.asarray(legend), sheet])


def curves_chart(columns: Mapping[str, Array]) -> bytes:
    """Area, cups, islands and overhang of each layer over its height, as PNG; layers without any are left out."""
    from sppm_pipeline.services.pictures.charts import Series, chart

    shown = (
        ("area_mm2", "solid", "#000000"),
        ("overhang_mm2", "overhang", "#888888"),
        ("sealed_mm2", "sealed (cups, traps)", "#0072b2"),
        ("floating_mm2", "not on the plate yet", "#e69f00"),
    )
    series = [
        Series(columns["top_mm"], columns[name], label, "line", color=color)
        for name, label, color in shown
        if (columns[name] > 0).any()
    ]
    return chart(
        series, "layers.png", x_label="height (mm)", y_label="area of the layer (mm²)", log_y=True, size=(7.5, 3.6)
    )


def throats_chart(rows: Sequence[Mapping[str, float]]) -> bytes:
    """Room of balls that can't leave over their diameter, as PNG."""
    from sppm_pipeline.services.pictures.charts import Series, chart

    x, y = ([row[name] for row in rows] for name in ("diameter_mm", "undrained_mm3"))
    series = [Series(x, y, kind="line", color="#0072b2"), Series(x, y, color="#0072b2")]
    return chart(series, "throats.png", x_label="throat (mm)", y_label="centers of balls that can't leave (mm³)")


def orientations_sheet(rows: Sequence[Mapping[str, Any]], views: Sequence[F64], voxel: float) -> U8:
    """Orientations side by side, the best first, seen from the front, with turn, score and costs below each.

    `rows` have ``turn``, ``score``, ``supports_mm2``, ``cups_mm2``, ``height_mm``, ``pareto``; `views`, (nz, nx), are
    depths from 0 to 1, lowest layer first, NaN where nothing is; `voxel` is an edge, mm.
    """
    from sppm_pipeline.services.pictures.sheets import contact_sheet

    trimmed = [view[~np.isnan(view).all(1)] for view in views]
    side = max(max(view.shape) for view in trimmed)
    zoom = max(1, round(_VIEW / side))
    pictures, labels = [], []
    for row, view in zip(rows, trimmed, strict=True):
        framed = np.full((side, side), np.nan)
        left = (side - view.shape[1]) // 2
        framed[: len(view), left : left + view.shape[1]] = view  # all stand on one line
        light = np.nan_to_num(1 - 0.75 * framed)[..., None] * np.array(MARKS[1][1])
        picture = np.where(np.isnan(framed)[..., None], MARKS[0][1], light).astype(np.uint8)[::-1]
        pictures.append(picture.repeat(zoom, 0).repeat(zoom, 1))
        x, y, _ = row["turn"]
        costs = f"{row['supports_mm2']:.3g}, {row['cups_mm2']:.3g} mm2, {row['height_mm']:.3g} mm"
        labels.append(f"{'* ' if row['pareto'] else ''}{x:.4g}, {y:.4g}: {row['score']:.3g}; {costs}")
    title = (
        "Turn about x, y: score; supports, cups, height. * none is better in one and as good in all. "
        f"Voxels of {voxel:.3g} mm hide what is thinner"
    )
    return contact_sheet(pictures, labels, columns=6, title=title, gap=16, text_size=17)


def drains_sheet(part: SurfaceMesh, vertices: F64, faces: I32) -> U8:
    """A part from two opposite sides, above and below, with the plugs (n, 3), (m, 3) of its drains in color."""
    from sppm_pipeline.services.pictures.camera import Camera
    from sppm_pipeline.services.pictures.mesh_view import render_mesh
    from sppm_pipeline.services.pictures.sheets import contact_sheet

    points = np.concatenate([part.vertices, vertices])
    triangles = np.concatenate([part.faces, faces + len(part.vertices)])
    colors = np.repeat([MARKS[1][1], MARKS[5][1]], [len(part.faces), len(faces)], axis=0).astype(np.uint8)
    views = [Camera(azimuth, elevation) for azimuth in (-60.0, 120.0) for elevation in (25.0, -25.0)]
    pictures = [
        render_mesh(points, triangles, camera=view, size=(_PANEL, _PANEL), face_colors=colors) for view in views
    ]
    labels = [f"{'above' if view.elevation > 0 else 'below'}, from {view.azimuth:g} degrees" for view in views]
    return contact_sheet(pictures, labels, columns=2, text_size=15)


class Measure(NamedTuple):
    """A number of the report that a rule may refuse."""

    number: str  # its name in `PrintReport.numbers`
    unit: str  # empty for a ratio or count
    text: str  # its name in the message of a refused print
    sign: str = ">"  # ">" or "<", on which side of a threshold it is refused


MEASURES: Mapping[str, Measure] = {
    "trap": Measure("trap_mm3", "mm3", "void in resin traps"),
    "cup": Measure("largest_cup_mm2", "mm2", "largest section of a suction cup"),
    "island": Measure("largest_island_mm2", "mm2", "largest section of an island"),
    "floating": Measure("floating_mm3", "mm3", "solid that never joins the part"),
    "overhang": Measure("largest_overhang_mm2", "mm2", "largest overhang of a layer"),
    "undrained": Measure("undrained_mm3", "mm3", "void that does not drain through throats of `drain`"),
    "way": Measure("way_out_mm", "mm", "longest way out of void that drains through throats of `drain`"),
    "thin": Measure("thin_solid_share", "", "share of the solid that is thinner than `min_feature`"),
    "clogged": Measure("clogged_mm3", "mm3", "void that later layers cure shut"),
    "adhesion": Measure("adhesion", "", "first layer over the largest one", "<"),
    "margin": Measure("foot_margin_mm", "mm", "distance of the center of mass from the edge of the foot", "<"),
}
"""Names that `fail:` accepts."""

_RULE = re.compile(r"\s*([a-z_]+)\s*(?:([<>])\s*(-?[0-9.]+(?:e-?[0-9]+)?)\s*([a-z0-9]*)\s*)?")


class Rule(NamedTuple):
    """A measure and the threshold beyond which a print is refused."""

    measure: Measure
    threshold: float

    def broken_by(self, numbers: Mapping[str, Any]) -> str | None:
        """Violation of this rule in words; None if there is none, or if the number is not known."""
        value = numbers.get(self.measure.number)
        if value is None or not (value > self.threshold if self.measure.sign == ">" else value < self.threshold):
            return None
        unit = f" {self.measure.unit}" if self.measure.unit else ""
        word = "more" if self.measure.sign == ">" else "less"
        limit = f", {word} than {self.threshold:g}" if self.threshold else ""
        return f"{self.measure.text}: {value:.4g}{unit}{limit}"


def parse_rule(text: str, measures: Mapping[str, Measure] = MEASURES) -> Rule:
    """Read ``trap`` or ``cup > 100 mm2``; `measures` are what it may name. ConfigError if it is no such rule."""
    match = _RULE.fullmatch(text)
    name = match[1] if match else ""
    if match is None or name not in measures:
        example = next(
            f"{name} {m.sign} {'100' if m.unit else '0.1'} {m.unit}".rstrip() for name, m in measures.items()
        )
        raise ConfigError(
            f"{text!r} in `fail` is no rule", hint=f"write for example {example!r}; known: {', '.join(measures)}"
        )
    measure = measures[name]
    if match[2] is None:
        if measure.sign == "<":
            raise ConfigError(f"{text!r} in `fail` needs a threshold", hint=f"write for example '{name} < 1'")
        return Rule(measure, 0.0)
    if match[2] != measure.sign or match[4] not in ("", measure.unit):
        form = f"{name} {measure.sign} NUMBER {measure.unit}".rstrip()
        raise ConfigError(f"{text!r} in `fail` can't be compared", hint=f"the rule is written '{form}'")
    try:
        return Rule(measure, float(match[3]))
    except ValueError as error:
        raise ConfigError(f"{match[3]!r} in {text!r} of `fail` is not a number") from error


@dataclass(frozen=True, eq=False)
class PrintReport:
    """Results of a check of a stack of layers.

    `numbers` are the measures that the terminal, the run record and `fail` know; None where there is nothing to
    measure. `events` are ``traps``, ``cups`` and ``islands``, the largest first, with layers, volume, largest section
    and place; and ``throats``, by diameter.
    """

    numbers: Mapping[str, Any]
    events: Mapping[str, Sequence[Mapping[str, Any]]]
    layers: Mapping[str, Array]  # a column (n,) for each curve
    settings: Mapping[str, Any]  # pitch, limits and assumptions

    @property
    def verdict(self) -> str:
        """One sentence."""
        n = self.numbers
        said = [trapped(n) if n["traps"] else "no resin trap"]
        if n["cups"] or n["traps"]:
            other = "other " if n["traps"] else ""
            said.append(f"{_count(n['cups'], f'{other}suction cup')}, sections up to {n['largest_cup_mm2']:.4g} mm2")
        else:
            said.append("no suction cup")
        said.append(
            f"{_count(n['islands'], 'island')} up to {n['largest_island_mm2']:.3g} mm2" if n["islands"] else "no island"
        )
        if n["floating_parts"]:
            said.append(f"{_count(n['floating_parts'], 'part')} afloat ({n['floating_mm3']:.4g} mm3)")
        return "; ".join(said)

    def json(self) -> str:
        """The report without the curves, as JSON."""
        document = {"verdict": self.verdict, "numbers": self.numbers, **self.events, "settings": self.settings}
        return json.dumps(_plain(document), indent=1, allow_nan=False) + "\n"

    def csv(self) -> str:
        """The curves, a row for each layer."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self.layers)
        columns = [[_short(value) for value in column.tolist()] for column in self.layers.values()]
        writer.writerows(zip(*columns, strict=True))
        return text.getvalue()


def _short(value: float) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _plain(value: Any) -> Any:
    """Numbers to six digits, as nothing here is known better."""
    if isinstance(value, float):
        return float(f"{value:.6g}")
    if isinstance(value, Mapping):
        return {key: _plain(inner) for key, inner in value.items()}
    return [_plain(inner) for inner in value] if isinstance(value, (list, tuple)) else value


def trapped(numbers: Mapping[str, Any]) -> str:
    """Summary of the traps in words."""
    traps, largest = numbers["traps"], numbers["largest_trap_mm3"]
    most = f" (the largest {largest:.4g})" if traps > 1 else ""
    return f"{_count(traps, 'resin trap')} of {numbers['trap_mm3']:.4g} mm3{most}"


def _count(n: int, what: str) -> str:
    return f"{n:,} {what}{'' if n == 1 else 's'}"


def rounded(values: NDArray[np.floating[Any]]) -> list[float]:
    """Coordinates as they are written: to a tenth of a micrometer."""
    return [round(float(value), 4) for value in values]
