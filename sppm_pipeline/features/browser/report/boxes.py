"""The numbers at the top of a report: porosity by every way it was found, what reports state, layers, time, memory.

Small charts as SVG, drawn by the page's own colors: curves over a number, or over directions.

`render.charts` draws the charts of results with matplotlib; those of a report need no more than axes, ticks and
polylines, follow the dark scheme, and must not make a report depend on an optional library.
"""

from __future__ import annotations

import html
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sppm_pipeline.nouns.artifact import Artifact, shown
from sppm_pipeline.nouns.report import Box, Chart, Curve, is_number
from sppm_pipeline.services.arrays import F64

WIDTH, HEIGHT = 560, 250
LEFT, RIGHT, TOP, BOTTOM = 62, 14, 14, 44


def ticks(low: float, high: float, about: int = 5) -> list[float]:
    """Round numbers from `low` to `high`: multiples of 1, 2 or 5 times a power of ten."""
    step = (high - low) / about
    power = 10.0 ** math.floor(math.log10(step))
    step = min((m * power for m in (1, 2, 5, 10) if m * power >= step), default=10 * power)
    # ends that are multiples but for rounding keep their ticks
    first = math.ceil(low / step - 1e-9)
    return [k * step for k in range(first, math.floor(high / step + 1e-9) + 1)]


def line_chart(curves: Sequence[Curve], x_label: str, y_label: str, *, id_: str = "") -> str:
    """Curves over one number as an ``<svg>``; empty if there is nothing to draw."""
    data = [(np.asarray(c.x, np.float64), np.asarray(c.y, np.float64)) for c in curves]
    known = [np.isfinite(x) & np.isfinite(y) for x, y in data]
    if not any(k.any() for k in known):
        return ""
    xs, ys = (np.concatenate([pair[i][k] for pair, k in zip(data, known, strict=True)]) for i in range(2))
    (x0, x1), (y0, y1) = _range(xs), _range(ys)
    right, bottom = WIDTH - RIGHT, HEIGHT - BOTTOM

    def across(x: Any) -> Any:
        return LEFT + (x - x0) / (x1 - x0) * (right - LEFT)

    def down(y: Any) -> Any:
        return bottom - (y - y0) / (y1 - y0) * (bottom - TOP)

    parts = []
    for tick in ticks(x0, x1, 6):
        parts.append(f'<path class="grid" d="M{across(tick):.1f} {TOP}V{bottom}"/>')
        parts.append(f'<text x="{across(tick):.1f}" y="{bottom + 15}" text-anchor="middle">{tick:.5g}</text>')
    for tick in ticks(y0, y1, 4):
        parts.append(f'<path class="grid" d="M{LEFT} {down(tick):.1f}H{right}"/>')
        parts.append(f'<text x="{LEFT - 6}" y="{down(tick) + 4:.1f}" text-anchor="end">{tick:.5g}</text>')
    for number, ((x, y), curve) in enumerate(zip(data, curves, strict=True)):
        if curve.points:
            ok = known[number]
            dots = zip(across(x[ok]).tolist(), down(y[ok]).tolist(), strict=True)
            parts += [f'<circle class="s{number % 4}" cx="{a:.1f}" cy="{b:.1f}" r="2.6"/>' for a, b in dots]
        else:
            parts.append(f'<path class="s{number % 4}" d="{_path(across(x), down(y))}"/>')
    parts.append(f'<path class="axis" d="M{LEFT} {TOP}V{bottom}H{right}"/>')
    parts.append(f'<text x="{(LEFT + right) / 2}" y="{HEIGHT - 8}" text-anchor="middle">{html.escape(x_label)}</text>')
    middle = (TOP + bottom) / 2
    parts.append(
        f'<text x="14" y="{middle}" text-anchor="middle" transform="rotate(-90 14 {middle})">'
        f"{html.escape(y_label)}</text>"
    )
    parts += _legend([curve.label for curve in curves], LEFT + 12, TOP + 8)
    # the page's script finds by these attributes what was clicked on
    where = f'id="{id_}" data-x0="{x0:.9g}" data-x1="{x1:.9g}" data-left="{LEFT}" data-right="{right}"' if id_ else ""
    name = html.escape(f"{y_label} over {x_label}", quote=True)
    return (
        f'<svg class="chart" {where} viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{name}">'
        f"{''.join(parts)}</svg>"
    )


