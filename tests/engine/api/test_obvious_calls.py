"""Calls that people write who come from NumPy, pandas, PyVista or scikit-image: they work, or say what to write."""

import re

import numpy as np
import pytest

import sppm_pipeline as sppm


@pytest.fixture(scope="module")
def small():
    return sppm.cell("paper", seed=1, total=30, edge="4 mm", tunnel_radius="0.6 mm")


def test_arrays_of_artifacts_are_those_of_to_numpy(small):
    for made in (small, small.voxels(16), small.graph.pores):
        assert (np.asarray(made) == made.to_numpy()).all()
    with pytest.raises(TypeError, match="a TunnelGraph is no array"):
        np.asarray(small.graph)


def test_what_an_artifact_lacks_is_said(small):
    with pytest.raises(AttributeError, match=r"a SurfaceMesh has no 'face'; did you mean 'faces'\? \(see also summary"):
        sppm.read.primitive(shape="ball", size=["4 mm"] * 3).face  # noqa: B018
    assert len(repr(small)) < 250

    class Broken(sppm.Artifact):
        @property
        def entry(self):
            return self.missing

    with pytest.raises(AttributeError, match="has no 'missing'"):
        Broken().entry  # noqa: B018


def test_layers_of_a_stack_are_indexed_as_those_of_an_array():
    ball = sppm.read.primitive(shape="ball", size=["4 mm"] * 3)
    stack = sppm.slice.mesh(ball, pixel="0.25 mm")
    layers = stack.to_numpy()
    assert len(stack) == len(layers) == len(list(stack)) == 16
    for which in (3, -1, np.int64(2), slice(3, 9, 2), slice(None, None, -1), slice(5, 5)):
        assert np.array_equal(stack[which], layers[which])
    assert all(np.array_equal(one, layer) for one, layer in zip(stack, layers, strict=True))
    with pytest.raises(IndexError, match="the stack has 16 layers, got 16"):
        stack[16]


def test_what_was_run_lists_itself():
    run = sppm.Pipeline([sppm.sample.dart_throwing(count=5, spacing=0.1), "connect.mst"]).run(cache=False)
    assert list(run) == ["sample.dart_throwing", "connect.mst"]
    with pytest.raises(sppm.ConfigError, match=r"no stage 0\n.*known: connect.mst"):
        run[0]
    for name in ("threads", "jobs"):
        for value in (0, 2.0, "2", True):
            with pytest.raises(sppm.ConfigError, match=f"`{name}` is an integer"):
                sppm.run("quickstart", **{name: value})
    swept = sppm.Pipeline([sppm.sample.dart_throwing(count=5, spacing=0.1)]).sweep(seed=range(2)).run(cache=False)
    assert "2 runs" in repr(swept)
    assert swept.table["seed"] == (0, 1)
    assert len(swept.table) == 2
    assert list(swept.table)[:2] == ["run", "seed"]
    assert repr(swept.table).startswith("<Table of 2 rows: run, seed")


def test_files_are_written_where_their_path_says(tmp_path):
    ball = sppm.read.primitive(shape="ball", size=["4 mm"] * 3, facets=8)
    assert sppm.write.mesh(ball, path=tmp_path / "new" / "ball.stl") == [tmp_path / "new" / "ball.stl"]
    assert (tmp_path / "new" / "ball.stl").stat().st_size > 0
    with pytest.raises(sppm.ConfigError, match="leaves the run directory"):
        sppm.write.mesh(ball, path=tmp_path / "ball.stl", output=tmp_path)


def test_hints_for_what_others_would_write(small):
    for call, words in (
        (
            lambda: sppm.write.mesh(sppm.read.primitive(shape="ball", size=["4 mm"] * 3), "part.stl"),
            "by name, for example path=",
        ),
        (lambda: sppm.field.voxels(np.ones((4, 4, 4), bool)), "sppm.Voxels.from_array"),
    ):
        with pytest.raises(sppm.ConfigError, match=re.escape(words)):
            call()
    with pytest.raises(sppm.ConfigError, match=r"no preset 'papr'\n.*did you mean 'paper'"):
        sppm.tune.porosity(target=0.5, recipe="papr", seed=1)
    for resolution in (0, "64", 1.5, (16, 16, 16), True):
        with pytest.raises(ValueError, match="the resolution is an integer"):
            small.to_numpy(resolution)
    assert sppm.Voxels.from_array(np.ones((4, 4, 4), bool), spacing="50 um").spacing == (0.05, 0.05, 0.05)
    with pytest.raises(ValueError, match="Length"):
        sppm.Length("4 mm")
    with pytest.raises(ValueError, match="edge of a cell"):
        sppm.Cell("4 mm")
