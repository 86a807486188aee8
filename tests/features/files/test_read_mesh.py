"""Meshes from files: read, moved, tested for a volume."""

import contextlib

import numpy as np
import pytest

from sppm_pipeline.errors import ConfigError, InputError
from sppm_pipeline.features.files.formats import obj
from sppm_pipeline.features.files.stages.read_mesh import ReadMesh
from sppm_pipeline.features.files.stages.write_mesh import WriteMesh
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.part import primitive_meshes
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.nouns.palette import Palette
from sppm_pipeline.services.formats import ply, stl
from sppm_pipeline.testing.plain_context import PlainContext


@pytest.fixture
def save(tmp_path):
    def save(vertices, faces, name="part.ply"):
        encode = {"ply": ply.encode, "obj": obj.encode, "stl": stl.encode}[name.rsplit(".", 1)[1]]
        path = tmp_path / name
        path.write_bytes(b"".join(encode(np.asarray(vertices, float), np.asarray(faces, np.int32))))
        return path

    return save


@pytest.fixture
def tetra(save, wedge):
    return save(wedge.vertices, wedge.faces)


def read(path, **options):
    stage = ReadMesh(path=path, **options)
    stage.check_options()
    context = PlainContext()
    made = stage.run(context)
    made.check()
    return made, context


def test_as_it_is(tetra, wedge):
    made, context = read(tetra)
    assert np.allclose(made.vertices, wedge.vertices)
    assert np.array_equal(made.faces, wedge.faces)
    assert context.reported == {"unit": "mm", "mm_per_unit": 1.0, "up": "z", "closed": True, "boundary_edges": 0}
    assert not context.warnings
    assert made.name == "part.ply"


def test_units_scale_and_height(tetra, wedge):
    assert np.allclose(read(tetra, unit="in")[0].vertices, wedge.vertices * 25.4)
    assert np.allclose(read(tetra, unit="um", scale=3.0)[0].vertices, wedge.vertices * 0.003)
    tall = read(tetra, unit="m", height=Length(6, "cm"))[0]
    assert np.allclose(tall.vertices, wedge.vertices * (60 / (7.2 - 0.1)))
    with pytest.raises(ConfigError, match="exclude"):
        read(tetra, scale=2.0, height=Length(3))


def test_places(tetra):
    corner = read(tetra, place="corner", scale=2.0)[0]
    assert np.allclose(corner.lower, 0)
    center = read(tetra, place="center", height=Length(5))[0]
    assert center.lower[2] == pytest.approx(0)
    assert center.upper[2] == pytest.approx(5)
    assert np.allclose((center.lower + center.upper)[:2], 0)


def test_turns_are_right_handed_about_x_then_y_then_z(tetra, wedge):
    x, y, z = wedge.vertices.T
    assert np.array_equal(read(tetra, turn=(90.0, 0.0, 0.0))[0].vertices, np.stack([x, -z, y], 1))
    assert np.array_equal(read(tetra, turn=(0.0, 90.0, 0.0))[0].vertices, np.stack([z, y, -x], 1))
    assert np.array_equal(read(tetra, turn=(0.0, 0.0, -270.0))[0].vertices, np.stack([-y, x, z], 1))
    assert np.array_equal(read(tetra, turn=(90.0, 0.0, 90.0))[0].vertices, np.stack([z, x, y], 1))
    some = read(tetra, turn=(12.0, 34.0, 56.0))[0]
    assert some.summary()["volume_mm3"] == pytest.approx(wedge.summary()["volume_mm3"])
    assert np.allclose(some.vertices @ some.vertices.T, wedge.vertices @ wedge.vertices.T)


def test_turned_before_it_is_scaled_to_a_height(tetra):
    made = read(tetra, turn=(90.0, 0.0, 0.0), height=Length(10), place="corner")[0]
    assert made.upper[2] == pytest.approx(10)


def test_inside_out_is_turned(save, wedge):
    made, context = read(save(wedge.vertices, wedge.faces[:, ::-1]))
    assert made.summary()["volume_mm3"] > 0
    assert "inside out" in context.warnings[0]


def test_shells_that_are_inside_out_are_turned_one_by_one(save):
    """Their volumes would cancel those of the others."""
    (v, f), (w, g) = (primitive_meshes.box_mesh((x, 0.0, 0.0), (4.0, 4.0, 4.0)) for x in (0.0, 9.0))
    made, context = read(save(np.concatenate([v, w]), np.concatenate([f, g[:, ::-1] + len(v)])), unit="mm")
    assert made.summary()["volume_mm3"] == pytest.approx(128)
    assert "12 triangles" in context.warnings[0]


