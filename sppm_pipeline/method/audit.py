"""The audit of a part: the layers, the mesh and what was asked for are compared with each other.

Every number is one that stages report anyway, so an audit costs no evaluation of the field.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from sppm_pipeline.hookspecs import Comparison

VOLUME = 0.005
"""Largest difference between the volumes of layers and mesh, as a fraction.

Both are counts of one field on two grids, whose errors are a few thousandths at 40 samples along a cell; a shell taken
for void, or a component that only one of them has lost, is a hundredth and more.
"""

ISLANDS = 0.01
"""Largest share of the solid that may be removed as islands: porosity then rises by as much of the solid share."""

BORDER_ISLANDS = 0.05
"""The same of a part with a border (`fill.implicit`): struts that the surface cuts off are meant to go. At 0.7 about a
fiftieth of the solid is; a factor of two would miss a part that lost a twentieth, or accept one that lost a tenth."""

POROSITY = 0.01
"""Largest difference between the porosity that was asked for and the one of the layers, if the level was not tuned for
this part or box, or was measured coarsely.

A level that fits one cell, or a box, meets other shares of its tiles in a part: a box of 3^3 cells cut at the level of
the set is off by 0.004. A factor of two would miss a part that lost a hundredth of its solid.
"""

TUNED_POROSITY = 0.002
"""The same if the level was tuned for what the layers show.

