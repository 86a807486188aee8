"""The numbers at the top of a report: porosity by every way it was found, stiffness, flow, layers, time, memory."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from sppm_pipeline.nouns.artifact import shown

FAR = 0.003
"""Porosities that differ by more are shown in red: three times what `tune.porosity` allows unless told."""


class Box(NamedTuple):
    """A number with its name, what it is compared with, and whether that is far off."""

    label: str
    value: str
    note: str = ""
    bad: bool = False


def porosities(stages: Sequence[Mapping[str, Any]], view: Mapping[str, Any] | None) -> list[tuple[str, float, str]]:
    """Porosity wanted, of the field, of the layers and of the mesh, as far as they are known: (what, value, stage).

    The field's is that which the last stage of its own reports, else that of the live view's samples. Layers and meshes
    are compared with the volume of the part, else with that of the cells.
    """
    found: dict[str, tuple[float, str]] = {}
    volume: float | None = None
    if view is not None and (cells := view.get("cells")):
        volume = math.prod(cells) * float(view.get("edge_mm") or 1.0) ** 3
        found["field"] = (float(view["porosity"]), "live view") if view.get("porosity") is not None else (math.nan, "")
    for stage in stages:
        summary, options, made = stage.get("summary", {}), stage.get("options", {}), stage.get("made")
        family = str(stage.get("stage", "")).split(".")[0]
        wanted = options.get("target" if stage.get("stage") == "tune.porosity" else "porosity")
        if family in ("tune", "tileset", "tile", "field") and _number(wanted):
            found["wanted"] = (float(wanted), stage["id"])
        if _number(summary.get("porosity")) and family in ("tune", "tileset", "tile", "field", "check"):
            found["field"] = (float(summary["porosity"]), stage["id"])
        domain = summary.get("domain")
        if made == "Part" and isinstance(domain, Mapping) and _number(domain.get("volume_mm3")):
            volume = float(domain["volume_mm3"])
            # porosity is that inside the part from here on
            if view is not None and view.get("kind") == "grid" and _number(view.get("porosity")):
                found["field"] = (float(view["porosity"]), "live view")
        if not volume:
            continue
        if _number(summary.get("solid_volume_mm3")) and family == "write":
            found["layers"] = (1 - float(summary["solid_volume_mm3"]) / volume, stage["id"])
        if made == "SurfaceMesh" and family in ("extract", "fill") and _number(summary.get("volume_mm3")):
            found["mesh"] = (1 - float(summary["volume_mm3"]) / volume, stage["id"])
    order = ("wanted", "field", "layers", "mesh")
    return [(what, *found[what]) for what in order if what in found and math.isfinite(found[what][0])]


def boxes(record: Mapping[str, Any], stages: Sequence[Mapping[str, Any]], view: Mapping[str, Any] | None) -> list[Box]:
    """All boxes of a run."""
    made: list[Box] = []
    known = porosities(stages, view)
    for what, value, stage in known:
        others = [(name, value - other) for name, other, _ in known if name != what]
        far = max((abs(gap) for _, gap in others), default=0.0) > FAR
        gaps = ", ".join(f"{100 * gap:+.2f} to {name}".replace("-0.00", "+0.00") for name, gap in others)
        note = f"{gaps} ({stage})" if gaps else stage
        made.append(Box(f"porosity: {what}", f"{100 * value:.2f} %", note, far and what != "wanted"))
    made += [box for stage in stages for box in _properties(stage)]
    numbers = {
        "solid volume": ("solid_volume_mm3", "mm³"), "layers": ("layers", ""), "pixel": ("pixel_mm", "mm"),
        "layer": ("layer_mm", "mm"), "islands removed": ("removed_share", "%"),
    }  # fmt: skip
    for label, (name, unit) in numbers.items():
        # what was written comes before what was made on the way
        for source in sorted(stages, key=lambda s: not str(s["stage"]).startswith("write.")):
            found = source.get("summary", {}).get(name)
            if found is not None:
                text = f"{100 * found:.3g}" if unit == "%" and _number(found) else _size(found)
                made.append(Box(label, f"{text} {unit}".rstrip(), str(source["id"])))
                break
    made.append(Box("time", duration(record.get("seconds")), f"{record.get('threads', '?')} threads"))
    if _number(record.get("peak_memory_mb")):
        made.append(Box("peak memory", f"{record['peak_memory_mb']:.0f} MB"))
    return made


def _properties(stage: Mapping[str, Any]) -> list[Box]:
    """Stiffness and permeability, if the stage reports them, with their error bars."""
    summary, made = stage.get("summary", {}), []
    moduli, errors = summary.get("E"), summary.get("E_error")
    if stage.get("made") == "StiffnessReport" and isinstance(moduli, Sequence) and moduli and all(map(_number, moduli)):
        unit = f" {summary['unit']}" if summary.get("unit") else ""
        bar = isinstance(errors, Sequence) and errors and all(map(_number, errors))
        note = f"± {max(errors):.2g}{unit}, {stage['id']}" if bar else str(stage["id"])
        values = ", ".join(f"{value:.3g}" for value in moduli)
        made.append(Box("Young's modulus x, y, z", f"{values}{unit}", note))
    if stage.get("made") == "PermeabilityReport":
        mean, share = summary.get("k_mean"), summary.get("error_relative")
        note = f"± {100 * share:.2g} %, {stage['id']}" if _number(share) else str(stage["id"])
        if _number(summary.get("darcy_mean")):
            made.append(Box("permeability", f"{summary['darcy_mean']:.3g} darcy", note))
        elif _number(mean):
            made.append(Box("permeability", f"{mean:.3g} cell²", note))
    return made


def _size(found: Any) -> str:
    """A number, or several along axes, once if they are the same."""
    if isinstance(found, (list, tuple)) and found and all(map(_number, found)):
        return " x ".join(dict.fromkeys(map(shown, found)) if len(set(found)) == 1 else map(shown, found))
    return shown(found)


def duration(seconds: Any) -> str:
    """Seconds for people."""
    if not _number(seconds):
        return "–"
    if seconds < 60:
        return f"{seconds:.3g} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"


def _number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
