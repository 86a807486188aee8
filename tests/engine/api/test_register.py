"""Classes of stages that are written in a notebook: in recipes, pipelines and as functions."""

import subprocess
import sys
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

import sppm_pipeline as sppm
from sppm_pipeline.engine.cache.identity import has_files
from sppm_pipeline.engine.plan.plugins import REGISTERED
from sppm_pipeline.errors import PluginError


@dataclass(frozen=True, kw_only=True)
class Diagonal(sppm.Sampler):
    """Pores along the diagonal."""

    name: ClassVar[str] = "sample.diagonal"
    count: int = sppm.option(8, help="number of pores", minimum=2)

    def throw(self, rng, box):
        return np.repeat((np.arange(self.count) + rng.uniform(0.2, 0.8))[:, None], 3, 1) / self.count


FIELD = {"pore_radius": 0.14, "tunnel_radius": 0.08}


@pytest.fixture(autouse=True)
def _forget():
    yield
    REGISTERED.stages.clear()


def test_a_registered_class_is_a_function():
    with pytest.raises(AttributeError, match="no stage"):
        _ = sppm.sample.diagonal
    assert sppm.register(Diagonal) is Diagonal
    assert sppm.sample.diagonal(count=5, seed=1).centers.shape == (5, 3)
    assert "diagonal" in dir(sppm.sample)
    assert "number of pores" in sppm.sample.diagonal.__doc__
    with pytest.raises(sppm.ConfigError, match="at least 2"):
        sppm.sample.diagonal(count=1)
    assert sppm.Pipeline([{"stage": "sample.diagonal", "count": 3}]).run(cache=False)["sample.diagonal"].per_cell == 3


def test_objects_stand_in_pipelines_and_recipes_without_being_registered():
    run = sppm.Pipeline([Diagonal(count=5), sppm.connect.mst()], seed=2).run(cache=False)
    assert run.numbers["sample.diagonal.pores"] == 5
    again = sppm.sample.diagonal(count=5, seed=2)
    assert again.digest() == run["sample.diagonal"].digest()
    tuned = sppm.tune.retry(recipe=[Diagonal(), sppm.connect.mst(), sppm.field.gaussian(**FIELD)], seed=1)
    assert len(tuned.graph.pores.centers) == 8


def test_a_class_that_is_registered_again_replaces_the_first():
    sppm.register(Diagonal)
    first = sppm.sample.diagonal(seed=1)

    @sppm.register
    class Other(Diagonal):
        def throw(self, rng, box):
            return super().throw(rng, box)[:3]

    assert len(sppm.sample.diagonal(seed=1).centers) == 3 < len(first.centers)
    # an object of the first makes it the stage of this name again
    run = sppm.Pipeline([Diagonal()], seed=1).run(cache=False)
    assert run["sample.diagonal"].digest() == first.digest()


def test_what_breaks_the_contract_is_refused_and_changes_nothing():
    with pytest.raises(PluginError, match="has no name"):
        sppm.register(int)

    class Plain(Diagonal):
        name: ClassVar[str] = "plain"

    with pytest.raises(sppm.ConfigError, match="is no dataclass"):
        sppm.Pipeline([Plain()])
    with pytest.raises(PluginError, match=r"must be named family\.name"):
        sppm.register(Plain)

    @dataclass(frozen=True, kw_only=True)
    class Taken(Diagonal):
        name: ClassVar[str] = "sample.dart_throwing"

    with pytest.raises(PluginError, match=r"comes from sppm itself and from the plugin registered"):
        sppm.register(Taken)
    assert REGISTERED.stages == {}
    assert sppm.sample.dart_throwing(count=3, spacing=0.1, seed=1).per_cell == 3


def test_yaml_of_it_says_that_no_one_else_can_run_it():
    pipeline = sppm.Pipeline([Diagonal(count=5)])
    with pytest.warns(sppm.SppmWarning, match=r"'sample\.diagonal' is known to this process alone") as caught:
        assert "sample.diagonal, count: 5" in pipeline.to_yaml()
    assert caught[0].filename == __file__


NOTEBOOK = """
import numpy as np, sppm_pipeline as sppm
from dataclasses import dataclass
from sppm_pipeline.engine.cache.identity import has_files

def made(number):
    @dataclass(frozen=True, kw_only=True)
    class Some(sppm.Sampler):
        name = "sample.some"
        def throw(self, rng, box):
            return rng.random((number, 3))
    run = sppm.Pipeline([Some()]).run(cache=FOLDER)
    return int(run.numbers["sample.some.pores"]), has_files(Some)

print(made(3), made(4))
"""


def test_what_no_file_holds_is_not_kept_between_runs(tmp_path):
    code = f"FOLDER = {str(tmp_path)!r}{NOTEBOOK}"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert found.stdout.split("\n")[0] == "(3, False) (4, False)", found.stderr
    assert has_files(Diagonal)


def test_recipes_nest_at_any_depth():
    cell = [sppm.sample.dart_throwing(count=14, spacing=0.2), sppm.connect.mst(), sppm.field.gaussian(**FIELD)]
    inner = sppm.tune.retry(recipe=cell, id="again")
    outer = sppm.tune.retry(recipe=[inner])
    made = sppm.Pipeline([outer], seed=1).run(cache=False)["tune.retry"]
    assert len(made.graph.pores.centers) == 14
    text = sppm.Pipeline([outer], recipes={"recipe": cell}, seed=1).to_yaml()
    again = sppm.Pipeline.from_yaml(text)
    assert "recipe3" in text
    assert again.to_yaml() == text
