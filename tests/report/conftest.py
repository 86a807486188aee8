"""A small run with everything a report shows, and a browser to show it in."""

import os
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


@pytest.fixture(scope="session")
def browser():
    """Chromium with software WebGL."""
    required = os.environ.get("SPPM_REQUIRE_BROWSER") == "1"
    path = next(
        (found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), None
    )
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        path = None
    if path is None:
        if required:
            pytest.fail("SPPM_REQUIRE_BROWSER=1, but there is no Chromium or no playwright")
        pytest.skip("no Chromium")
    with sync_playwright() as playwright:
        made = playwright.chromium.launch(
            executable_path=path, args=["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]
        )
        yield made
        made.close()
