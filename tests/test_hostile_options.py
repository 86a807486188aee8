"""Every option of every stage with a page against values that mean harm: refused at its place, or a valid result.

Each stage stands in a small pipeline of its own. A value must either be refused before any work, with the option, the
value, what is allowed and the line; or it is accepted, and then the pipeline must end well, or with an error that the
user can cure (exit codes 2, 3 and 5), in seconds.
"""

from __future__ import annotations

import json
import math
import signal
import types
import typing
from pathlib import Path

import pytest

from sppm_pipeline.engine.config.options import options_of, parse_typed
from sppm_pipeline.engine.plan import session
from sppm_pipeline.engine.plan.session import RunRequest, open_session
from sppm_pipeline.engine.run.runner import run_plan
from sppm_pipeline.errors import ConfigError, ConfigErrors, SppmError
from sppm_pipeline.nouns.length import Length
from tests.built_in import DOCUMENTED, STAGES, stage_class

RECIPE = """  cell:
    - {stage: sample.mirrored_faces, count: 6, spacing: 0.25}
    - {stage: sample.dart_throwing, count: 5, spacing: 0.25}
    - {stage: connect.mst}
    - {stage: field.gaussian, pore_radius: 0.16, tunnel_radius: 0.06}
"""
CELL = RECIPE.splitlines()[1:]
GRADED = """  counted:
    - {stage: sample.mirrored_faces, total: 24, share: 0.5}
    - {stage: sample.dart_throwing, total: 24}
    - {stage: connect.mbdst, degree: [3, 5], mode: greedy}
    - {stage: field.gaussian, pore_radius: 0.16, tunnel_radius: 0.06}
"""
MAP = "  - {stage: grade.table, of: porosity, values: [[0, 0.5], [4, 0.6]], along: x}"
SET = "  - {stage: tileset.wang_3color, recipe: cell, colors: 1, resolution: 8}"
FREE = "  - {stage: tileset.free_faces, recipe: cell, colors: 1, interiors: 1, resolution: 8}"
CORNER = "  - {stage: tileset.corner_colors, recipe: cell, colors: 1, interiors: 1, resolution: 8}"
BOX = "  - {stage: read.primitive, shape: box, size: [3, 3, 3]}"
FLAT = "  - {stage: read.primitive, shape: box, size: [3, 3, 0.4]}"
BALL = "  - {stage: read.primitive, id: ball, shape: ball, size: [1, 1, 1]}"
TILED = [SET, "  - {stage: tile.wang_3color, cells: [2, 1, 1], cell: 2 mm}"]
AS_CELL = [line[2:] for line in CELL]
REPEATED = [*AS_CELL, "  - {stage: tile.periodic, cells: [1, 1, 1], cell: 2 mm}"]
VOLUME = [*REPEATED, "  - {stage: mesh.isosurface_stuffing, resolution: 6}"]
IMAGE = [*REPEATED, "  - {stage: extract.voxels, resolution: 6}"]

TEST = ["  - {stage: read.compression, path: test.csv, size: [20, 20, 20]}"]

CHECKED = ["  - {stage: check.porosity, resolution: 8}"]
LOADED = [BOX, "  - {stage: load.case, fix: ['plane x at low'], force: ['0 0 -1 N on plane x at high']}"]
LAYERS = ["  - {stage: slice.field, pixel: 0.5}", "  - write.png"]
SMALL = "recipe: cell, porosity: 0.5, colors: 1, resolution: 8, tolerance: 0.1"

