"""Stages as functions: the results, options and errors of a pipeline."""

import numpy as np
import pytest

import sppm_pipeline as sppm
from sppm_pipeline.engine.api.registering import registry
from sppm_pipeline.engine.config.options import options_of
from sppm_pipeline.engine.plan.ports import signature_of
from sppm_pipeline.errors import ConfigError

pytestmark = [  # of these no test is about
    pytest.mark.filterwarnings("ignore:.*changes the radii"),
    pytest.mark.filterwarnings("ignore:.*the error bar is"),
]

CELL = {"pore_radius": 0.14, "tunnel_radius": 0.05}


@pytest.fixture(scope="module")
def pores():
    return sppm.sample.dart_throwing(count=14, spacing=0.2, seed=1)


@pytest.fixture(scope="module")
def cell(pores):
    return sppm.field.gaussian(**CELL)(sppm.connect.mbdst(pores, mode="greedy", seed=1))


def test_from_pores_to_stiffness(pores, cell):
    assert isinstance(pores, sppm.PoreSet)
    assert cell.sample(8).shape == (8, 8, 8)
    with pytest.warns(sppm.SppmWarning, match="too few"):
        report = sppm.homogenize.voxel(resolution=8)(cell)
    assert report.C.shape == (6, 6)
    assert report.C is report.stiffness


def test_the_same_numbers_as_in_a_pipeline(pores, cell):
    stages = [
        sppm.step.sample.dart_throwing(count=14, spacing=0.2),
        sppm.step.connect.mbdst(mode="greedy"),
        sppm.step.field.gaussian(**CELL),
    ]
    run = sppm.Pipeline(stages, seed=1).run(cache=False)
    assert run["sample.dart_throwing"].digest() == pores.digest()
    assert run["field.gaussian"].digest() == cell.digest()


def test_options_are_checked_as_in_a_file():
    with pytest.raises(sppm.ConfigError, match=r"no option 'cont'(.|\n)*did you mean 'count'"):
        sppm.sample.dart_throwing(cont=14, spacing=0.2)
    with pytest.raises(sppm.ConfigError, match="at least 0"):
        sppm.sample.dart_throwing(count=-1, spacing=0.2)
    with pytest.raises(sppm.ConfigError, match="exclude each other"):
        sppm.sample.dart_throwing(count=1, total=2, spacing=0.2)


def test_a_length_is_written_as_in_a_file_or_given_as_one():
    by_text = sppm.read.primitive(shape="box", size=["2 mm", "3 mm", "4 mm"])
    lengths = (sppm.Length(2, "mm"), sppm.Length(3, "mm"), sppm.Length(0.4, "cm"))
    by_value = sppm.read.primitive(shape="box", size=lengths)
    assert by_text.digest() == by_value.digest()
    assert by_text.summary()["volume_mm3"] == pytest.approx(24)


def test_random_numbers_need_a_seed(pores):
    step = sppm.sample.dart_throwing(count=14, spacing=0.2)
    with pytest.raises(sppm.ConfigError, match=r"no seed(.|\n)*seed=1"):
        step()
    with pytest.raises(AttributeError, match=r"is a step and has not run.*\.\.\., seed=1\)"):
        _ = step.centers
    with pytest.raises(sppm.errors.WiringError, match=r"has not run(.|\n)*seed=1"):
        sppm.connect.mst(step)
    assert step(seed=1).digest() == pores.digest()
    one, same, other = (sppm.sample.dart_throwing(count=14, spacing=0.2, seed=seed).digest() for seed in (1, 1, 2))
    assert one == same != other


def test_what_does_not_fit_is_refused(cell):
    with pytest.raises(sppm.errors.WiringError, match="can't take Microstructure: pores takes PoreSet"):
        sppm.connect.mst(cell)
    with pytest.raises(sppm.errors.WiringError, match="can't take Microstructure"):
        sppm.connect.mst(pores=cell)
    with pytest.raises(sppm.errors.WiringError, match="for the port 'domain'"):
        sppm.fill.implicit()(sppm.tile.periodic(cells=[2, 2, 2], cell="2 mm")(cell))
    with pytest.raises(sppm.ConfigError, match="`seed` belongs to the second call"):
        sppm.connect.mst(seed=1)
    with pytest.raises(sppm.ConfigError, match="`output` belongs to the second call"):
        sppm.write.picture(path="part.png", output="somewhere")


