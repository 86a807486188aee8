"""The report of a run directory as one HTML file."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

from sppm_pipeline.engine.plan.plugins import Plugins, load_plugins
from sppm_pipeline.engine.plan.ports import signature_of
from sppm_pipeline.engine.plan.registry import Registry
from sppm_pipeline.engine.run.events import PluginHooks, list_of
from sppm_pipeline.engine.run.outputs import RECORD
from sppm_pipeline.engine.run.verification import differences, verify_run
from sppm_pipeline.errors import InputError, SppmError, described
from sppm_pipeline.features.browser.live.page import (
    ASSETS,
    LIVE_SCRIPTS,
    environment,
    head_of,
    joined_script,
    json_block,
    policy,
    room_of_view,
    wanted,
)
from sppm_pipeline.features.browser.report.boxes import boxes, chart_svg, duration, line_chart
from sppm_pipeline.features.browser.report.layers import (
    Layers,
    data_uri,
    layers_of,
    outputs_of,
    pictures_of,
    stored_layers,
)
from sppm_pipeline.features.browser.report.records import without_folders
from sppm_pipeline.features.browser.report.sweeps import sweep_context
from sppm_pipeline.nouns.artifact import Artifact, shown
from sppm_pipeline.nouns.report import Curve, ReportSection

BOX, HIGH, GAP, DOWN = 190, 40, 18, 34
"""Width and height of a box, and the gaps beside and below it; choices."""

LONGEST = 24
"""Characters of a name that fit into a box."""


def wiring_svg(stages: Sequence[Mapping[str, Any]]) -> str:
    """Boxes in rows by the longest way from a stage without inputs; empty for no stages. Of each stage, in order,
    `id`, `stage`, `state` ("done", "kept", "failed" or "missing"), `inputs` (port -> id) and `recipes` are taken.
    """
    if not stages:
        return ""
    rank: dict[str, int] = {}
    for stage in stages:
        sources = [rank[s] for s in stage["inputs"].values() if s in rank]
        # below all that it takes something from, so that lines lead down
        rank[stage["id"]] = max(sources, default=-1) + 1
    rows: dict[int, list[Mapping[str, Any]]] = {}
    for stage in stages:
        rows.setdefault(rank[stage["id"]], []).append(stage)
    most = max(len(row) for row in rows.values())
    width = most * (BOX + GAP) + GAP
    place = {
        stage["id"]: (width / 2 + (column - (len(row) - 1) / 2) * (BOX + GAP), GAP + r * (HIGH + DOWN))
        for r, row in rows.items()
        for column, stage in enumerate(row)
    }
    height = GAP + (max(rows) + 1) * (HIGH + DOWN)
    parts = []
    for stage in stages:
        x, y = place[stage["id"]]
        for source in stage["inputs"].values():
            if source in place:
                a, b = place[source]
                bend = (y - b - HIGH) / 2
                parts.append(
                    f'<path class="wire" d="M{a:.1f} {b + HIGH}C{a:.1f} {b + HIGH + bend:.1f} {x:.1f} '
                    f'{y - bend:.1f} {x:.1f} {y}"/>'
                )
    for stage in stages:
        x, y = place[stage["id"]]
        recipes = ", ".join(str(name) for name in stage["recipes"].values())
        below = stage["stage"] if stage["stage"] != stage["id"] else f"recipe {recipes}" if recipes else ""
        title = f"{stage['id']} ({stage['stage']}): {stage['state']}"
        parts.append(
            f'<g class="{stage["state"]}"><title>{html.escape(title)}</title>'
            f'<rect x="{x - BOX / 2:.1f}" y="{y}" width="{BOX}" height="{HIGH}" rx="6"/>'
            f'<text x="{x:.1f}" y="{y + (17 if below else 25)}" text-anchor="middle">{_cut(stage["id"])}</text>'
            + (
                f'<text class="minor" x="{x:.1f}" y="{y + 32}" text-anchor="middle">{_cut(below)}</text>'
                if below
                else ""
            )
            + "</g>"
        )
    return (
        f'<svg class="wiring" viewBox="0 0 {width} {height}" style="max-width:{width}px" role="img" '
        f'aria-label="wiring of {len(stages)} stages">{"".join(parts)}</svg>'
    )


def _cut(text: str) -> str:
    return html.escape(text if len(text) <= LONGEST else f"{text[: LONGEST - 1]}…")


def kinds_of(stages: Sequence[Mapping[str, Any]], registry: Registry) -> dict[str, type[Artifact]]:
    """The type of what each recorded stage made, by its id.

    It is that of this name among the results that the stages of the run and of its recipes announce, else what the
    stage itself announces; stages that are not known, because a plugin is not loaded, are left out.
    """
    known: dict[str, type[Artifact]] = {}
    announced: dict[str, type[Artifact]] = {}
    for stage in stages:
        for one in (stage, *stage.get("inner", ())):
            for kind in _announced(str(one.get("stage")), registry):
                known[kind.__name__] = kind
                announced.setdefault(str(one["id"]), kind)
    kinds = ((str(stage["id"]), known.get(str(stage.get("made")))) for stage in stages if stage.get("made"))
    return {id_: found for id_, kind in kinds if (found := kind or announced.get(id_)) is not None}


def _announced(name: str, registry: Registry) -> Iterator[type[Artifact]]:
    try:
        makes = signature_of(registry.get(name)).makes
    except SppmError:
        return
    yield from (kind for kind in makes if isinstance(kind, type) and issubclass(kind, Artifact))


def sections_of(record: Mapping[str, Any], plugins: Plugins) -> list[ReportSection]:
    """The sections of all plugins; what one raises stands in the place of its own."""
    found: list[ReportSection] = []
    hooks = PluginHooks(plugins.plugins)
    for plugin, own, wrong in hooks.call("sppm_report_sections", record, list_of(ReportSection)):
        found += [ReportSection(str(plugin), f"sppm_report_sections {wrong}")] if wrong else own
    return found


HERE = Path(__file__).parent

PICTURES_SHARE, PAGE = 0.1, 120_000
"""Share of a report that pictures may take, and bytes of the page itself, which are heuristics."""

LONGEST_NAME = 300
"""Characters of a name or text that are shown; `run.json` has all of them."""

LONGEST_TEXT = 200_000
"""Characters of the configuration that are shown."""


def report_html(
    path: Path, record: Mapping[str, Any], *, view: bytes | None = None, note: str = "", max_bytes: int = 5_000_000,
    threads: int = 1, plugins: Plugins | None = None, views: Mapping[str, bytes] = MappingProxyType({}),
) -> str:  # fmt: skip
    """The report of a run, the same text for the same directory; `InputError` if the record is not as this program
    writes them.

    Files whose digests are wrong are named in red. `view` is a view file, as ``write.view`` writes it, `note` says why
    there is none, and what to do. The view comes first; layers get what it and the pictures leave of `max_bytes`.
    Results and sections are shown of the stages of `plugins`, the built-in ones if omitted. `views` are view files of
    runs of a sweep.
    """
    raw = max_bytes * 3 // 4  # base64 makes 4 characters of 3 bytes
    if view is not None and len(view) > room_of_view(max_bytes):
        note, view = f"The live view takes {wanted(len(view))}.", None
    try:
        # a report may be mailed: what follows sees no folder of this disk
        record = without_folders(record)
        context = _context(path, record, view, raw, threads, plugins or load_plugins(distributions=False), views)
    except (KeyError, TypeError, AttributeError, ValueError, IndexError) as error:
        raise InputError(
            f"the record in {str(path)!r} is not as this program writes them: {described(error)}",
            hint="`sppm verify` shows whether it was changed",
        ) from error
    return _rendered(context | {"note": note, "seal": str(record.get("sha256", ""))})


def _context(
    path: Path,
    record: Mapping[str, Any],
    view: bytes | None,
    raw: int,
    threads: int,
    plugins: Plugins,
    views: Mapping[str, bytes],
) -> dict[str, Any]:
    stages: list[Mapping[str, Any]] = list(record["stages"])
    outputs = outputs_of(path, stages)
    view_head = head_of(view) if view is not None else None
    registry = Registry(plugins)
    sections = sections_of(record, plugins)
    pictures = pictures_of(path, outputs, int(PICTURES_SHARE * raw))
    shown_sections = [_section(path, section, int(PICTURES_SHARE * raw)) for section in sections]
    left = raw - len(view or b"") - sum(len(p.source) * 3 // 4 for p in pictures) - PAGE
    stored = stored_layers(path, stages, registry)
    layers = layers_of(*stored, left - sum(one["bytes"] for one in shown_sections)) if stored is not None else None
    still = next((p for p in pictures if _written_by(p.name, stages) == "write.picture"), None)
    if still is not None:
        pictures.remove(still)
    shown_stages = _stages(record, stages)
    found, files = verify_run(path, threads)
    kinds = kinds_of(stages, registry)
    described = (
        chart
        for stage in stages
        if (kind := kinds.get(str(stage["id"]))) is not None
        for chart in kind.report_charts(stage["summary"])
    )
    charts = [drawn for chart in described if (drawn := chart_svg(chart))]
    data: dict[str, str] = {}
    if layers is not None:
        overview = f"{Path(layers.folder).with_suffix('').as_posix()}-overview.png"
        pictures = [picture for picture in pictures if picture.name != overview]
        data["layers"] = base64.b64encode(b"".join(layers.files)).decode()
    if view is not None:
        data["view"] = base64.b64encode(view).decode()
    sweep = sweep_context(path, record, views) if "runs" in record else None
    if views:
        data["views"] = base64.b64encode(b"".join(views.values())).decode()
        view_head = head_of(next(iter(views.values())))
    if sweep is not None and sweep["packed"]:
        data["rows"] = sweep["packed"]
    return {
        "name": str(record["name"]), "status": str(record["status"]), "error": record.get("error"),
        "facts": _facts(record), "audit": record.get("audit"),
        "boxes": [box for section in sections for box in section.boxes]
        + (boxes(record, stages, view_head, kinds) if sweep is None else sweep["boxes"]),
        "warnings": [
            (str(one.get("id", "")), str(said)) for one in ({"warnings": record.get("warnings", ())}, *stages)
            for said in one.get("warnings", ())
        ], "view": view_head, "still": still,
        "layers": None if layers is None else _layers(layers, view_head),
        "layers_head": None if layers is None else json_block(layers.head()), "charts": charts,
        "sections": shown_sections, "pictures": pictures,
        "wiring": wiring_svg(shown_stages), "stages": shown_stages, "sweep": sweep,
        "provenance": {
            "yaml": _yaml(record.get("config"))[:LONGEST_TEXT], "files": files,
            "findings": [replace(one, detail=without_folders(one.detail)) for one in found],
            "differences": differences(path), "platform": _pairs(record.get("platform", {})),
            "versions": _pairs(record.get("versions", {})),
            "plugins": [shown(plugin) for plugin in record.get("plugins", ())],
            "seal": str(record.get("sha256", "none")),
        },
        "data": data,
    }  # fmt: skip


def _rendered(context: Mapping[str, Any]) -> str:
    pages = environment(HERE / "templates")
    pages.filters["cut"] = cut
    pages.filters["value"] = shown
    pages.filters["duration"] = duration
    wanted = {"layers.js": context["layers"] is not None, "sweep.js": context["sweep"] is not None}
    live = LIVE_SCRIPTS if context["view"] is not None else ()
    own = [HERE / "assets" / name for name, there in wanted.items() if there]
    script = joined_script(ASSETS / "base.js", *own, *(ASSETS / name for name in live))
    style = (HERE / "assets" / "report.css").read_text(encoding="utf-8")
    style += (ASSETS / "live.css").read_text(encoding="utf-8") if context["view"] is not None else ""
    template = pages.get_template("report.html")
    return template.render(**context, script=script, style=style, policy=policy(script))


def cut(text: Any, most: int = LONGEST_NAME) -> str:
    """A name or text as it is shown: very long ones cut."""
    words = str(text)
    return words if len(words) <= most else f"{words[: most - 1]}…"


def _facts(record: Mapping[str, Any]) -> list[tuple[str, str]]:
    versions = record.get("versions", {})
    facts = [
        ("seed", str(record["seed"])),
        ("parameters", ", ".join(f"{name} = {shown(value)}" for name, value in record["params"].items()) or "none"),
        ("started", str(record["started"])),
        ("program", f"sppm {versions.get('sppm_pipeline', '?')}, Python {versions.get('python', '?')}"),
        ("configuration", Path(str(record["file"])).name),
        ("make it again", f"sppm run {RECORD}"),  # options set on the command line stand in it, too
    ]
    return [*facts, ("until", str(record["until"]))] if record.get("until") else facts


def _stages(record: Mapping[str, Any], stages: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The stages that ran, and after them those of the pipeline that did not."""
    longest = max((float(stage["seconds"]) for stage in stages), default=0.0) or 1.0
    error = record.get("error") or {}
    shown_stages: list[dict[str, Any]] = []
    for stage in stages:
        state = "failed" if stage.get("rejected") else "kept" if stage.get("cached") else "done"
        shown_stages.append(
            {
                "id": str(stage["id"]), "stage": str(stage["stage"]), "state": state, "made": stage.get("made") or "",
                "seconds": duration(stage["seconds"]), "memory": stage.get("peak_memory_mb"),
                "bar": round(100 * float(stage["seconds"]) / longest, 1), "summary": _pairs(stage["summary"]),
                "options": _pairs(stage.get("options", {})), "inputs": dict(stage.get("inputs", {})),
                "recipes": dict(stage.get("recipes", {})), "outputs": list(stage.get("outputs", ())),
                "inner": [
                    {"id": str(one["id"]), "runs": one.get("runs", 1), "seconds": duration(one.get("seconds")),
                     "summary": _pairs(one.get("summary", {}))}
                    for one in stage.get("inner", ())
                ],
            }
        )  # fmt: skip
    config = record.get("config")
    entries = config.get("pipeline" if "runs" not in record else "after") or () if isinstance(config, Mapping) else ()
    there = {stage["id"] for stage in shown_stages}
    # stages that did not run are drawn one below the other, as what they take is not in the record
    before = shown_stages[-1]["id"] if shown_stages else None
    for entry in entries if record["status"] != "done" else ():
        id_ = str(entry.get("id", entry.get("stage")))
        if id_ not in there:
            failed = (
                error.get("stage") in (id_, None) if not any(s["state"] == "failed" for s in shown_stages) else False
            )
            shown_stages.append(
                {"id": id_, "stage": str(entry.get("stage")), "state": "failed" if failed and error else "missing",
                 "made": "", "seconds": "–", "memory": None, "bar": 0, "summary": [], "options": [],
                 "inputs": {"after": before} if before else {}, "recipes": {}, "outputs": [], "inner": []}
            )  # fmt: skip
            before = id_
    return shown_stages