PLACES: dict[str, tuple[list[str], str, list[str]]] = {
    "read.mesh": ([], "path: part.stl", []),
    "read.primitive": ([], "shape: torus, size: [3, 3, 3]", []),
    "read.voxels": ([], "path: image.npy", []),
    "read.scan": ([], "path: image.npy", []),
    "field.voxels": (IMAGE, "", []),
    "measure.statistics": (REPEATED, "resolution: 16", []),
    "tune.match": (
        ["  - {stage: read.voxels, path: image.npy}"], "recipe: cell, vary: [field.gaussian.pore_radius], low: [0.1], "
        "high: [0.2], starts: 2, evaluations: 3, hold_out: false", []),
    "check.scan": (
        [*REPEATED, "  - {stage: extract.voxels, resolution: 16}", "  - {stage: field.voxels}"],
        "from: {design: tile.periodic, scan: field.voxels}, resolution: 16, properties: false", []),
    "print.simulate": (
        [BOX, SET, "  - {stage: tile.wang_3color, cell: 2 mm}", "  - {stage: fill.implicit}",
         "  - {stage: slice.field, pixel: 0.5}"], "spread: 0.1, penetration: 0.5, cure_depth: 0.5", []),
    "write.statistics": ([*REPEATED, "  - {stage: measure.statistics, resolution: 16}"], "", []),
    "read.volume_mesh": ([], "path: part.vtu", []),
    "grade.formula": ([], "of: porosity, formula: 0.5 + 0*x", []),
    "grade.table": ([], "of: porosity, values: [[0, 0.5], [1, 0.6]]", []),
    "grade.image": ([], "of: ct, path: image.npy", []),
    "grade.points": ([], "of: ct, path: points.csv", []),
    "grade.nodes": ([], "of: ct, path: part.vtu", []),
    "grade.distance": ([BOX], "of: depth, to: point, point: [0, 0, 0]", []),
    "grade.stiffness": (
        ["  - {stage: grade.table, of: stiffness, values: [[0, 0.3], [1, 0.4]]}"],
        "values: [[0.3, 0.5], [0.7, 0.1]]", [],
    ),
    "read.compression": ([], "path: test.csv, size: [20, 20, 20]", []),
    "sample.mirrored_faces": ([], "count: 6, spacing: 0.25", AS_CELL[1:]),
    "sample.dart_throwing": (AS_CELL[:1], "count: 5, spacing: 0.25", AS_CELL[2:]),
    "sample.elimination": (AS_CELL[:1], "count: 5", AS_CELL[2:]),
    "sample.hyperuniform": (AS_CELL[:1], "count: 12, spacing: 0.1", AS_CELL[2:]),
    "connect.mst": (AS_CELL[:2], "", AS_CELL[3:]),
    "connect.relative_neighbors": (AS_CELL[:2], "degree: [1, 4]", AS_CELL[3:]),
    "connect.mbdst": (AS_CELL[:2], "degree: [1, 4], mode: greedy", AS_CELL[3:]),
    "field.blend": (
        [*TILED, "  - {stage: grade.formula, of: weight, formula: 0.5 + 0*x}"], "probes: 10000",
        ["  - {stage: check.porosity, resolution: 4}"]),
    "fill.regions": (TILED, "regions: [solid in sphere 1 1 1 radius 0.5 mm], probes: 10000", []),
    "field.walls": (AS_CELL[:3], "thickness: 0.05, tunnel_radius: 0.04", CHECKED),
    "field.sheet": (["  - {stage: sample.elimination, count: 12}"], "relaxation: 2", CHECKED),
    "field.gaussian": (AS_CELL[:3], "pore_radius: 0.16, tunnel_radius: 0.06", CHECKED),
    "design.sizes": ([], "recipe: cell, pore: 0.6 mm, strut: 0.4 mm, draws: 1, resolution: 32", []),
    "design.stiffness": (
        [], "recipe: cell, E: 0.1, nu: 0.25, porosity: 0.5, vary: [pore_radius], low: [0.13], high: [0.2], "
        "search_draws: 1, draws: 3, resolution: 24, max_distance: 0.9", []),
    "tune.tensor": ([], "recipe: cell, resolution: 24, periods: 1, evaluations: 3, trials: 1, max_distance: 0.9", []),
    "tune.porosity": ([], "recipe: cell, target: 0.5, resolution: 16, tolerance: 0.05, trials: 1, evaluations: 4", []),
    "tune.stiffness": (
        [], "recipe: cell, target: 0.3, vary: field.gaussian.level, low: 0.2, high: 0.5, resolution: 6, evaluations: 4",
        []),
    "tune.property": (
        [], "recipe: cell, of: porosity, target: 0.4, vary: field.gaussian.level, low: 0.2, high: 0.5, accuracy: 0.4, "
        "evaluations: 4", []),
    "tune.retry": ([], "recipe: cell", []),
    "tune.local_porosity": ([MAP, *TILED], "resolution: 8, tolerance: 0.1", []),
    "tileset.wang_3color": ([], SMALL, []),
    "tileset.free_faces": ([], SMALL + ", interiors: 2", []),
    "tileset.corner_colors": ([], SMALL + ", interiors: 2", []),
    "tile.periodic": ([SET], "cells: [2, 1, 1], cell: 2 mm", []),
    "tile.wang_3color": ([SET], "cells: [2, 1, 1], cell: 2 mm", []),
    "tile.free_faces": ([FREE], "cells: [2, 1, 1], cell: 2 mm", []),
    "tile.corner_colors": ([CORNER], "cells: [2, 1, 1], cell: 2 mm", []),
    "tile.scattered": ([], "recipe: cell, cells: [2, 1, 1], cell: 2 mm, porosity: 0.5, resolution: 8", []),
    "tile.graded": ([MAP], "recipe: counted, cells: [2, 1, 1], cell: 2 mm, resolution: 8, trials: 1, rounds: 1", []),
    "tileset.join": ([FREE, CORNER], "from: {first: tileset.free_faces, second: tileset.corner_colors}", []),
    "tile.joined": (
        [FREE, CORNER, "  - {stage: tileset.join, from: {first: tileset.free_faces, second: tileset.corner_colors}}",
         "  - {stage: grade.formula, of: weight, formula: 'step(2, x)'}"],
        "cells: [2, 1, 1], cell: 2 mm, resolution: 8, rounds: 1", []),
    "tile.fresh": ([], "recipe: cell, cells: [2, 1, 1], cell: 2 mm, porosity: 0.5, resolution: 8", []),
    "warp.affine": (REPEATED, "stretch: [1, 1.2, 0.9], turn: [0, 0, 30], resolution: 16", CHECKED),
    "warp.cylinder": (TILED, "inner_radius: 5 mm, around: 90", CHECKED),
    "warp.sphere": (TILED, "inner_radius: 5 mm, around: 90", CHECKED),
    "warp.hexahedra": (TILED, "path: part.vtu", []),
    "tile.hexahedra": ([], "recipe: cell, path: part.vtu", []),
    "read.hexahedra": ([], "path: part.vtu", []),
    "fill.implicit": ([BOX, SET, "  - {stage: tile.wang_3color, cell: 2 mm}"], "", LAYERS),
    "tune.orientation": (
        [BOX, SET, "  - {stage: tile.wang_3color, cell: 2 mm}", "  - {stage: fill.implicit, skin: 0.3 mm}"],
        "", LAYERS),
    "fix.drains": (
        [BOX, SET, "  - {stage: tile.wang_3color, cell: 2 mm}", "  - {stage: fill.implicit, skin: 0.3 mm}"],
        "", LAYERS),
    "fix.fill": (
        [BOX, SET, "  - {stage: tile.wang_3color, cell: 2 mm}", "  - {stage: fill.implicit, skin: 0.3 mm}"],
        "", LAYERS),
    "extract.marching_cubes": (TILED, "resolution: 8", []),
    "extract.manifold_sdf": (TILED, "resolution: 8", []),
    "extract.unit_cell": (REPEATED, "resolution: 8", []),
    "extract.voxels": (TILED, "resolution: 8", []),
    "extract.phases": (TILED, "resolution: 8, coating: 0.3 mm", []),
    "fill.boolean": ([BOX, SET, "  - {stage: tile.wang_3color, cell: 2 mm}"], "resolution: 8", []),
    "fill.combine": ([BOX, BALL], "operation: union, from: {tool: ball}", []),
    "mesh.isosurface_stuffing": (REPEATED, "resolution: 8", []),
    "mesh.boundary": (VOLUME, "", []),
    "mesh.simplify": ([BALL], "largest_distance: 0.05", []),
    "homogenize.voxel": (REPEATED, "resolution: 6", []),
    "measure.onset": (REPEATED, "resolution: 6", []),
    "homogenize.conductivity": (REPEATED, "resolution: 6", []),
    "homogenize.permeability": (REPEATED, "resolution: 6", []),
    "homogenize.acoustics": (REPEATED, "resolution: 6, cell: 5 mm", []),
    "homogenize.tet": (VOLUME, "", []),
    "homogenize.realizations": ([], "recipe: cell, draws: 2, resolution: 6", []),
    "fill.engrave": (
        [BOX, *TILED, "  - {stage: fill.implicit, skin: 0.3 mm}"],
        "text: '7', middle: [0 mm, 0 mm, 3 mm], letter_height: 1 mm", []),
    "check.mesh": ([BOX], "", []),
    "check.print": ([*TILED, "  - {stage: slice.field, pixel: 0.5}"], "", []),
    "check.sizes": (TILED, "resolution: 8", []),
    "check.volume_mesh": (VOLUME, "", []),
    "measure.compression": (TEST, "", []),
    "load.case": ([BOX], "fix: ['plane x at low'], force: ['0 0 -1 N on plane x at high']", []),
    "simulate.part": (
        [*LOADED, "  - {stage: tile.fresh, recipe: cell, cell: 3 mm}", "  - fill.implicit"],
        "young: 1000, resolution: 6", []),
    "optimize.density": (
        LOADED,
        "recipe: counted, young: 1000, cell: 1.5 mm, mean_density: 0.45, density: [0.35, 0.55], trials: 1, "
        "law_resolution: 8, updates: 1", []),
    "crush.voxel": (REPEATED, "resolution: 6, rate: 0.05, strain: 0.05, frames: [0]", []),
    "tune.plateau": (
        [], "recipe: cell, target: 0.02, vary: field.gaussian.level, low: 0.2, high: 0.5, resolution: 4, rate: 0.05, "
        "first: 2, evaluations: 3, accuracy: 0.4", []),
    "slice.mesh": ([BOX], "pixel: 0.25", ["  - write.png"]),
    "check.connectivity": (TILED, "resolution: 8", []),
    "check.local_porosity": ([MAP, *TILED], "resolution: 8", []),
    "check.porosity": (TILED, "resolution: 8", []),
    "check.tiling": (TILED, "", []),
    "check.residual_periodicity": (TILED, "resolution: 8", []),
    "slice.field": (TILED, "pixel: 0.25", ["  - write.png"]),
    "write.png": ([*TILED, "  - {stage: slice.field, pixel: 0.25}"], "", []),
    "write.svg": ([*TILED, "  - {stage: slice.field, pixel: 0.25}"], "", []),
    "write.cli": ([*TILED, "  - {stage: slice.field, pixel: 0.25}"], "", []),
    "slice.plate": ([BOX, "  - {stage: slice.mesh, pixel: 0.25}"], "quantity: [2]", ["  - write.png"]),
    "write.sl1": ([FLAT, "  - {stage: slice.mesh, printer: prusa_sl1s, layer: 0.1 mm}"], "", []),
    "write.goo": ([FLAT, "  - {stage: slice.mesh, printer: elegoo_mars_4_dlp, layer: 0.2 mm}"], "", []),
    "write.nanodlp": ([FLAT, "  - {stage: slice.mesh, printer: concepts3d_athena_8k, layer: 0.2 mm}"], "", []),
    "write.mesh": ([BOX], "", []),
    "write.project": ([BOX], "settings: ['body: perimeters = 2']", []),
    "write.volume_mesh": (VOLUME, "path: part.inp, tie_faces: true, job: true", []),
    "write.voxels": (IMAGE, "", []),
    "write.stiffness": ([*REPEATED, "  - {stage: homogenize.voxel, resolution: 4}"], "image_size: [300, 300]", []),
    "write.curves": (TEST, "", []),
    "write.frames": (
        [*REPEATED, "  - {stage: crush.voxel, resolution: 8, rate: 0.05, strain: 0.05, frames: [0, 0.05]}"],
        "image_size: [40, 40]", []),
    "write.flow": ([*REPEATED, "  - {stage: homogenize.permeability, resolution: 6}"], "image_size: [300, 300]", []),
    "write.absorption": ([*REPEATED, "  - {stage: homogenize.acoustics, resolution: 6, cell: 5 mm}"], "", []),
    "write.graph": (AS_CELL[:3], "", []),
    "write.network": (AS_CELL, "resolution: 8, cell: 5 mm", []),
    "write.view": (AS_CELL, "", []),
    "write.picture": ([BOX], "image_size: [32, 32], resolution: 4", []),
    "write.section": (AS_CELL, "pixels: 24", []),
}  # fmt: skip
"""What comes before a stage, the options it gets, and what comes after."""

