"""Artifacts written and read again are the same, and no changed byte goes unnoticed."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from sppm_tetrahedra.volume_mesh import VolumeMesh

from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.nouns.stiffness import StiffnessReport
from sppm_pipeline.method.nouns.voxels import Voxels
from sppm_pipeline.nouns.artifact import Artifact
from sppm_pipeline.nouns.length import Cell, Length
from sppm_pipeline.nouns.storage import DamagedError, NotStorable, load_value, save_value, stored_bytes
from sppm_pipeline.nouns.table import Table
from sppm_pipeline.services.grid import Grid


@dataclass(frozen=True, eq=False)
class Anything(Artifact):
    """Whatever an artifact of somebody else may hold."""

    value: Any
    kept: dict[Any, Any] = field(default_factory=dict, compare=False)


def there_and_back(value, folder):
    folder.mkdir(parents=True)
    files = save_value(value, folder)
    assert sorted(file.name for file in files) == sorted(path.name for path in folder.iterdir())
    assert all((folder / file.name).stat().st_size == file.bytes for file in files)
    return load_value(folder, {file.name: file for file in files})


def test_nouns_of_the_program(tmp_path, wang, ball):
    rng = np.random.default_rng(1)
    voxels = Voxels(rng.integers(0, 2, (5, 70, 300)).astype(np.uint8), (1.0, 1.0, 1.0), True, (False, True, False))
    volume = VolumeMesh(rng.random((4, 3)), np.array([[0, 1, 2, 3]]), box=np.array([[0.0] * 3, [1.0] * 3]))
    micro = wang.micro
    artifacts = [micro.graph.pores, micro.graph, micro, wang, ball, voxels, volume, Table({"a": (1, None, "x")})]
    for number, artifact in enumerate(artifacts):
        again = there_and_back(artifact, tmp_path / str(number))
        assert type(again) is type(artifact)
        assert again.digest() == artifact.digest()
        assert again.summary() == artifact.summary()
        again.check()
    assert there_and_back(voxels, tmp_path / "v").values.flags.f_contiguous
    assert not there_and_back(ball, tmp_path / "b").vertices.flags.writeable


def test_a_report_keeps_what_its_method_has_to_say(tmp_path):
    """It is written to files by later stages, which must not depend on whether the report comes from the cache."""
    solver = {"grid": [16, 16, 16], "residuals": [0.1, 1e-7], "converged": True, "precision": "float32"}
    report = StiffnessReport(np.eye(6), ((1.0, 1.0, 0.3),), "a method", solver=solver)
    again = there_and_back(report, tmp_path / "report")
    assert again.solver == solver
    assert repr(again.summary()) == repr(report.summary())
    assert again.digest() == report.digest() != StiffnessReport(np.eye(6), ((1.0, 1.0, 0.3),), "a method").digest()


def test_a_loaded_tile_set_is_sampled_as_the_one_that_was_kept(tmp_path, wang):
    again = there_and_back(wang, tmp_path / "t")
    grid = Grid((0.1, 0.2, 0.3), (0.05,) * 3, (8, 9, 10))
    colors = wang.micro.colors
    before = wang.micro.alone(0, (0, 0, 0)).sample(grid)
    assert np.array_equal(again.micro.alone(0, (0, 0, 0)).sample(grid), before)
    assert again.micro.colors == colors


scalars = (
    st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.builds(np.float32, st.floats(width=32))
)
small = arrays.arrays(
    st.sampled_from([np.uint8, np.int64, np.float32, np.float64, np.bool_, ">i4"]),
    arrays.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4),
)
values = st.recursive(
    scalars | small,
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.lists(inner, max_size=4).map(tuple)
        | st.dictionaries(st.integers() | st.text() | st.tuples(st.integers(), st.integers()), inner, max_size=3)
    ),
    max_leaves=12,
)


def same(a, b) -> bool:
    if isinstance(a, np.ndarray):
        return isinstance(b, np.ndarray) and a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    if isinstance(a, (list, tuple)):
        return type(a) is type(b) and len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, dict):
        return list(a) == list(b) and all(same(a[key], b[key]) for key in a)
    return type(a) is type(b) and repr(a) == repr(b)


@given(values)
def test_any_value_comes_back_as_it_was(tmp_path_factory, value):
    again = there_and_back(Anything(value), tmp_path_factory.mktemp("any") / "x")
    assert same(again.value, value)


def test_large_and_turned_arrays(tmp_path):
    large = np.arange(200_000, dtype=np.float64).reshape(100, 2000)
    again = there_and_back(Anything((large, large.T, large[::2], large)), tmp_path / "x")
    for a, b in zip(again.value, (large, large.T, large[::2], large), strict=True):
        assert np.array_equal(a, b)
    assert again.value[0] is again.value[3]  # written once
    assert again.value[1].flags.f_contiguous
    assert np.array_equal(np.load(tmp_path / "x" / "0000.npy"), large)  # a file that others can read


def test_what_can_be_worked_out_again_is_left_out(tmp_path):
    again = there_and_back(Anything(Length(2.0, "mm"), kept={"bank": object()}), tmp_path / "x")
    assert again.value == Length(2.0, "mm")
    assert again.kept == {}


@pytest.mark.parametrize("value", [object(), lambda: 3, {1, 2}, np.array([object()]), Anything(print), b"raw"])
def test_what_can_not_be_stored_is_refused_before_anything_is_written(tmp_path, value):
    with pytest.raises(NotStorable):
        stored_bytes(value)
    with pytest.raises(NotStorable):
        save_value(value, tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_class_inside_of_a_function_is_refused():
    @dataclass(frozen=True)
    class Local(Artifact):
        pass

    with pytest.raises(NotStorable):
        stored_bytes(Local())


def test_every_changed_byte_is_noticed(tmp_path):
    artifact = Anything((np.arange(3), np.zeros(70_000, np.uint8), "text", Cell(2.0)))
    files = {file.name: file for file in save_value(artifact, tmp_path)}
    assert len(files) == 3
    rng = np.random.default_rng(5)
    for name in files:
        data = (tmp_path / name).read_bytes()
        for at in sorted({0, len(data) - 1, *rng.integers(0, len(data), 40).tolist()}):
            changed = bytearray(data)
            changed[at] ^= 1 << int(rng.integers(8))
            (tmp_path / name).write_bytes(changed)
            with pytest.raises(DamagedError):
                load_value(tmp_path, files)
        for cut in (0, 1, len(data) // 2, len(data) - 1):
            (tmp_path / name).write_bytes(data[:cut])
            with pytest.raises(DamagedError):
                load_value(tmp_path, files)
        (tmp_path / name).write_bytes(data)
    assert same(load_value(tmp_path, files).value, artifact.value)
    with pytest.raises(DamagedError, match="not listed"):
        load_value(tmp_path, {name: file for name, file in files.items() if name != "small.npy"})


def test_only_classes_of_values_are_built(tmp_path):
    artifact = Anything(Cell(2.0))
    for cls in ("os:system", "pathlib:Path", "sppm_pipeline.nouns.length:Cells", "no_such_module:Cell"):
        folder = tmp_path / cls.replace(":", "-")
        folder.mkdir()
        tree = folder / "value.json"
        (file,) = save_value(artifact, folder)
        data = tree.read_bytes().replace(b"sppm_pipeline.nouns.length:Cell", cls.encode())
        tree.write_bytes(data)
        forged = file._replace(bytes=len(data), sha256=hashlib.sha256(data).hexdigest())
        with pytest.raises(DamagedError, match="put together"):
            load_value(folder, {forged.name: forged})


def test_a_durable_value_is_synced_file_by_file(tmp_path, monkeypatch):
    synced = []
    monkeypatch.setattr(os, "fsync", lambda descriptor: synced.append(os.fstat(descriptor).st_ino))
    mesh = SurfaceMesh(np.eye(3), np.array([[0, 1, 2]]))
    for durable in (False, True):
        folder = tmp_path / str(durable)
        folder.mkdir()
        save_value(mesh, folder, durable=durable)
        files = sorted(file.stat().st_ino for file in folder.iterdir())
        assert files
        assert sorted(synced) == (files if durable else [])
