"""Small structures that many tests of stages and artifacts share, and a way to run YAML."""

from __future__ import annotations

import functools
import os
import shutil
import signal
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

from sppm_pipeline.engine.run.executors import WorkerOptions
from sppm_pipeline.method.families.cloud import Cloud
from sppm_pipeline.method.fields.microstructure import Microstructure
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.part import primitive_meshes
from sppm_pipeline.method.stages.connect_mbdst import BoundedDegreeSubgraph
from sppm_pipeline.method.stages.field_gaussian import GaussianField
from sppm_pipeline.method.stages.sample_dart_throwing import DartThrowing
from sppm_pipeline.method.stages.sample_mirrored_faces import MirroredFaces
from sppm_pipeline.method.stages.tile_free_faces import FreeFacesTiling
from sppm_pipeline.method.stages.tile_wang_3color import WangTiling
from sppm_pipeline.method.stages.tileset_free_faces import FreeFacesTileSet
from sppm_pipeline.method.stages.tileset_wang_3color import WangTileSet
from sppm_pipeline.nouns.length import Cell, Length
from sppm_pipeline.testing.plain_context import PlainContext, recipe_of

os.environ["SPPM_CACHE"] = (
    "off"  # tests neither use nor fill the cache of whoever runs them, but for those of the cache
)

os.environ["SPPM_TRUST"] = tempfile.gettempdir()  # where tests write plugins of their own

os.environ["SPPM_COMPILE_AHEAD"] = "off"  # all processors are busy with tests already

# The same examples each time, however long a busy machine takes for one of them, or for thinking it up.
settings.register_profile("sppm", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("sppm")

# Whoever starts the tests in the background may have turned signals off, which all processes would inherit.
for _number in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM):
    if signal.getsignal(_number) is signal.SIG_IGN:
        signal.signal(_number, signal.default_int_handler if _number == signal.SIGINT else signal.SIG_DFL)

LONG = (
    "tests/test_hostile_options.py",
    "tests/plugins/test_distributions.py",
    "tests/test_configs.py",
    "tests/engine/cli/test_supervision.py",
    "tests/docs/test_paper.py",
    "tests/engine/cli/test_interrupts.py",
    "tests/engine/cli/test_resources.py",
    "tests/test_packaging.py",
    "tests/test_determinism.py",
    "tests/features/browser/test_studio_part_in_browser.py",
    "tests/features/stiffness/test_tune_tensor.py",
    "plugins/sppm-tetrahedra/tests/test_tetrahedral.py",
    "tests/features/browser/test_studio_parts.py",
    "plugins/sppm-crushing/tests/test_write_compression.py",
    "tests/features/surface/test_extract_manifold_sdf.py",
    "tests/engine/test_hostile_plugins.py",
    "tests/features/grading/test_tile_hexahedra.py",
    "tests/services/jit/test_machine_code.py",
    "tests/engine/cli/test_mutants.py",
    "tests/features/printing/test_fix_drains.py",
    "tests/engine/api/test_pipeline.py",
    "tests/method/stages/test_tile_scattered.py",
    "tests/features/printing/test_check_print.py",
    "tests/engine/test_stuck_rows.py",
    "tests/engine/process/test_parent.py",
    "tests/features/browser/test_report_in_browser.py",
    "tests/method/assembly/test_overlap_add.py",
    "tests/features/design/test_design_stiffness.py",
    "tests/engine/cli/test_estimate.py",
    "plugins/sppm-tetrahedra/tests/test_write_volume_meshes.py",
    "tests/services/pictures/test_charts.py",
    "plugins/sppm-crushing/tests/test_failure.py",
    "tests/engine/test_limits.py",
    "tests/method/stages/test_tilers.py",
    "tests/features/surface/test_fill_boolean.py",
    "tests/engine/cli/test_cli.py",
    "tests/features/sheet/test_field_sheet.py",
    "tests/method/connecting/test_bounded.py",
    "tests/engine/test_sweep.py",
    "tests/endurance/test_endurance.py",
    "tests/docs/test_notebooks.py",
    "tests/docs/test_python.py",
)
"""Files that take longer than the others, the longest first: they come first, so that no process is left with one when
all others have ended. With ``--dist loadfile`` alone, those with many tests would come first, which are rarely long."""


@pytest.hookimpl(wrapper=True, optionalhook=True)
def pytest_xdist_auto_num_workers():
    """Processes of ``-n auto``: one more than processors, as tests of what hangs and of other programs wait."""
    return (yield) + 1


def pytest_configure(config):
    if hasattr(config.option, "loadscopereorder"):
        config.option.loadscopereorder = False


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items):
    places = {file: place for place, file in enumerate(LONG)}
    items.sort(key=lambda item: places.get(item.nodeid.partition("::")[0], len(places)))