NO_PIPELINE = {"write.bars", "write.chart", "write.sheet", "write.table"}
"""Stand only after a sweep."""

HOSTILE = [
    ".nan", ".inf", "-.inf", "-1", "0", "1e300", "-1e300", "1e400", "1" + "0" * 400, "1e-300", "x", "''", "~", "true",
    "[]", "[1]", "[1, 2, 3, 4, 5, 6, 7]", "[.nan, .nan]", "[.nan, .nan, .nan]", "{}", "{a: 1}", "5 mm", "5 parsec",
    "-5 mm", "0 mm", "1e300 mm", "1e-300 mm", "1e300 m", ".nan mm", "'\\0'", "1e-9", "0.5", "3", "'3'",
]  # fmt: skip

HARMLESS = {"title", "description", "x_label", "y_label", "x", "y"}
"""Free texts."""


def all_options():
    return [(name, option) for name in STAGES for option in options_of(stage_class(name)).values()]


def members(kind):
    if typing.get_origin(kind) in (typing.Union, types.UnionType):
        return [m for part in typing.get_args(kind) if part is not types.NoneType for m in members(part)]
    if typing.get_origin(kind) is tuple:
        return [m for part in typing.get_args(kind) if part is not Ellipsis for m in members(part)]
    return [kind]


