"""The studio as one file that needs no server: cells of one form, which the browser draws as the program does."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from sppm_pipeline.engine.plan.session import RunRequest
from sppm_pipeline.features.browser.studio.controls import places
from sppm_pipeline.features.browser.studio.design import Design
from sppm_pipeline.features.browser.studio.page import studio_page

START = """\
# A periodic cell. `sppm run` draws it, and writes its surface and what it can bear.
sppm: 1
name: cell
seed: 1
params:
  pores: 95
  porosity: 0.67
recipes:
  cell:
    - {stage: sample.mirrored_faces, edge: 5 mm, total: "${pores}", share: 0.5}
    - {stage: sample.dart_throwing, total: "${pores}"}
    - {stage: connect.mbdst, degree: [3, 5], mode: greedy}
    - {stage: field.gaussian, pore_radius: 0.1075, tunnel_radius: 0.023, level: 0.25}
pipeline:
  - {stage: tune.porosity, recipe: cell, target: "${porosity}"}
  - {stage: check.connectivity, islands: keep}
  - {stage: extract.marching_cubes}
  - {stage: write.mesh, path: cell.stl}
  - {stage: homogenize.voxel}
"""
"""The configuration that the page begins with; it changes its numbers, and reads others of this form alone."""

ROLES = {
    "seed": "seed", "params.porosity": "porosity", "params.pores": "pores", "recipes.cell.0.edge": "edge",
    "recipes.cell.0.share": "share", "recipes.cell.2.degree": "degree", "recipes.cell.3.pore_radius": "pore_radius",
    "recipes.cell.3.tunnel_radius": "tunnel_radius", "recipes.cell.3.level": "level",
}  # fmt: skip
"""What may be changed, and how ``cell.js`` calls it."""

MAX_PORES = 400
"""Of a cell in the browser, heuristic: those have been joined in 2 s."""

LIMITS: Mapping[str, tuple[float, float, bool]] = {
    "pores": (4, MAX_PORES, True), "porosity": (0.01, 0.99, False), "seed": (0, 2**53 - 1, True),
    "edge": (1e-6, 1e6, False), "share": (0.01, 1, False), "degree": (1, 40, True), "pore_radius": (1e-3, 1, False),
    "tunnel_radius": (1e-3, 1, False), "level": (1e-3, 0.99, False),
}  # fmt: skip
"""From where to where numbers may go, and whether they are integers; within what the stages allow."""

SLIDERS = {"pores": (8, 240, 1), "degree": (1, 10, 1)}
"""From where to where sliders go, and their steps, if not by the value that they begin with."""


def alone_page() -> str:
    """The page: it holds all that it needs, and its address the configuration."""
    design = Design(RunRequest("cell.yaml", text=START, folder=".", distributions=False), None, 1)
    known, controls = places(START), {c.key: c for c in design.controls[design.targets[0].name]}
    spots = []
    for key in ROLES:
        items = known[key].items
        for i, item in enumerate((key,) if items is None else items):
            spots.append((key, None if items is None else i, known[item].start, known[item].end))
    edge = known["recipes.cell.0.edge"]
    controls["recipes.cell.0.edge"] = replace(controls["recipes.cell.0.edge"], value=START[edge.start : edge.end])
    data: dict[str, Any] = {
        "text": START, "spots": sorted(spots, key=lambda spot: spot[2]), "roles": ROLES, "limits": LIMITS,
        "values": {key: controls[key].value for key in ROLES},
    }  # fmt: skip
    listed = [replace(controls[key], slider=SLIDERS.get(ROLES[key], controls[key].slider)) for key in ROLES]
    return studio_page(design, alone=(listed, data))[0]