def test_unknown_stages_have_a_hint():
    with pytest.raises(AttributeError, match=r"did you mean 'sample.dart_throwing'"):
        sppm.sample.dart_throwin  # noqa: B018
    assert "dart_throwing" in dir(sppm.sample)
    assert "total" in str(sppm.sample.dart_throwing.__signature__)
    assert "discarding those closer" in sppm.sample.dart_throwing.__doc__


@pytest.mark.parametrize(("ending", "stage"), [("nrrd", "voxels"), ("TIFF", "voxels"), ("STL", "mesh")])
def test_who_asks_for_a_format_is_told_the_stage_that_writes_it(ending, stage):
    with pytest.raises(AttributeError, match=f"did you mean 'write.{stage}'"):
        getattr(sppm.write, ending)
    with pytest.raises(AttributeError, match=r"stages of this family: .*write\.absorption"):
        _ = sppm.write.dwg


def test_numbers_instead_of_what_is_made(cell):
    numbers = sppm.check.porosity(resolution=24).report(cell)
    assert numbers["porosity"] == pytest.approx(1 - cell.solid(24).mean(), abs=0.01)


def test_a_recipe_is_a_list_of_stages():
    recipe = [
        sppm.step.sample.dart_throwing(count=14, spacing=0.2),
        {"stage": "connect.mbdst", "mode": "greedy"},
        sppm.step.field.gaussian(**CELL),
    ]
    tuned = sppm.tune.porosity(target=0.6, resolution=24, recipe=recipe, seed=2)
    assert 1 - tuned.solid(24).mean() == pytest.approx(0.6, abs=0.02)


def test_a_recipe_may_be_the_name_of_a_preset_but_not_one_stage():
    cell = sppm.tune.porosity(recipe="paper", target=0.6, fit_count=True, seed=1)
    assert sppm.check.porosity(resolution=24)(cell)["porosity"] == pytest.approx(0.6, abs=0.02)
    for one in (sppm.step.sample.dart_throwing(total=40, share=0.5), lambda: None):
        with pytest.raises(ConfigError, match=r"must be a list of stages, got one (BoundStage|function)"):
            sppm.tune.porosity(recipe=one, target=0.6)


def test_options_by_position_are_refused_with_a_hint():
    with pytest.raises(ConfigError, match=r"takes no artifacts, got str\n  hint: options are given by name, .* path="):
        sppm.read.mesh("part.stl")


def test_misspelt_families_have_a_hint():
    with pytest.raises(AttributeError, match="did you mean 'sample'"):
        _ = sppm.smaple
    assert not hasattr(sppm, "__wrapped__")


def test_files_go_where_they_are_asked_for(cell, tmp_path):
    with pytest.warns(sppm.SppmWarning, match="no physical size"):
        mesh = sppm.extract.marching_cubes(resolution=24)(cell)
    (path,) = sppm.write.stl(path="deep/part.stl")(mesh, output=tmp_path)
    assert path == tmp_path / "deep" / "part.stl"
    assert path.stat().st_size > 84
    assert [child.name for child in tmp_path.iterdir()] == ["deep"]
    with pytest.raises(sppm.ConfigError):
        sppm.write.stl(path="../part.stl")


def test_a_folder_is_never_written_into(tmp_path):
    stack = sppm.SliceStack.from_array(np.ones((3, 4, 5), bool), pixel_mm=0.1)
    paths = sppm.write.png(stack, path="layers", sheet=0, output=tmp_path)
    assert [path.name for path in paths] == ["layers"]
    assert len(list(paths[0].glob("*.png"))) == 3
    with pytest.raises(sppm.ConfigError, match="a folder"):
        sppm.write.png(stack, path="layers", sheet=0, output=tmp_path)


def test_no_stage_uses_a_word_of_the_calls():
    for name in (name for name in registry() if registry().owner(name).builtin):
        cls = registry().get(name)
        words = set(options_of(cls)) | {port.name for port in signature_of(cls).ports if not port.is_recipe}
        assert not words & {"seed", "threads", "output", "recipe", "artifacts"}, name