@pytest.mark.parametrize("name", STAGES)
def test_every_number_has_two_ends(name):
    for option in options_of(stage_class(name)).values():
        if {int, float, Length} & set(members(option.kind)):
            spec = option.spec
            assert spec.minimum is not None or spec.above is not None, option.name
            assert spec.maximum is not None or spec.below is not None, option.name


def test_every_stage_is_tested():
    assert set(PLACES) | NO_PIPELINE >= set(STAGES)


def document(name: str, option: str, value: str, alone: bool = False) -> tuple[str, int]:
    """A configuration with one option of one stage set; and the line it stands in. It can't run if that is `alone`."""
    before, given, after = PLACES[name]
    options = [] if not given else [part for part in _split(given) if part.split(":")[0].strip() != option]
    entry = "  - {" + ", ".join([f"stage: {name}", *options, f"{option}: {value}"]) + "}"
    # reading YAML is most of the work, so recipes stand there only where they may be used
    named = " ".join([*before, given, *after])
    used = [text for name, text in (("cell", RECIPE), ("counted", GRADED)) if f"recipe: {name}" in named]
    recipes = ["recipes:", *"".join(used).splitlines()] if used else []
    head = ["sppm: 1", *recipes, "pipeline:"]
    if alone:
        before = after = []
    return "\n".join([*head, *before, entry, *after]) + "\n", len(head) + len(before) + 1


