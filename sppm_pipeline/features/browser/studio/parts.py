"""Parts in the studio: where they begin, their numbers while they are changed, and the files that are made."""

from __future__ import annotations

import io
import math
import shutil
import tempfile
import weakref
import zipfile
from argparse import ArgumentParser
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sppm_pipeline.engine.cli.new import CAD, design_name, design_text
from sppm_pipeline.engine.config.document import parse_yaml, plain
from sppm_pipeline.engine.plan.estimate import estimate_plan
from sppm_pipeline.engine.plan.planning import Plan
from sppm_pipeline.engine.plan.session import RunRequest
from sppm_pipeline.engine.plan.wiring import Step
from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.method.families.layer_writer import LayerWriter
from sppm_pipeline.method.nouns.printer import Job, cut_for
from sppm_pipeline.method.part.part import Part, node_grid

MESHES = (".stl", ".3mf", ".obj", ".ply", ".off", ".glb", *CAD)
"""Endings of files with which a part begins."""

KIND = "infill"
"""What a mesh is made to at first; `sppm new` has others."""

CELLS, RESOLUTION = 2, 24
"""Cells along the edge of the box whose stiffness and permeability stand for the infill, and voxels along the edge of
each: 48 along the box, some seconds. Single boxes scatter by some percent."""

FINEST, COARSEST, MAX_VOXELS = 40, 10, 6e7
"""Voxels along a cell edge for a surface, and all of them together: a file of some hundred megabytes."""

MEASURED = 150_000
"""Samples in the box of a part on which its porosity is measured at once, some percent off."""

MAX_SAMPLES, SECONDS_PER_SAMPLE = 2e8, 9e-8
"""Samples of the layers up to which the whole configuration is run while one waits; what takes longer, by the button.
On one core each took so long for a part with a skin, its check and its file included."""


def seconds_of_layers(plan: Plan) -> float | None:
    """Seconds that the layers of a plan take on one core; None if that is not worth to be asked for."""
    samples = max((one.size.samples for one in estimate_plan(plan).stages if one.size is not None), default=0.0)
    return samples * SECONDS_PER_SAMPLE if samples > MAX_SAMPLES else None


def scratch_of(owner: object) -> Path:
    """A folder that is gone with its owner, or at the end of the process."""
    folder = Path(tempfile.mkdtemp(prefix="sppm-studio-"))
    weakref.finalize(owner, shutil.rmtree, folder, ignore_errors=True)
    return folder


def begun(mesh: Path, kind: str, printer: str | None, request: RunRequest, folder: Path) -> tuple[RunRequest, Path]:
    """The request of a new part, and the file that it would be saved to, which need not exist: both in `folder`."""
    name = design_name(mesh, kind)
    text = design_text(kind, mesh, name, printer)
    file = folder / f"{name}.yaml"
    return replace(request, file=str(file), text=text, folder=str(folder)), file


def part_numbers(plan: Plan, part: Part, entries: Sequence[Mapping[str, Any]], threads: int) -> dict[str, Any]:
    """Numbers of a part that are known at once: sizes, cells, drains; resin and time as far as a printer is known."""
    porosity, infill = porosities(part, threads)
    found: dict[str, Any] = {
        "edge_mm": part.edge_mm, "drains": len(part.drains), "porosity": porosity, "infill": infill,
        "size_mm": (part.domain.upper - part.domain.lower).tolist(),
    }  # fmt: skip
    for entry in entries:
        if entry["stage"] == "design.sizes":
            found["sizes"] = {key: entry["summary"].get(key) for key in ("strut", "pore", "porosity", "edge_mm")}
    volume = part.domain.summary().get("volume_mm3")
    return found if volume is None else found | _job(plan, part, (1 - porosity) * volume)


def porosities(part: Part, threads: int) -> tuple[float, float | None]:
    """Porosity of a part and of what its skin leaves, None if nothing is left, on a coarse grid.

    A sample at the surface of the part or of its skin counts by how much of it lies inside.
    """
    edge = part.physical_edge()
    box = float((part.domain.upper - part.domain.lower).prod()) / edge**3
    grid = node_grid(part, max(2, int((MEASURED / box) ** (1 / 3))))
    inner, skin, outer = part.fields_zyx(grid, threads)
    held = np.clip(0.5 - outer / np.float32(grid.spacing[0]), 0, 1)
    within = held if skin is None else held * np.clip(0.5 + skin / np.float32(grid.spacing[0]), 0, 1)
    void = float((within * (inner >= 0)).sum(dtype=np.float64))
    room = float(within.sum(dtype=np.float64))
    return void / float(held.sum(dtype=np.float64)), void / room if room else None