def _range(values: F64) -> tuple[float, float]:
    low, high = float(values.min()), float(values.max())
    pad = 0.04 * (high - low) or 0.05 * abs(high) or 1.0
    # what begins at zero is seen to begin there
    return (low if low == 0 else low - pad), high + pad


def _path(x: F64, y: F64) -> str:
    """Path data; NaN interrupts it."""
    words, pen = [], False
    for a, b in zip(x.tolist(), y.tolist(), strict=True):
        if math.isfinite(a) and math.isfinite(b):
            words.append(f"{'L' if pen else 'M'}{a:.1f} {b:.1f}")
            pen = True
        else:
            pen = False
    return "".join(words)


def _legend(labels: Sequence[str], x: float, y: float) -> list[str]:
    parts = []
    for number, label in enumerate(labels):
        if label and len(labels) > 1:
            at = y + 15 * number
            parts.append(f'<path class="s{number % 4}" d="M{x} {at}h20"/>')
            parts.append(f'<text x="{x + 26}" y="{at + 4}">{html.escape(label)}</text>')
    return parts


def chart_svg(chart: Chart) -> str:
    """A chart that a report noun or a plugin describes, as an ``<svg>``; empty if there is nothing to draw."""
    if chart.polar:
        return polar_chart(chart.curves, chart.x_label)
    return line_chart(chart.curves, chart.x_label, chart.y_label)


def polar_chart(curves: Sequence[Curve], label: str) -> str:
    """Curves over the directions of a plane as an ``<svg>``, `x` the angles from the right (radians) and `y` distances
    from the middle, finite and not all zero; empty if there is nothing to draw. `label` says what the distances are.
    """
    data = [(np.asarray(c.x, np.float64), np.asarray(c.y, np.float64)) for c in curves]
    largest = max((float(radius.max()) for _, radius in data), default=0.0)
    if not 0 < largest < math.inf:
        return ""
    size, middle, radius = 320, 160.0, 118.0
    parts = []
    for value in ticks(0, largest, 3)[1:]:
        r = radius * value / largest
        parts.append(f'<circle class="ring" cx="{middle}" cy="{middle}" r="{r:.1f}"/>')
        parts.append(f'<text x="{middle + 3}" y="{middle - r - 3:.1f}">{value:.4g}</text>')
    parts.append(
        f'<path class="grid" d="M{middle - radius} {middle}h{2 * radius}M{middle} {middle - radius}v{2 * radius}"/>'
    )
    for number, (turn, distances) in enumerate(data):
        x, y = (radius * distances / largest * turned(turn) for turned in (np.cos, np.sin))
        parts.append(f'<path class="s{number % 4}" d="{_path(middle + x, middle - y)}"/>')
    parts += _legend([curve.label for curve in curves], 8, 12)
    parts.append(f'<text x="{middle}" y="{size - 8}" text-anchor="middle">{html.escape(label)}</text>')
    return (
        f'<svg class="chart polar" viewBox="0 0 {size} {size}" role="img" aria-label="{html.escape(label)}">'
        f"{''.join(parts)}</svg>"
    )


MAX_GAP = 0.003
"""Porosities that differ by more are shown in red: three times the default tolerance of `tune.porosity`."""


def porosities(stages: Sequence[Mapping[str, Any]], view: Mapping[str, Any] | None) -> list[tuple[str, float, str]]:
    """Porosity wanted, of the field, of the layers and of the mesh, as far as they are known: (what, value, stage).

    The field's is that which the last stage of its own reports, else that of the live view's samples. Layers and
    meshes are compared with the volume of the part, else with that of the cells.
    """
    found: dict[str, tuple[float, str]] = {}
    volume: float | None = None
    if view is not None and (cells := view.get("cells")):
        volume = math.prod(cells) * float(view.get("edge_mm") or 1.0) ** 3
        found["field"] = (float(view["porosity"]), "live view") if view.get("porosity") is not None else (math.nan, "")
    for stage in stages:
        summary, options = stage.get("summary", {}), stage.get("options", {})
        family = str(stage.get("stage", "")).split(".")[0]
        wanted = options.get("target" if stage.get("stage") == "tune.porosity" else "porosity")
        if family in ("tune", "tileset", "tile", "field") and is_number(wanted):
            found["wanted"] = (float(wanted), stage["id"])
        if is_number(summary.get("porosity")) and family in ("tune", "tileset", "tile", "field", "check"):
            found["field"] = (float(summary["porosity"]), stage["id"])
        domain = summary.get("domain")
        if isinstance(domain, Mapping) and is_number(domain.get("volume_mm3")):
            volume = float(domain["volume_mm3"])
            # porosity is that inside the part from here on
            if view is not None and view.get("kind") == "grid" and is_number(view.get("porosity")):
                found["field"] = (float(view["porosity"]), "live view")
        if not volume:
            continue
        if is_number(summary.get("solid_volume_mm3")) and family == "write":
            found["layers"] = (1 - float(summary["solid_volume_mm3"]) / volume, stage["id"])
        if family in ("extract", "fill") and is_number(summary.get("volume_mm3")):
            found["mesh"] = (1 - float(summary["volume_mm3"]) / volume, stage["id"])
        if is_number(summary.get("infill_porosity")):
            found["infill"] = (float(summary["infill_porosity"]), stage["id"])
    order = ("wanted", "infill", "field", "layers", "mesh")
    return [(what, *found[what]) for what in order if what in found and math.isfinite(found[what][0])]