def test_shells_that_overlap_count_once(save):
    (v, f), (w, g) = (primitive_meshes.box_mesh((x, 0.0, 0.0), (4.0, 4.0, 4.0)) for x in (0.0, 3.0))
    made, context = read(save(np.concatenate([v, w]), np.concatenate([f, g + len(v)])), unit="mm")
    assert made.summary()["volume_mm3"] == pytest.approx(112)
    assert context.reported["overlap_mm3"] == pytest.approx(16)
    assert not context.warnings


BALL = primitive_meshes.ball_mesh((0.0, 0.0, 0.0), 4.0, 3)


@pytest.mark.parametrize("turned", [False, True])
def test_what_is_not_closed_is_refused_or_passed_on(save, turned):
    vertices, faces = BALL
    path = save(vertices, faces[9:, ::-1] if turned else faces[9:])
    with pytest.raises(InputError, match="open edges") as caught:
        read(path)
    assert "check.mesh" in caught.value.hint
    made, context = read(path, accept="any")
    assert context.reported["boundary_edges"] > 0
    assert made.summary()["volume_mm3"] is None  # the sum over its triangles depends on where the mesh is
    assert any("does not bound a volume" in warning for warning in context.warnings)


def test_a_hopeless_mesh_is_handed_on_to_a_stage_that_repairs(save):
    rng = np.random.default_rng(0)
    made, context = read(save(rng.random((120, 3)), np.arange(120).reshape(40, 3)), accept="any")
    assert len(made.faces) == 40
    assert "120 open edges" in context.warnings[-1]


def test_flat_and_missing_and_broken(save, tmp_path, tetra):
    with pytest.raises(InputError, match="flat"):
        read(save([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 1]]))
    with pytest.raises(InputError, match="cannot read"):
        read(tmp_path / "nothing.stl")
    with pytest.raises(InputError):
        read(tmp_path)
    data = tetra.read_bytes()
    for content in (b"", data[:-5], b"not a mesh", data[:40]):
        (tmp_path / "broken.ply").write_bytes(content)
        with pytest.raises(InputError):
            read(tmp_path / "broken.ply")
    (tmp_path / "empty.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n")
    with pytest.raises(InputError):
        read(tmp_path / "empty.obj")


@pytest.mark.parametrize(
    ("name", "words"), [("part.step", "CAD"), ("part", "no mesh format"), ("part.stl", "finite"), (".", "folder")]
)
def test_what_is_no_mesh_is_refused_and_its_size_merely_unknown(save, tmp_path, wedge, name, words):
    if name == "part.stl":
        data = bytearray(save(wedge.vertices, wedge.faces, name).read_bytes())
        data[84 + 12 : 84 + 16] = np.float32(np.nan).tobytes()
        (tmp_path / name).write_bytes(data)
    elif name != ".":
        (tmp_path / name).write_text("ISO-10303-21;")
    stage = ReadMesh(path=tmp_path / name)
    with contextlib.suppress(InputError, LookupError):  # the engine takes these for a size that is unknown
        assert stage.estimate(Palette()).geometry is None
    with pytest.raises(InputError, match=words):
        stage.run(PlainContext())


@pytest.mark.parametrize("name", ["a.stl", "b/c.ply", "d.obj"])
def test_what_is_written_is_read_again(name, ball, tmp_path):
    context = PlainContext(directory=tmp_path)
    WriteMesh(path=name).run(context, ball)
    assert context.reported["bytes"] == (tmp_path / name).stat().st_size
    made, _ = read(tmp_path / name)
    assert len(made.faces) == len(ball.faces)
    assert np.allclose(made.vertices[made.faces], ball.vertices[ball.faces], atol=2e-6)
    first = (tmp_path / name).read_bytes()
    WriteMesh(path=name).run(context, ball)
    assert (tmp_path / name).read_bytes() == first


def test_a_part_too_small_for_millimeters_is_suspected_to_be_in_inches(tmp_path):
    v, f = primitive_meshes.ball_mesh((0.0, 0.0, 0.0), 2.5, 2)
    for name in ("a.stl", "a.3mf"):
        WriteMesh(path=name).run(PlainContext(directory=tmp_path), SurfaceMesh(v, f))
    told = read(tmp_path / "a.stl")[1].warnings
    assert len(told) == 1
    assert "5 x 5 x 5 mm" in told[0]
    assert "`unit: in` would make it 127 x 127 x 127 mm" in told[0]
    for options in ({"unit": "mm"}, {"unit": "in"}, {"scale": 1.5}, {"height": Length(5, "mm")}):
        assert not read(tmp_path / "a.stl", **options)[1].warnings
    assert not read(tmp_path / "a.3mf")[1].warnings  # it states its unit