MARK = "SPPM_TESTS"
MARKED = f"{os.getpid()}-{os.urandom(8).hex()}"
"""An environment variable that all processes which tests start inherit, and its value, which no other tests have."""

WATCH = """
import os, signal, sys, time
os.setsid()
mark, parent = sys.argv[1].encode(), int(sys.argv[2])
for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    signal.signal(number, signal.SIG_IGN)
while os.getppid() == parent:
    time.sleep(0.3)
for _ in range(50):
    found = []
    for pid in filter(str.isdecimal, os.listdir("/proc")):
        try:
            with open(f"/proc/{pid}/environ", "rb") as file:
                if mark in file.read().split(b"\\0"):
                    os.kill(int(pid), signal.SIGKILL)
                    found.append(pid)
        except OSError:
            pass
    if not found:
        break
    time.sleep(0.1)
"""
"""Ends what tests have started once the tests have ended, even if somebody killed them, in whatever process group."""


@pytest.fixture(scope="session", autouse=True)
def _nobody_outlives_the_tests():
    if sys.platform == "linux":
        words = [sys.executable, "-I", "-S", "-c", WATCH, f"{MARK}={MARKED}", str(os.getpid())]
        nowhere = [(os.POSIX_SPAWN_OPEN, number, os.devnull, os.O_RDWR, 0) for number in range(3)]
        environment = {name: value for name, value in os.environ.items() if name != MARK}
        os.posix_spawn(sys.executable, words, environment, file_actions=nowhere)
        os.environ[MARK] = MARKED


def small_recipe(**field):
    """A recipe whose cells are drawn in milliseconds."""
    return recipe_of(
        MirroredFaces(count=9, spacing=Length(0.2)),
        DartThrowing(count=12, spacing=Length(0.2)),
        BoundedDegreeSubgraph(degree=(2, 4), mode="greedy"),
        GaussianField(**({"pore_radius": Length(0.14), "tunnel_radius": Length(0.05)} | field)),
    )


def cubic(c11, c12, c44):
    """The (6, 6) stiffness of a cubic material in Voigt notation."""
    matrix = np.zeros((6, 6))
    matrix[:3, :3] = c12
    matrix[range(6), range(6)] = [c11] * 3 + [c44] * 3
    return matrix


@pytest.fixture(scope="session")
def recipe():
    """Makes small recipes."""
    return small_recipe


@pytest.fixture(scope="session")
def cell() -> Microstructure:
    """One periodic cell."""
    return small_recipe().run(PlainContext(3))


@pytest.fixture(scope="session")
def wang():
    """A tile set with two colors, eight tiles, porosity one half."""
    return WangTileSet(colors=2, porosity=0.5, resolution=24, tolerance=0.01).run(PlainContext(4), small_recipe())


@pytest.fixture(scope="session")
def wang_tiling(wang):
    """4 x 3 x 3 cells of 4 mm by the paper's rules."""
    return WangTiling(cells=(4, 3, 3), cell=Length(4, "mm")).run(PlainContext(5), wang, None)


@pytest.fixture(scope="session")
def free_tiling():
    """3 x 2 x 2 cells whose opposite faces differ."""
    made = FreeFacesTileSet(colors=2, interiors=3, resolution=16).run(PlainContext(6), small_recipe())
    return FreeFacesTiling(cells=(3, 2, 2), cell=Length(4, "mm")).run(PlainContext(7), made, None)


@pytest.fixture(scope="session")
def wedge() -> SurfaceMesh:
    """A closed body without any symmetry: a tetrahedron."""
    vertices = np.array([[0.3, 0.2, 0.1], [11.0, 1.0, 0.4], [1.5, 8.0, 0.9], [2.0, 1.4, 7.2]])
    return SurfaceMesh(vertices, np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]), "wedge")


@pytest.fixture(scope="session")
def ball() -> SurfaceMesh:
    """A ball with a diameter of 10 mm around (5, 5, 5)."""
    return SurfaceMesh(*primitive_meshes.ball_mesh((5.0, 5.0, 5.0), 5.0, 3), name="ball")


@pytest.fixture
def run_yaml(tmp_path, run_in):
    """Run a configuration, given as text or as a file, through the engine; returns the record and the run directory."""
    return functools.partial(run_in, tmp_path)


@pytest.fixture(scope="session")
def run_in():
    """`run_yaml` with the folder to run in as its first argument."""
    return _run_in


