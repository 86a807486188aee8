"""A small run with everything a report shows."""

import shutil

import pytest

from sppm_pipeline.engine.config.parameters import Overrides
from sppm_pipeline.engine.plan.session import RunRequest, open_session
from sppm_pipeline.engine.run.runner import run_plan

SMALL = """
sppm: 1
name: small
seed: 5
pipeline:
  - {stage: sample.mirrored_faces, count: 9, spacing: 0.2}
  - {stage: sample.dart_throwing, count: 12, spacing: 0.2}
  - {stage: connect.mbdst, degree: [2, 4], mode: greedy}
  - {stage: field.gaussian, pore_radius: 0.14, tunnel_radius: 0.05}
  - {stage: read.primitive, shape: ball, size: [8 mm, 8 mm, 8 mm]}
  - {stage: tile.periodic, cell: 4 mm}
  - {stage: fill.implicit}
  - {stage: write.view, grid_samples: 150000}
  - {stage: slice.field, pixel: 0.125 mm}
  - {stage: write.png, path: slices}
  - {stage: write.picture, path: part.png, resolution: 24, image_size: [240, 160], annotate: false,
     background: transparent}
  - {stage: extract.marching_cubes, resolution: 24}
  - {stage: write.mesh, path: part.stl}
"""


@pytest.fixture(scope="session")
def small_run(tmp_path_factory):
    """The folder of a finished run; tests copy it before they change it."""
    home = tmp_path_factory.mktemp("small")
    (home / "small.yaml").write_text(SMALL, encoding="utf-8")
    session = open_session(RunRequest(str(home / "small.yaml"), distributions=False, overrides=Overrides()))
    run_plan(session.plan(), home / "run", threads=2)
    return home / "run"


@pytest.fixture
def copied(small_run, tmp_path):
    """A copy of the run that may be changed."""
    return shutil.copytree(small_run, tmp_path / "run", ignore=shutil.ignore_patterns("report.html"))