def _pairs(values: Mapping[str, Any]) -> list[tuple[str, str]]:
    return [(str(name), shown(value)) for name, value in values.items()]


def _written_by(name: str, stages: Sequence[Mapping[str, Any]]) -> str:
    for stage in stages:
        if any(output.get("path") == name for output in stage.get("outputs", ())):
            return str(stage["stage"])
    return ""


def _section(path: Path, section: ReportSection, room: int) -> dict[str, Any]:
    """A section as the template shows it, with pictures of at most `room` bytes."""
    pictures = pictures_of(path, outputs_of(path, [{"outputs": [{"path": name} for name in section.pictures]}]), room)
    return {
        "title": section.title, "text": section.text, "first": bool(section.boxes),
        "rows": [(str(name), shown(value)) for name, value in section.rows],
        "charts": [drawn for chart in section.charts if (drawn := chart_svg(chart))], "pictures": pictures,
        "bytes": sum(len(picture.source) * 3 // 4 for picture in pictures),
    }  # fmt: skip


def _layers(layers: Layers, view: Mapping[str, Any] | None) -> dict[str, Any]:
    """Layers as the template shows them: without a script, the one in the middle, and the chart."""
    middle = len(layers.files) // 2
    z = [layers.origin_mm[2] + (n + 0.5) * layers.layer_mm for n in layers.numbers]
    curves, label = [Curve(layers.numbers, layers.solid_mm2, "solid")], "solid area, mm²"
    inside = _inside_area(z, view)
    if inside is not None:
        curves.append(Curve(layers.numbers, inside, "part"))
        label = "area, mm²"
    words = []
    if len(layers.files) < layers.total:
        words.append(f"{len(layers.files)} of {layers.total} layers are shown, evenly spread.")
    if layers.reduced > 1:
        words.append(f"They are reduced: {layers.reduced} x {layers.reduced} pixels as printed make one here.")
    return {
        "count": layers.total, "folder": layers.folder, "middle": layers.numbers[middle],
        "source": data_uri("image/png", layers.files[middle]), "width": layers.size[0], "height": layers.size[1],
        "exact": layers.exact, "words": " ".join(words), "shown": len(layers.files),
        "chart": line_chart(curves, "layer", label, id_="layers-chart"),
        "aspect": f"{layers.size[0] * layers.pixel_mm[0]:g} / {layers.size[1] * layers.pixel_mm[1]:g}",
    }  # fmt: skip


def _inside_area(z: Sequence[float], view: Mapping[str, Any] | None) -> list[float] | None:
    """Area of the part in each layer, from the live view's samples; None if it has none."""
    if view is None or not view.get("inside_mm2"):
        return None
    import numpy as np

    areas, first, step = view["inside_mm2"], view["z_mm"][0], view["z_mm"][1]
    found = np.interp(z, first + step * np.arange(len(areas)), areas)
    return [float(area) for area in found]


def _yaml(config: Any) -> str:
    from ruamel.yaml import YAML

    text, yaml = io.StringIO(), YAML()
    yaml.width = 110
    yaml.dump(config, text)
    return text.getvalue()