def _run_in(
    scratch, source, *, p=(), s=(), seed=None, threads=1, workers=1, executor=None, to="out", plugins=False,
    declared=True,
):  # fmt: skip
    from sppm_pipeline.engine.config.parameters import Overrides
    from sppm_pipeline.engine.plan.session import RunRequest, open_session
    from sppm_pipeline.engine.run.runner import run_plan
    from sppm_pipeline.engine.run.sweep import run_sweep

    if isinstance(source, str):
        path = scratch / "config.yaml"
        path.write_text(source if source.startswith("sppm:") else f"sppm: 1\n{source}", encoding="utf-8")
    else:
        path = Path(source)
    overrides = Overrides(tuple(p), tuple(s), seed)
    session = open_session(RunRequest(str(path), distributions=plugins, overrides=overrides))
    plan, folder = session.plan(), scratch / to
    if session.configuration.sweep is None:
        record = run_plan(plan, folder, threads=threads)
        if declared:
            _numbers_are_declared(plan, record)
        return record, folder
    return run_sweep(session, plan, folder, WorkerOptions(workers=workers, executor=executor, threads=threads)), folder


def _numbers_are_declared(plan, record):
    """What a stage reports is what it declares; else columns that there are would be refused before a sweep."""
    from sppm_pipeline.engine.plan.checking import declared_numbers, is_declared
    from sppm_pipeline.engine.run.sweep_table import numbers_of

    for step, stage in zip(plan.steps, record["stages"], strict=True):
        declared = declared_numbers(type(step.stage), step.owner.builtin, step.makes)
        if declared is not None:
            numbers = [name[len(step.id) + 1 :] for name in numbers_of([stage])]
            assert not [name for name in numbers if not is_declared(name, declared)], step.id


@pytest.fixture(scope="session")
def summary():
    """The summary of a stage of a run record, by its id."""

    def find(record, id_):
        return next(stage["summary"] for stage in record["stages"] if stage["id"] == id_)

    return find


@pytest.fixture(scope="session")
def random_cloud():
    """Makes clouds of random pores that keep a spacing."""
    return _random_cloud


@pytest.fixture(scope="session")
def sorted_cloud():
    """Makes clouds of given points."""
    return _sorted_cloud


def _random_cloud(lattice, pores, periodic=(False, False, False), seed=0, spacing=0.6):
    """`pores` in a box of blocks; the spacing is a fraction of the mean distance."""
    rng = np.random.default_rng(seed)
    size = np.array(lattice, float)
    reach = spacing * (size.prod() / max(pores, 1)) ** (1 / 3)
    points = np.zeros((0, 3))
    while len(points) < pores:
        dart = rng.random((1, 3)) * size
        step = np.abs(points - dart)
        step = np.where(periodic, np.minimum(step, size - step), step)
        if (step**2).sum(1).min(initial=np.inf) >= reach**2:
            points = np.concatenate([points, dart])
    return _sorted_cloud(points, lattice, periodic)


def _sorted_cloud(points, lattice, periodic=(False, False, False)):
    """The points sorted by block."""
    block = np.ravel_multi_index(tuple(np.floor(points).astype(int).T), lattice)
    count = np.bincount(block, minlength=int(np.prod(lattice)))
    first = np.concatenate([[0], np.cumsum(count)])
    return Cloud(points[np.argsort(block, kind="stable")], first, tuple(lattice), tuple(periodic), Cell())


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
        made = Restarted(
            lambda: playwright.chromium.launch(
                executable_path=path,
                args=[
                    "--use-angle=swiftshader",
                    "--enable-unsafe-swiftshader",
                    "--no-sandbox",
                    "--disable-dev-shm-usage",
                ],
            )
        )
        yield made
        made.close()


class Restarted:
    """A browser that is started again for the next page, if it crashed."""

    def __init__(self, launch):
        self._launch, self._made = launch, launch()

    def new_page(self, **options):
        """A page, of a new browser if this one ends before it says so."""
        from playwright.sync_api import Error

        try:
            return self.__getattr__("new_page")(**options)
        except Error:
            self._made = self._launch()
            return self._made.new_page(**options)

    def __getattr__(self, name):
        if not self._made.is_connected():
            self._made = self._launch()
        return getattr(self._made, name)


@pytest.fixture(scope="session")
def spline_values():
    """The level spline at the points of three axes, indexed z, y, x: its whole sum, term by term."""

    def weights(positions, cells):
        found = np.zeros((len(positions), cells))
        for row, position in zip(found, positions, strict=True):
            cell = min(max(int(np.floor(position)), 0), cells - 1)
            t = min(max(position - cell, 0.0), 1.0)
            for k, weight in ((-1, (1 - t) ** 2 / 2), (0, 0.5 + t - t**2), (1, t**2 / 2)):
                row[min(max(cell + k, 0), cells - 1)] += weight
        return found

    def values(control, x, y, z):
        along = [weights(p, n) for p, n in zip((x, y, z), control.shape, strict=True)]
        return np.einsum("ijk,xi,yj,zk->zyx", control, *along, optimize=True)

    return values