def _split(given: str) -> list[str]:
    parts, depth, word = [], 0, ""
    for c in given:
        depth += (c == "[") - (c == "]")
        if c == "," and not depth:
            parts.append(word.strip())
            word = ""
        else:
            word += c
    return [*parts, word.strip()]


@pytest.fixture(scope="module", autouse=True)
def _plugins_are_loaded_once():
    """Nothing changes about them from one value to the next."""
    with pytest.MonkeyPatch.context() as patch:
        loaded, load = [], session.load_plugins

        def load_once(builtins, **how):
            assert how == {"files": [], "distributions": True, "allowed": list(DOCUMENTED)}
            if not loaded:
                loaded.append(load(builtins, **how))
            return loaded[0]

        patch.setattr(session, "load_plugins", load_once)
        yield


def plan_of(path: Path):
    return open_session(RunRequest(str(path), allowed=DOCUMENTED)).plan()


@pytest.mark.parametrize("name", PLACES)
def test_hostile_values(name, tmp_path, request):
    """Refused with option, value, what is allowed and line; accepted ones stay within the declared bounds."""
    path = tmp_path / "config.yaml"
    for i, option in enumerate(options_of(stage_class(name)).values()):
        if option.name in HARMLESS:
            continue
        # every option meets a third of the values, and each stage and each type of option all of them
        for value in HOSTILE[i % 3 :: 3]:
            # options are read before stages are wired, so that most values are refused where nothing else stands
            for alone in (True, False):
                text, line = document(name, option.name, value, alone)
                path.write_text(text, encoding="utf-8")
                refused = None
                try:
                    plan = plan_of(path)
                except ConfigError as error:
                    refused = error
                if f"option {option.name!r}" in str(refused):
                    break
            if refused is not None:
                errors = refused.errors if isinstance(refused, ConfigErrors) else (refused,)
                assert all(one.where is not None and one.where.line == line for one in errors), (value, str(refused))
                words = str(refused)
                assert len(words) < 900, (option.name, value)
                if "not allowed in a string" not in words and "`" not in words:  # options that exclude each other
                    assert f"option {option.name!r}" in words, (value, words)
                    assert "expected" in words or "output" in words, (value, words)
                continue
            stage = next(step.stage for step in plan.steps if step.stage.name == name)
            accepted = getattr(stage, option.name)
            for number in accepted if isinstance(accepted, tuple) else (accepted,):
                size = number.value if isinstance(number, Length) else number
                if isinstance(size, (int, float)) and not isinstance(size, bool):
                    assert math.isfinite(size), (option.name, value)
                    assert abs(size) <= 1e15, (option.name, value)


