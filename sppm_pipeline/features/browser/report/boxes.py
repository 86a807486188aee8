"""The numbers at the top of a report: porosity by every way it was found, what reports state, layers, time, memory."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from sppm_pipeline.nouns.artifact import Artifact, shown
from sppm_pipeline.nouns.report import Box, is_number

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
    order = ("wanted", "field", "layers", "mesh")
    return [(what, *found[what]) for what in order if what in found and math.isfinite(found[what][0])]


def boxes(
    record: Mapping[str, Any],
    stages: Sequence[Mapping[str, Any]],
    view: Mapping[str, Any] | None,
    kinds: Mapping[str, type[Artifact]],
) -> list[Box]:
    """All boxes of a run; `kinds` are the types of what its stages made, by their ids."""
    made: list[Box] = []
    known = porosities(stages, view)
    for what, value, stage in known:
        others = [(name, value - other) for name, other, _ in known if name != what]
        far = max((abs(gap) for _, gap in others), default=0.0) > MAX_GAP
        gaps = ", ".join(f"{100 * gap:+.2f} to {name}".replace("-0.00", "+0.00") for name, gap in others)
        note = f"{gaps} ({stage})" if gaps else stage
        made.append(Box(f"porosity: {what}", f"{100 * value:.2f} %", note, far and what != "wanted"))
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
