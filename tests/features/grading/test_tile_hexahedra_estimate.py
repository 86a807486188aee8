"""What `read.hexahedra` and `tile.hexahedra` will take, told from the mesh before they run."""

from __future__ import annotations

import meshio
import numpy as np
import pytest

from sppm_pipeline.engine.plan.estimate import estimate_plan
from sppm_pipeline.engine.plan.session import RunRequest, open_session
from sppm_pipeline.features.grading import curved_porosity
from sppm_pipeline.features.grading.curved_porosity import MORE_LAYERS, CurvedSamples
from sppm_pipeline.features.grading.stages import read_hexahedra
from sppm_pipeline.features.grading.stages.read_hexahedra import ReadHexahedra
from sppm_pipeline.nouns.size import ONE
from sppm_pipeline.services.mesh.measures import volume
from sppm_pipeline.testing.plain_context import PlainContext
from tests.features.grading.hexahedral_meshes import o_grid, squares, star

TEXT = """sppm: 1
seed: 2
recipes:
  cell:
    - {{stage: sample.dart_throwing, total: 60, share: 0.5}}
    - {{stage: connect.mbdst, mode: greedy}}
    - {{stage: field.gaussian, pore_radius: 0.11, tunnel_radius: 0.035}}
pipeline:
  - {{stage: read.hexahedra, path: {path}}}
  - {{stage: tile.hexahedra, recipe: cell, path: {path}, {options}}}
  - {{stage: fill.implicit}}
  - {{stage: slice.field, pixel: 0.25 mm}}
  - {{stage: write.png}}
"""


def saved(folder, mesh, unit=1.0):
    path = folder / "mesh.vtu"
    points, cells = mesh
    meshio.write(path, meshio.Mesh(points / unit, [("hexahedron", cells)]))
    return path


def planned(path, options):
    request = RunRequest("part.yaml", text=TEXT.format(path=path, options=options), distributions=False)
    return open_session(request).plan()


@pytest.mark.parametrize(
    ("mesh", "options"),
    [
        pytest.param(star(5, 4.0), "parts: 1", id="star"),
        pytest.param(o_grid(12.0, 6.0, 3, 3, 3, 12.0), "parts: 1", id="disk"),
        pytest.param(squares([(0, 0), (1, 0), (0, 1)], 4.0), "parts: 2", id="L in parts"),
        pytest.param(o_grid(8.0, 4.0, 2, 2, 2, 8.0, hollow=True), "sizes: fixed, cell: 3 mm", id="fixed"),
    ],
)
def test_pores_and_layers_are_about_what_is_made(tmp_path, mesh, options):
    plan = planned(saved(tmp_path, mesh), options)
    found = estimate_plan(plan)
    assert not found.unknown
    read, tile, _, stack, _ = (stage.size for stage in found.stages)
    stages = {step.id: step.stage for step in plan.steps}
    # the surface cuts twisted faces into triangles
    surface = stages["read.hexahedra"].run(PlainContext())
    assert read.triangles == len(surface.faces)
    assert read.cells == len(mesh[1])
    assert read.body.box == pytest.approx(np.ptp(mesh[0], axis=0).tolist())
    assert read.body.volume == pytest.approx(volume(surface.vertices, surface.faces), rel=1e-3)
    made = made_by(plan)
    assert tile.pores == pytest.approx(len(made.tileset.micro.graph.pores.centers), rel=0.25)
    nx, ny, nz = (np.ptp(mesh[0], axis=0) / 0.25 + 1e-9).astype(int)
    assert stack.layers == pytest.approx(nz, abs=1)
    assert stack.samples == pytest.approx(nx * ny * nz, rel=0.2)


def made_by(plan):
    """What the plan's tiler makes."""
    from sppm_pipeline.engine.run.steps import run_step

    step = next(step for step in plan.steps if step.id == "tile.hexahedra")
    return run_step(step, step.stage, {"grading": None}, PlainContext(seed=2), plan.recipes)


@pytest.mark.parametrize("squares_along", [(6, 5), (2, 2)])
def test_samples_held_at_a_time_are_foretold(tmp_path, monkeypatch, squares_along):
    """A slab has some layers however wide they are."""
    monkeypatch.setattr(curved_porosity, "SLAB", 20_000)
    nx, ny = squares_along
    path = saved(tmp_path, squares([(i, j) for i in range(nx) for j in range(ny)], 4.0, layers=2))
    plan = planned(path, "porosity: 0.5, rounds: 0, resolution: 16, trials: 1")
    found = estimate_plan(plan).stages[1].size.resident
    samples = CurvedSamples(made := made_by(plan), made.curved, 16)
    x, y, _ = samples.grid.shape
    held = max(stop - start + MORE_LAYERS for start, stop, _ in samples._slabs()) * x * y
    assert x * y > (5000 if nx == 6 else 0)
    assert 0.6 < found / held < 1.1


def test_rounds_and_finer_grids_take_more(tmp_path):
    path = saved(tmp_path, star(5, 4.0))
    seconds = [
        estimate_plan(planned(path, options)).stages[1].cost.seconds
        for options in ("parts: 1", "porosity: 0.5, rounds: 0", "porosity: 0.5", "porosity: 0.5, resolution: 64")
    ]
    assert seconds == sorted(seconds)
    assert seconds[-1] > 2 * seconds[-2]
    assert seconds[-2] > 1.5 * seconds[1]


def test_lengths_are_in_the_unit_of_the_file(tmp_path):
    path = saved(tmp_path, star(5, 4.0), unit=1000.0)
    size = ReadHexahedra(path=path, unit="m").estimate(ONE)
    assert size.body.box[2] == pytest.approx(8.0)


def test_a_mesh_that_changes_is_read_again_and_a_huge_one_not_at_all(tmp_path, monkeypatch):
    path = saved(tmp_path, star(5, 4.0))
    assert ReadHexahedra(path=path).estimate(ONE).cells == 10
    saved(tmp_path, star(5, 4.0, layers=3))
    assert ReadHexahedra(path=path).estimate(ONE).cells == 15
    reads = []
    monkeypatch.setattr(read_hexahedra, "read_hexahedra", lambda path: reads.append(path))
    assert ReadHexahedra(path=path).estimate(ONE).cells == 15
    assert not reads
    monkeypatch.setattr(read_hexahedra, "MAX_BYTES", 100)
    with pytest.raises(LookupError, match="too large"):
        ReadHexahedra(path=path).estimate(ONE)


def test_what_is_no_mesh_is_unknown_and_no_error(tmp_path):
    path = tmp_path / "mesh.vtu"
    path.write_text("nothing")
    found = estimate_plan(planned(path, "parts: 1"))
    assert {"read.hexahedra", "tile.hexahedra"} <= set(found.unknown)