def filled(kind, number):
    """A value of tuples within tuples, all of whose numbers are the same."""
    if typing.get_origin(kind) is tuple:
        inner = typing.get_args(kind)
        if inner[-1] is ...:  # pairs may have to ascend
            inner = inner[:1] * (1 if typing.get_origin(inner[0]) is tuple else 2)
        return [filled(one, number) for one in inner]
    return "constant" if kind is str else number


def ends(option) -> list[str]:
    """Values at the ends of what is allowed, as YAML; integers only where they stay small."""
    spec, kinds = option.spec, members(option.kind)
    found = []
    for bound, step in ((spec.minimum, 0), (spec.above, 1), (spec.maximum, 0), (spec.below, -1)):
        if bound is None:
            continue
        whole = int in kinds and not {float, Length} & set(kinds)
        if whole and (bound > 20 or bound + step < 0):
            continue
        number = int(bound + step) if whole else bound + step * (1e-300 if not bound else 1e-12)
        # of a union, the tuple in it
        parts = (option.kind, *typing.get_args(option.kind))
        shape = next((kind for kind in parts if typing.get_origin(kind) is tuple), None)
        found.append(json.dumps(filled(shape, number)) if shape else str(number))
        if Length in kinds and not shape:
            found += ["0.001 mm", "900 m"]
    return found


LARGE = {(stage, option) for stage in ("slice.field", "slice.mesh") for option in ("pixel", "layer")}
LARGE |= {
    ("crush.voxel", "rate"),
    ("tune.plateau", "rate"),
    ("tune.tensor", "resolution"),
    ("optimize.density", "cell"),
    ("optimize.density", "filter"),
}
"""Options one end of which asks for a great deal of honest work."""


LONGEST = 300
"""Seconds of processor time, kernels that have to be compiled first included: a guard against hanging."""


def too_slow(number, frame):
    raise TimeoutError("took too long")


@pytest.mark.parametrize("name", PLACES)
def test_the_ends_of_what_is_allowed_give_results_or_errors_that_can_be_cured(name, tmp_path, ball):
    from sppm_pipeline.services.formats import stl

    readings = "".join(f"{min(400 * d, 800 + 20 * d)},{d}\n" for d in (i / 50 for i in range(500)))
    (tmp_path / "test.csv").write_text(f"Force (N),Displacement (mm)\n{readings}", encoding="utf-8")
    (tmp_path / "part.stl").write_bytes(b"".join(stl.encode(ball.vertices, ball.faces)))
    path, done, tried, planned = tmp_path / "config.yaml", set(), 0, 0
    for option in options_of(stage_class(name)).values():
        for value in dict.fromkeys(ends(option)) if (name, option.name) not in LARGE else ():
            text, _ = document(name, option.name, value)
            path.write_text(text, encoding="utf-8")
            failed, tried = None, tried + 1
            before = signal.signal(signal.SIGPROF, too_slow)
            signal.setitimer(signal.ITIMER_PROF, LONGEST)
            try:
                plan = plan_of(path)
                planned += 1
                stages = repr([step.stage for step in plan.steps])
                if stages not in done:  # an end may be the default, or what the place gives
                    run_plan(plan, tmp_path / "out", threads=1)
                    done.add(stages)
            except SppmError as error:
                failed = error
            finally:
                signal.setitimer(signal.ITIMER_PROF, 0)
                signal.signal(signal.SIGPROF, before)
            if failed is not None:
                assert failed.exit_code in (2, 3, 5), (option.name, value, str(failed))
                assert failed.where is not None or isinstance(failed, ConfigErrors), (option.name, value)
    # a place that is wrong itself would have all of them refused
    assert planned or not tried, "no end of any option gets as far as a run"


def test_values_that_stages_set_have_the_same_bounds():
    for _, option in all_options():
        if {int, float, Length} & set(members(option.kind)) and Path not in members(option.kind):
            for value in (math.nan, math.inf, -math.inf, 1e300, 10**400, True, "x", {}):
                with pytest.raises(ValueError):
                    parse_typed(option, value, Path())
