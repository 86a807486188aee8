"""Pipelines as values, and runs: the same as the command line's, in memory until they are saved."""

import io
import json
from pathlib import Path

import numpy as np
import pytest

import sppm_pipeline as sppm
from sppm_pipeline.engine.api.monitor import SweepProgress, SweepWarnings
from sppm_pipeline.engine.api.run import Numbers
from sppm_pipeline.engine.cli.main import main

pytestmark = pytest.mark.filterwarnings("ignore:.*changes the radii")  # which are of no concern here

YAML = """\
sppm: 1
name: small
seed: 4
params: {pores: 14}
recipes:
  cell:
    - {stage: sample.dart_throwing, count: "${pores}", spacing: 0.2}
    - {stage: connect.mbdst, mode: greedy}
    - {stage: field.gaussian, pore_radius: 0.14, tunnel_radius: 0.05}
pipeline:
  - {stage: tune.porosity, recipe: cell, target: 0.6, resolution: 24, tolerance: 0.02}
  - {stage: check.porosity, id: measured, resolution: 24}
  - {stage: tile.periodic, cell: 2 mm, cells: [2, 1, 1]}
  - {stage: slice.field, resolution: 24}
  - {stage: write.png, sheet: 0}
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return sppm.run(YAML, cache=tmp_path_factory.mktemp("cache"))


def files(folder):
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_artifacts_and_numbers_are_in_memory(run):
    cell = run["tune.porosity"]
    assert isinstance(cell, sppm.Microstructure)
    assert isinstance(run["slice.field"], sppm.SliceStack)
    assert run.numbers["measured.porosity"] == pytest.approx(0.6, abs=0.03)
    assert run.record["seed"] == 4
    with pytest.raises(sppm.ConfigError, match=r"no stage 'tune.prosity'"):
        run["tune.prosity"]


def test_a_saved_run_is_that_of_the_command_line(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("small.yaml").write_text(YAML, encoding="utf-8")
    assert main(["run", "small.yaml", "-o", "line", "-q", "--no-cache"]) == 0
    run.save("python")
    sppm.run("small.yaml", output="written", cache=False)
    line, python, written = (files(Path(name)) for name in ("line", "python", "written"))
    records = [json.loads(saved.pop("run.json")) for saved in (line, python, written)]
    assert line == python == written
    assert len(line) > 10
    assert records[0]["stages"][1]["summary"] == records[1]["stages"][1]["summary"]
    loaded = sppm.load("python", cache=False)
    assert loaded.numbers == run.numbers


def test_yaml_and_python_are_the_same_pipeline(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    from_text = sppm.Pipeline.from_yaml(YAML)
    step = sppm.step
    built = sppm.Pipeline(
        [
            step.tune.porosity(recipe="cell", target=0.6, resolution=24, tolerance=0.02),
            step.check.porosity(id="measured", resolution=24),
            step.tile.periodic(cell="2 mm", cells=(2, 1, 1)),
            step.slice.field(resolution=np.int64(24)),
            step.write.png(sheet=0),
        ],
        recipes={
            "cell": [
                step.sample.dart_throwing(count="${pores}", spacing=sppm.Length(0.2)),
                step.connect.mbdst(mode="greedy"),
                step.field.gaussian(pore_radius=0.14, tunnel_radius=0.05),
            ]
        },
        params={"pores": 14},
        name="small",
        seed=4,
    )
    assert built.to_yaml() == from_text.to_yaml()
    assert sppm.Pipeline.from_yaml(built.to_yaml()).to_yaml(defaults=True) == from_text.to_yaml(defaults=True)
    assert "tolerance: 0.02" in built.to_yaml()
    assert "degree" not in built.to_yaml()


@pytest.mark.parametrize("file", sorted((Path(__file__).parents[3] / "configs").glob("*.yaml")), ids=lambda p: p.stem)
def test_configurations_survive_the_way_through_yaml(file, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    pipeline = sppm.Pipeline.from_yaml(file)
    again = sppm.Pipeline.from_yaml(pipeline.to_yaml())
    assert again.to_yaml(defaults=True) == pipeline.to_yaml(defaults=True)


def test_a_pipeline_is_a_value():
    pipeline = sppm.Pipeline.from_yaml(YAML)
    other = pipeline.with_(pores=20, seed=7, set={"measured.resolution": 32}).with_(pores=18)
    assert "pores: 18" in other.to_yaml()
    assert "seed: 7" in other.to_yaml()
    assert "resolution: 32" in other.to_yaml()
    assert pipeline.to_yaml() == sppm.Pipeline.from_yaml(YAML).to_yaml()
    with pytest.raises(sppm.ConfigError, match="did you mean 'pores'"):
        pipeline.with_(pore=3).check()


def test_a_pipeline_of_a_file_is_that_file():
    assert sppm.Pipeline("cell").to_yaml() == sppm.Pipeline.from_yaml("cell").to_yaml()
    with pytest.raises(sppm.ConfigError, match="its own recipes"):
        sppm.Pipeline("cell", seed=3)


def test_mistakes_are_reported_together_with_their_places():
    wrong = sppm.Pipeline([{"stage": "sample.dart_throwing", "cont": 1}, "connect.mdst"])
    with pytest.raises(sppm.errors.ConfigErrors) as caught:
        wrong.check()
    assert "pipeline[0].cont" in str(caught.value)
    assert "did you mean 'connect.mbdst'" in str(caught.value)
    with pytest.raises(sppm.ConfigError, match=r"2:1.*unknown key 'pipelin'"):
        sppm.check("sppm: 1\npipelin: []\npipeline: [sample.dart_throwing]\n")


def test_a_sweep_has_a_table():
    pipeline = sppm.Pipeline(
        [sppm.step.sample.dart_throwing(id="pores", count="${n}", spacing=0.1)], params={"n": 3}, seed=1
    )
    run = pipeline.sweep(n=[2, 3], seed=range(2)).run(jobs=2, cache=False)
    assert run.table.column("n") == (2, 2, 3, 3)
    assert run.table.numbers("pores.pores").tolist() == [2, 2, 3, 3]
    assert set(run.table.to_arrays()) >= {"n", "seed", "status"}
    assert "<table>" in run._repr_html_()
    with pytest.raises(sppm.ConfigError, match="no single result"):
        run["pores"]


def test_names_are_escaped_in_notebooks():
    evil = "<script>alert(1)</script>"
    shown = (
        sppm.Table.from_arrays({evil: [evil, "b"]})._repr_html_()
        + sppm.SurfaceMesh.from_arrays(np.eye(3), np.zeros((0, 3)), evil)._repr_html_()
    )
    assert "<script" not in shown
    assert "&lt;script&gt;" in shown


def test_cells_have_a_picture(run):
    cell = run["tune.porosity"]
    assert cell._repr_png_().startswith(b"\x89PNG")
    assert '<iframe sandbox="allow-scripts" srcdoc="' in cell._repr_html_()
    assert len(cell._repr_html_()) < 60_000
    assert len(repr(cell)) < 1000


def test_numbers_that_are_not_there_are_answered_by_those_that_are(capsys):
    stage = {"stage": "sample.dart_throwing", "count": 5, "spacing": 0.1, "id": "pores"}
    pipeline = sppm.Pipeline([stage])
    numbers = pipeline.run(cache=False).numbers
    with pytest.raises(sppm.ConfigError, match=r"no number 'pores\.por'(.|\n)*pores\.pores"):
        numbers["pores.por"]
    assert "pores.por" not in numbers
    many = Numbers({f"solid.C.{i}.{j}": 0.0 for i in range(1, 7) for j in range(1, 7)} | {"solid.E.1": 1, "cell.E": 1})
    for name, told in (
        ("E", "did you mean 'cell.E' or 'solid.E.1'?"),
        ("solid.E1", "did you mean 'solid.E.1'?"),
        ("typo", "known: cell.E, solid.C.1.1, (.*) and 18 more"),
    ):
        with pytest.raises(sppm.ConfigError, match=rf"no number '{name}'\n.*{told}"):
            many[name]
    sweep = pipeline.sweep(seed=range(3)).run(cache=False)
    with pytest.raises(sppm.ConfigError, match=r"no column 'poress'\n.*did you mean 'pores\.pores'"):
        sweep.table.numbers("poress")
    with pytest.raises(sppm.ConfigError, match=r"numbers of 3 runs(.|\n)*to_pandas(.|\n)*pores\.pores"):
        _ = sweep.numbers
    assert sweep.table.column("seed") == (0, 1, 2)
    # neither a terminal nor a notebook
    assert capsys.readouterr().err == ""


def test_warnings_of_a_sweep_that_differ_in_numbers_are_told_once():
    monitor = SweepWarnings()
    for share in (0.31, 0.12, 0.5):
        monitor.warning("solid", f"{share} of the solid is loose")
    monitor.warning(None, "another")
    with pytest.warns(sppm.SppmWarning) as told:
        monitor.close()
    assert [str(one.message) for one in told] == [
        "another", "solid: 0.12 of the solid is loose (and alike 2 times more in this sweep)",
    ]  # fmt: skip


def test_progress_of_a_sweep_is_one_line_that_is_written_again():
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    stream, now = Terminal(), iter([0.0, 10.0, 20.0, 30.0])
    progress = SweepProgress(3, stream, lambda: next(now))
    for well in (True, False, True):
        progress.row_finished(well)
    progress.close()
    shown = [text.rstrip() for text in stream.getvalue().split("\r")]
    assert shown[1] == "sweep: 0 of 3 runs"
    assert shown[2] == "sweep: 1 of 3 runs, 20 s left"
    assert shown[3:] == ["sweep: 2 of 3 runs, 1 failed, 10 s left", "sweep: 3 of 3 runs, 1 failed"]
    assert stream.getvalue().endswith("\n")


def test_warnings_point_at_the_line_of_the_user():
    pipeline = sppm.Pipeline([sppm.sample.dart_throwing(count=5, spacing=0.1)], params={"unused": 1})
    for run in (pipeline.run, pipeline.sweep(seed=[1, 2]).run):
        with pytest.warns(sppm.SppmWarning, match="is not used") as caught:
            run(cache=False)
        assert {one.filename for one in caught} == {__file__}


def test_a_cell_of_a_preset_in_one_line():
    cell = sppm.cell("stiff", seed=1, edge="4 mm")
    assert cell.edge_mm == 4
    assert cell.digest() == sppm.cell("stiff", seed=1, edge="4 mm").digest()
    with pytest.warns(sppm.SppmWarning, match="changes the radii"):
        tuned = sppm.cell("paper", porosity=0.6, seed=1, resolution=24)
    assert 1 - tuned.to_numpy(24).mean() == pytest.approx(0.6, abs=0.01)
    with pytest.raises(sppm.ConfigError, match=r"no preset 'papr'(.|\n)*did you mean 'paper'"):
        sppm.cell("papr", seed=1)


def test_a_cell_takes_the_options_of_its_stages():
    by_hand = sppm.Pipeline(
        ["sample.mirrored_faces", "sample.dart_throwing", "connect.mbdst", "field.gaussian"], seed=1
    ).run(
        set={
            "sample.mirrored_faces.total": 30, "sample.mirrored_faces.share": 0.5, "sample.dart_throwing.total": 30,
            "connect.mbdst.degree": [3, 5], "connect.mbdst.mode": "greedy", "field.gaussian.pore_radius": 0.13,
            "field.gaussian.tunnel_radius": 0.05,
        },
        cache=False,
    )["field.gaussian"]  # fmt: skip
    wide = sppm.cell("paper", seed=1, total=30, pore_radius=0.13, tunnel_radius=0.05)
    assert (wide.sample(16) == by_hand.sample(16)).all()
    # beside omega or mu, which count in the preset's own edge
    sized = sppm.cell("paper", seed=1, total=30, edge="4 mm", tunnel_radius="0.2 mm")
    assert (sized.edge_mm, sized.finest_radius) == (4.0, pytest.approx(0.05))
    assert (sized.sample(16) == sppm.cell("paper", seed=1, total=30, tunnel_radius=0.05).sample(16)).all()
    held = sppm.cell("paper", porosity=0.6, seed=1, total=30, resolution=24, pore_radius=0.13, hold="pore_radius")
    assert 1 - held.to_numpy(24).mean() == pytest.approx(0.6, abs=0.02)
    assert held.level == 0.25


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"totl": 60}, "no parameter or option 'totl'\n  hint: did you mean 'total'?"),
        ({"radius": 0.1}, "did you mean 'pore_radius' or 'tunnel_radius'?"),
        ({"porosty": 0.6}, "did you mean 'porosity'?"),
        ({"resolution": 24}, "give one, too"),
        ({"colour": 1}, "known: "),
        ({"omega": 20, "pore_radius": 0.1}, "by one of `pore_radius` and `omega`"),
        ({"pore_radius": "0.5 mm"}, "`edge: 7.5 mm`"),
        ({"edge": "4 foo"}, "unknown unit 'foo'"),
        ({"edge": "4 mm", "pore_radius": "1 foo"}, "unknown unit 'foo'"),
        ({"seed": -1}, "`seed` must be an integer"),
    ],
)
def test_what_a_cell_can_not_take_is_said(given, words):
    with pytest.raises(sppm.ConfigError) as caught:
        sppm.cell("paper", **{"seed": 1, **given})
    assert words in str(caught.value)


def test_a_run_takes_seed_parameters_and_options():
    throw = sppm.sample.dart_throwing(count=sppm.param("n"), spacing=0.1)
    pipeline = sppm.Pipeline([throw], params={"n": 5})
    run = pipeline.run(seed=2, params={"n": 6}, set={"sample.dart_throwing.spacing": 0.2}, cache=False)
    apart = pipeline.with_(n=6, set={"sample.dart_throwing.spacing": 0.2}, seed=2).run(cache=False)
    assert run[throw.name].digest() == apart[throw.name].digest() != pipeline.run(cache=False)[throw.name].digest()
    assert run.record["seed"] == 2
    for seed in (-1, "x", 2.5, True, 2**63):
        for call in (pipeline.run, sppm.step.sample.dart_throwing(count=5, spacing=0.1)):
            with pytest.raises(sppm.ConfigError, match="a seed is an integer, at least 0"):
                call(seed=seed)
    with pytest.raises(sppm.ConfigError, match="over a list of values, got 3"):
        pipeline.sweep(seed=3)


def test_a_cell_of_the_paper_has_the_size_that_is_given():
    """The paper's omega and mu count in its own edge, whatever the cell measures."""
    plain, sized = (sppm.cell("paper", seed=1, total=30, **more) for more in ({}, {"edge": "4 mm"}))
    assert (plain.edge_mm, sized.edge_mm, sized.graph.pores.cell.edge) == (None, 4.0, 4.0)
    assert sized.finest_radius == plain.finest_radius
    assert (sized.sample(16) == plain.sample(16)).all()
    with pytest.raises(sppm.ConfigError, match="has no unit"):
        sppm.cell("paper", seed=1, edge="4 mm", omega=20)