def _job(plan: Plan, part: Part, solid_mm3: float) -> dict[str, Any]:
    """Milliliters, grams and seconds of the print that the plan ends with."""
    cut: Any = next((step.stage for step in plan.steps if step.stage.name.startswith("slice.")), None)
    writer: Any = next((step.stage for step in reversed(plan.steps) if hasattr(step.stage, "chosen_resin")), None)
    if writer is None or getattr(cut, "printer", None) is None:
        return {"ml": solid_mm3 / 1000}
    printer, pitch = cut_for(cut.printer, cut.cards, cut.pixel, cut.layer)
    assert printer is not None
    layers = math.ceil(float(part.domain.upper[2] - part.domain.lower[2]) / pitch[2])
    job = Job("", printer, writer.chosen_resin(), layers, pitch[2], False, solid_mm3)
    return {"ml": job.milliliters, "g": job.grams, "seconds": job.seconds, "printer": printer.name}


def property_document(text: str, step: Step, sizes: Mapping[str, Any]) -> dict[str, Any]:
    """A configuration that measures what the recipe of `tile.scattered` makes, in a box that repeats."""
    root = plain(parse_yaml(text, "numbers"))
    tile: Any = step.stage
    cell = tile.cell or (f"{sizes['edge_mm']} mm" if sizes.get("edge_mm") else None)
    porosity = sizes.get("porosity") if tile.porosity is None else tile.porosity
    laid = {"cell": None if cell is None else str(cell), "porosity": porosity}
    entry = next(one for one in root["pipeline"] if one["stage"] == "tile.scattered")
    box = {
        "stage": "tile.scattered", "recipe": entry["recipe"], "cells": [CELLS] * 3, "periodic": True,
        **{key: value for key, value in laid.items() if value is not None},
    }  # fmt: skip
    solved = [
        {"stage": "homogenize.voxel", "id": "elastic", "from": box["stage"], "resolution": RESOLUTION},
        {"stage": "homogenize.permeability", "id": "flow", "from": box["stage"], "resolution": RESOLUTION},
    ]
    kept = {key: root[key] for key in ("sppm", "recipes", "seed") if key in root}
    return {**kept, "name": "numbers", "pipeline": [box, *solved]}


def surface_of(part: Part, strut_mm: float | None, folder: Path, name: str, threads: int) -> Path:
    """The surface of a part as STL, four voxels across a strut as far as the file does not get too large."""
    from sppm_pipeline.engine.api.functions import make_function

    edge = part.physical_edge()
    box = float((part.domain.upper - part.domain.lower).prod()) / edge**3
    wanted = 24.0 if not strut_mm else 4 * edge / strut_mm
    per_cell = int(min(max(wanted, COARSEST), FINEST, (MAX_VOXELS / box) ** (1 / 3)))
    if per_cell < COARSEST:
        raise DesignError(
            f"a surface of {COARSEST} voxels along a cell edge would have {box * COARSEST**3:.2g} voxels",
            hint="give larger cells, or add `extract.marching_cubes` and `write.mesh` to the file and run it",
        )
    mesh = make_function("extract.marching_cubes")(part, resolution=per_cell, threads=threads)
    (path,) = make_function("write.mesh")(mesh, path=f"{name}.stl", output=folder)
    return Path(path)


def printed_numbers(record: Mapping[str, Any]) -> dict[str, Any]:
    """What a whole run says of the print: to the digit what `sppm run` reports."""
    found: dict[str, Any] = {}
    for entry in record["stages"]:
        summary = entry.get("summary", {})
        for key in ("verdict", "porosity", "infill_porosity", "solid_volume_mm3", "resin_ml", "resin_g",
                    "print_time_s", "traps", "holes"):  # fmt: skip
            if summary.get(key) is not None:
                found[key] = summary[key]
    return found


def output_of(plan: Plan, record: Mapping[str, Any], folder: Path, what: str) -> tuple[str, bytes]:
    """Name and content of the picture, or of the print file, that a run has written; layers of a folder as ZIP."""
    outputs: dict[str, Sequence[Mapping[str, Any]]] = {one["id"]: one.get("outputs", ()) for one in record["stages"]}
    for step in reversed(plan.steps):
        fits = isinstance(step.stage, LayerWriter) if what == "print" else step.stage.name == "write.picture"
        if not fits or not outputs.get(step.id):
            continue
        path = folder / str(outputs[step.id][0]["path"])
        if path.is_file():
            return path.name, path.read_bytes()
        packed = io.BytesIO()
        with zipfile.ZipFile(packed, "w") as archive:
            for file in sorted(one for one in path.rglob("*") if one.is_file()):
                archive.write(file, file.relative_to(path.parent))
        return f"{path.name}.zip", packed.getvalue()
    raise ConfigError(
        f"the configuration writes no {'print file' if what == 'print' else 'picture'}",
        hint="add `slice.field` and `write.png`"
        if what == "print"
        else "add `- {stage: write.picture, path: part.png}`",
    )


def report_of(folder: Path, part: Part) -> bytes:
    """The report of a run directory, with the part shown live."""
    from sppm_pipeline.features.browser.report import command

    parser = ArgumentParser()
    command.configure(parser)
    target = folder / "report.html"
    command.of_run(folder, target, parser.parse_args([str(folder), "--no-cache"]), plugins=False, kept={"part": part})
    return target.read_bytes()