Then only samples differ: tile rules and layers count one field on two grids, each of `FINE` samples along a cell or
more. A factor of two would miss a part cut at the level of its set.
"""

FINE = 32
"""Samples along a cell, of the search and of the layers, for `TUNED_POROSITY`: the default of tile rules. At half as
many, counts of the volume alone may differ by some thousandths (`VOLUME`)."""

Stage = Mapping[str, Any]


class _Made(NamedTuple):
    """Solid in files or in a mesh: the stage that reports it, its volume, and the id of the stage whose body it is."""

    stage: Stage
    volume: float
    body: str


def comparisons(record: Mapping[str, Any]) -> Iterator[Comparison]:
    """Pairs of numbers of a run that must agree; see `sppm_audit`."""
    stages: dict[str, Stage] = {stage["id"]: stage for stage in record["stages"]}
    layers = [made for stage in stages.values() if (made := _layers(stage, stages)) is not None]
    meshes = [made for stage in stages.values() if (made := _mesh(stage, stages)) is not None]
    for stack in layers:
        for mesh in meshes:
            if mesh.body == stack.body or mesh.stage["id"] == stack.body:
                name = f"volume of the layers ({stack.stage['id']}) and of the mesh ({mesh.stage['id']})"
                yield Comparison(name, stack.volume, mesh.volume, VOLUME * abs(mesh.volume), "mm3")
    for made in (*layers, *meshes):
        share = _number(made.stage["summary"], "removed_share")
        if share is not None and not _asks_for_removal(made, stages):
            border = stages.get(made.body, {}).get("options", {}).get("border", "cut")
            limit = ISLANDS if border == "cut" else BORDER_ISLANDS
            yield Comparison(f"solid removed as islands ({made.stage['id']})", share, 0.0, limit)
    for mesh in meshes:
        # layers hold one piece by the way they are made: all but the largest component is cleared
        if (pieces := _number(mesh.stage["summary"], "pieces")) is not None:
            yield Comparison(f"pieces of the solid ({mesh.stage['id']})", pieces, 1.0, 0.0)
    for stack in layers:
        if (porosities := _porosities(stack, stages)) is not None:
            yield Comparison(f"porosity of the layers ({stack.stage['id']})", *porosities)


def _layers(stage: Stage, stages: Mapping[str, Stage]) -> _Made | None:
    """Layers that a stage has written."""
    volume = _number(stage["summary"], "solid_volume_mm3")
    stack = stages.get(_input(stage, "stack"))
    if volume is None or stack is None:
        return None
    return _Made(stage, volume, _body(stack, stages) or _input(stack, "mesh"))


def _mesh(stage: Stage, stages: Mapping[str, Stage]) -> _Made | None:
    """The mesh of a whole field, closed and without shells left out."""
    volume = _number(stage["summary"], "volume_mm3")
    if volume is None or not str(stage["stage"]).startswith("extract.") or not stage["options"].get("caps", True):
        return None
    return _Made(stage, volume, _body(stage, stages))


def _body(stage: Stage, stages: Mapping[str, Stage]) -> str:
    """The id of the stage that made the field which a stage evaluates; checks hand a field on."""
    source = _input(stage, "field")
    while source in stages and str(stages[source]["stage"]).startswith("check."):
        source = _input(stages[source], "field")
    return source


def _asks_for_removal(made: _Made, stages: Mapping[str, Stage]) -> bool:
    """True if the user wrote `islands: remove`: then what is removed is no surprise."""
    sources = (made.stage, stages.get(_input(made.stage, "stack")), stages.get(made.body))
    return any(stage is not None and stage.get("options", {}).get("islands") == "remove" for stage in sources)


def _porosities(stack: _Made, stages: Mapping[str, Stage]) -> tuple[float, float, float] | None:
    """Porosity of layers, the one that was asked for, and the tolerance, where the whole part has one porosity.

    A part with a skin or drains has another porosity than its infill, and so has a body that was changed on the way.
    """
    box = _number(stack.stage["summary"], "solid_share_of_box")
    body = stages.get(stack.body)
    if body is None or box is None:
        return None
    if body["stage"] != "fill.implicit" and _input(body, "cover"):
        return None  # cells around a part, whose box has corners without cells
    found, tiles = 1.0 - box, body
    if body["stage"] == "fill.implicit":
        options, part = body.get("options", {}), body["summary"]
        around = _number(part.get("domain", {}), "volume_mm3")
        # an open surface has no volume
        if options.get("skin") or options.get("drains") or not part.get("closed", True) or not around or around <= 0:
            return None
        found, tiles = 1.0 - stack.volume / around, stages.get(_input(body, "field"), {})
    if not str(tiles.get("stage", "")).startswith(("tile.", "tune.porosity")):
        return None
    asked = _asked(tiles, stages)
    if asked is None:
        return None
    porosity, stage = asked
    tolerance = POROSITY
    if _is_tuned(tiles, body, stage) and _samples(tiles, stages.get(_input(stack.stage, "stack"), {})) >= FINE:
        # the level is cut before islands are looked for, which have a comparison of their own
        removed = _number(stack.stage["summary"], "removed_share") or 0.0
        islands = (1.0 - found) * removed / (1.0 - removed) if removed < 1 else 0.0
        own = _number(stage.get("options", {}), "tolerance") or 0.0  # that of `tune.porosity`
        tolerance = max(TUNED_POROSITY, own) + islands
    return found, porosity, tolerance


def _is_tuned(tiles: Stage, body: Stage, asked: Stage) -> bool:
    """True if the level of a tiling was cut for the part or box that became `body`; `asked` named the porosity."""
    if tiles["stage"] == "tune.porosity":
        return tiles is body  # one cell, which may fill a part as well
    # a rule measures in the mesh that it covers, but a box of `cells` as a whole, whatever mesh is filled with it
    measured = "" if tiles.get("options", {}).get("cells") else _input(tiles, "cover")
    part = "" if body is tiles else _input(body, "domain")
    # a repeated field keeps the level that its cell was tuned to; a set of tiles hands its target on
    return measured == part and (asked is tiles or str(asked["stage"]).startswith("tileset."))


def _samples(tiles: Stage, layers: Stage) -> float:
    """Samples along a cell in layers, and where the level was searched, the fewer of both; 0 where unknown."""
    summary = layers.get("summary", {})
    searched = _number(tiles.get("options", {}), "resolution") or 0.0
    pitch = [*(summary.get("pixel_mm") or ()), summary.get("layer_mm")]
    cell = _number(tiles["summary"], "cell_mm")
    if cell is not None and all(isinstance(h, (int, float)) and h > 0 for h in pitch):
        return min(searched, float(round(cell / max(pitch), 6)))  # mm by mm: 4 / 0.125 is to be 32
    counts = [*summary.get("pixels", ()), summary.get("layers", 0)]
    return min(searched, *counts) if tiles["stage"] == "tune.porosity" else 0.0  # the box is the cell


def _asked(tiles: Stage, stages: Mapping[str, Stage]) -> tuple[float, Stage] | None:
    """The porosity that a tiling, or its set of tiles, was asked for, and by which stage, or None."""
    sources = {port: source for port, source in tiles.get("inputs", {}).items() if source in stages}
    if sources.keys() - {"tileset", "source", "cover"}:
        return None  # a grading, for instance, asks for another porosity at each place
    for stage in (tiles, *(stages[source] for port, source in sources.items() if port != "cover")):
        options = stage.get("options", {})
        asked = options.get("target") if stage["stage"] == "tune.porosity" else options.get("porosity")
        if isinstance(asked, (int, float)):
            return float(asked), stage
    return None


def _input(stage: Stage, port: str) -> str:
    """The id of the stage at a port; empty if there is none."""
    source = stage.get("inputs", {}).get(port)
    return source if isinstance(source, str) else ""


def _number(summary: Mapping[str, Any], name: str) -> float | None:
    value = summary.get(name)
    return float(value) if isinstance(value, (int, float)) and not isinstance(value, bool) else None