def boxes(
    record: Mapping[str, Any], stages: Sequence[Mapping[str, Any]], view: Mapping[str, Any] | None,
    kinds: Mapping[str, type[Artifact]],
) -> list[Box]:  # fmt: skip
    """All boxes of a run; `kinds` are the types of what its stages made, by their ids."""
    made: list[Box] = []
    known = porosities(stages, view)
    # with a skin, what was wanted is the porosity of the infill, and the part has another
    summaries = [stage.get("summary", {}) for stage in stages]
    apart = any(summary.get("skin_mm") or summary.get("solid_mm") or summary.get("fills") for summary in summaries)
    of_infill = ("wanted", "infill") if apart else ()
    # samples of the live view are too coarse for thin skins; layers know better
    there = {what for what, _, stage in known if not (apart and stage == "live view")}
    known = [one for one in known if one[0] != "infill" or apart]
    known = [one for one in known if one[0] in there or "layers" not in there]
    for what, value, stage in known:
        others = [(n, value - other) for n, other, _ in known if n != what and (n in of_infill) == (what in of_infill)]
        far = max((abs(gap) for _, gap in others), default=0.0) > MAX_GAP
        gaps = ", ".join(f"{100 * gap:+.2f} to {name}".replace("-0.00", "+0.00") for name, gap in others)
        note = f"{gaps} ({stage})" if gaps else stage
        name = f"porosity {'of the infill' if what in of_infill else 'of the part' if apart else ''}".rstrip()
        made.append(
            Box(
                f"{name}: {'layers' if what == 'infill' else what}",
                f"{100 * value:.2f} %",
                note,
                far and what != "wanted",
            )
        )
    for maker in stages:
        if (kind := kinds.get(str(maker.get("id")))) is not None:
            made += kind.report_boxes(maker.get("summary", {}), str(maker["id"]))
    numbers = {
        "solid volume": ("solid_volume_mm3", "mm³"), "layers": ("layers", ""), "pixel": ("pixel_mm", "mm"),
        "layer": ("layer_mm", "mm"), "islands removed": ("removed_share", "%"),
    }  # fmt: skip
    for label, (name, unit) in numbers.items():
        # what was written comes before what was made on the way
        for source in sorted(stages, key=lambda s: not str(s["stage"]).startswith("write.")):
            found = source.get("summary", {}).get(name)
            if found is not None:
                text = f"{100 * found:.3g}" if unit == "%" and is_number(found) else _size(found)
                made.append(Box(label, f"{text} {unit}".rstrip(), str(source["id"])))
                break
    made.append(Box("time", duration(record.get("seconds")), f"{record.get('threads', '?')} threads"))
    if is_number(record.get("peak_memory_mb")):
        made.append(Box("peak memory", f"{record['peak_memory_mb']:.0f} MB"))
    return made


def _size(found: Any) -> str:
    """A number, or several along axes, once if they are the same."""
    if isinstance(found, (list, tuple)) and found and all(map(is_number, found)):
        return " x ".join(dict.fromkeys(map(shown, found)) if len(set(found)) == 1 else map(shown, found))
    return shown(found)


def duration(seconds: Any) -> str:
    """Seconds for people."""
    if not is_number(seconds):
        return "–"
    if seconds < 60:
        return f"{seconds:.3g} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"
