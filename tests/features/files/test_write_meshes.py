"""Meshes written by stages: sound for those who read them, the same bytes each time, one cell for many."""

import io
import json
import shutil
import subprocess
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import manifold3d
import numpy as np
import pytest
import trimesh

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.files.formats.detect import decode_mesh_file
from sppm_pipeline.features.files.stages.read_mesh import ReadMesh
from sppm_pipeline.features.files.stages.write_mesh import ENCODERS, WriteMesh
from sppm_pipeline.features.surface.stages.extract_unit_cell import UnitCell
from sppm_pipeline.method.nouns.mesh import RepeatedMesh, SurfaceMesh
from sppm_pipeline.method.stages.tile_periodic import PeriodicTiling
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.mesh.measures import volume
from sppm_pipeline.testing.plain_context import PlainContext

FORMATS = [extension[1:] for extension in ENCODERS]
CORE = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"


def write(stage, mesh, folder, threads=1):
    stage.check_options()
    context = PlainContext(directory=folder, threads=threads)
    stage.run(context, mesh)
    return (folder / stage.path).read_bytes(), context


def read(path: Path, **options):
    context = PlainContext()
    return ReadMesh(path=path, **options).run(context), context


@pytest.mark.parametrize("name", FORMATS)
def test_what_is_written_is_read_again(name, wedge, tmp_path):
    data, context = write(WriteMesh(path=f"a.{name}"), wedge, tmp_path)
    assert context.reported["bytes"] == len(data)
    assert context.reported["triangles"] == 4
    assert write(WriteMesh(path=f"b.{name}"), wedge, tmp_path, threads=3)[0] == data
    made, reading = read(tmp_path / f"a.{name}")
    assert np.allclose(made.vertices[made.faces], wedge.vertices[wedge.faces], atol=1e-6)
    stated = {"3mf": ("millimeter", 1.0, "z"), "glb": ("meter", 1000.0, "y")}.get(name, ("mm", 1.0, "z"))
    assert tuple(reading.reported[key] for key in ("unit", "mm_per_unit", "up")) == stated
    assert not reading.warnings


@pytest.mark.parametrize("name", FORMATS)
def test_nothing_is_not_written(name, tmp_path):
    empty = SurfaceMesh(np.zeros((3, 3)), np.zeros((0, 3), np.int32))
    with pytest.raises(DesignError, match="nothing to write"):
        write(WriteMesh(path=f"mesh.{name}"), empty, tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_3mf_holds_what_the_core_specification_asks_for(ball, tmp_path):
    stage = WriteMesh(path="mesh.3mf", title='ball & "chain"', description="<porosity> 0.7")
    data, _ = write(stage, ball, tmp_path)
    with zipfile.ZipFile(io.BytesIO(data)) as file:
        assert file.testzip() is None
        assert file.namelist() == ["[Content_Types].xml", "_rels/.rels", "3D/3dmodel.model"]
        assert {info.date_time for info in file.infolist()} == {(1980, 1, 1, 0, 0, 0)}
        types = {
            entry.get("Extension"): entry.get("ContentType")
            for entry in ElementTree.fromstring(file.read("[Content_Types].xml"))
        }
        assert types == {
            "rels": "application/vnd.openxmlformats-package.relationships+xml",
            "model": "application/vnd.ms-package.3dmanufacturing-3dmodel+xml",
        }
        (relation,) = ElementTree.fromstring(file.read("_rels/.rels"))
        assert relation.get("Target") == "/3D/3dmodel.model"
        assert relation.get("Type") == "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
        model = ElementTree.fromstring(file.read("3D/3dmodel.model"))
    assert model.tag == f"{CORE}model"
    assert model.get("unit") == "millimeter"
    assert [child.tag for child in model] == [f"{CORE}{tag}" for tag in ("metadata",) * 3 + ("resources", "build")]
    about = {entry.get("name"): entry.text for entry in model.findall(f"{CORE}metadata")}
    assert about["Title"] == 'ball & "chain"'
    assert about["Description"] == "<porosity> 0.7"
    assert about["Application"].startswith("sppm_pipeline ")
    vertices = [[float(v.get(axis)) for axis in "xyz"] for v in model.iter(f"{CORE}vertex")]
    faces = [[int(t.get(key)) for key in ("v1", "v2", "v3")] for t in model.iter(f"{CORE}triangle")]
    assert np.allclose(vertices, ball.vertices, atol=6e-9)
    assert faces == ball.faces.tolist()
    assert [item.get("objectid") for item in model.iter(f"{CORE}item")] == ["1"]
    solid = manifold3d.Manifold(manifold3d.Mesh64(np.array(vertices), np.array(faces, np.uint64)))
    assert solid.status() == manifold3d.Error.NoError
    assert solid.volume() == pytest.approx(ball.summary()["volume_mm3"])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"path": "part"}, r"must end in \.stl, \.ply, \.obj, \.off, \.3mf, \.glb"),
        ({"path": "part.step"}, "must end in"),
        ({"path": "part.ply", "normals": True}, r"`normals` is an option of \.glb files; a \.ply file"),
        ({"path": "part.GLB", "title": "a"}, r"`title` is an option of \.3mf files; a \.glb file"),
        ({"path": "part.stl", "description": "a"}, r"`description` is an option of \.3mf files"),
    ],
)
def test_options_of_other_formats_are_refused(options, message):
    with pytest.raises(ConfigError, match=message):
        WriteMesh(**options).check_options()


def test_the_extension_may_be_in_capitals(wedge, tmp_path):
    data, _ = write(WriteMesh(path="A.PLY"), wedge, tmp_path)
    assert data == write(WriteMesh(path="a.ply"), wedge, tmp_path)[0]


@pytest.mark.parametrize("name", FORMATS)
def test_former_stages_write_their_format_under_their_former_id(name, run_yaml, summary):
    record, folder = run_yaml(f"""
pipeline:
  - {{stage: read.primitive, shape: box, size: [1 mm, 2 mm, 3 mm]}}
  - {{stage: write.{name}}}
  - {{stage: write.mesh, path: new.{name}}}
""")
    assert (folder / f"mesh.{name}").read_bytes() == (folder / f"new.{name}").read_bytes()
    assert summary(record, f"write.{name}")["triangles"] == 12


def test_titles_are_text(ball, tmp_path):
    with pytest.raises(ConfigError, match="printed"):
        WriteMesh(path="mesh.3mf", title="a\0b").check_options()
    odd = SurfaceMesh(ball.vertices, ball.faces, name='a\0<b> "c"')
    with zipfile.ZipFile(io.BytesIO(write(WriteMesh(path="mesh.3mf"), odd, tmp_path)[0])) as file:
        (entry, *_) = ElementTree.fromstring(file.read("3D/3dmodel.model"))
    assert entry.text == 'a?<b> "c"'


def test_a_glb_is_in_metres_with_y_up_and_unit_normals(ball, tmp_path):
    data, _ = write(WriteMesh(path="mesh.glb", normals=True), ball, tmp_path)
    document = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
    position = document["accessors"][1]
    assert np.allclose(position["min"], [0, 0, -0.01])
    assert np.allclose(position["max"], [0.01, 0.01, 0])
    read = trimesh.load(io.BytesIO(data), file_type="glb", process=False).to_mesh()
    assert read.volume * 1e9 == pytest.approx(ball.summary()["volume_mm3"], rel=1e-5)
    outward = np.asarray(read.vertices) - [0.005, 0.005, -0.005]
    outward /= np.linalg.norm(outward, axis=1)[:, None]
    assert np.allclose(np.linalg.norm(read.vertex_normals, axis=1), 1, atol=1e-6)
    assert (np.sum(read.vertex_normals * outward, axis=1) > 0.99).all()


def test_normals_of_vertices_without_area_are_unit(tmp_path):
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [9, 9, 9]], float)
    folded = SurfaceMesh(vertices, np.array([[0, 1, 2], [0, 2, 1]]))
    data, _ = write(WriteMesh(path="mesh.glb", normals=True), folded, tmp_path)
    normals = np.frombuffer(data[-60:], "<f4").reshape(5, 3)
    assert np.allclose(normals, [0, 1, 0])


@pytest.fixture(scope="module")
def lattice(cell):
    """2 x 3 x 1 copies of a cell of 4 mm."""
    return PeriodicTiling(cells=(2, 3, 1), cell=Length(4, "mm")).run(PlainContext(), cell, None)


@pytest.fixture(scope="module")
def repeated(lattice) -> RepeatedMesh:
    made = UnitCell(resolution=12).run(PlainContext(), lattice)
    made.check()
    return made


PLACED = {"3mf": {"copies": "components"}, "glb": {}}


@pytest.mark.parametrize("name", PLACED)
def test_a_cell_is_written_once(name, repeated, tmp_path):
    options = PLACED[name]
    once, _ = write(WriteMesh(path=f"once.{name}", **options), repeated.mesh, tmp_path)
    data, context = write(WriteMesh(path=f"many.{name}", **options), repeated, tmp_path)
    assert len(data) < len(once) + 1500
    assert context.reported["copies"] == 6
    assert context.reported["triangles"] == 6 * len(repeated.mesh.faces)
    read_again, _ = read(tmp_path / f"many.{name}")
    whole = repeated.whole()
    assert np.allclose(read_again.vertices[read_again.faces], whole.vertices[whole.faces], atol=2e-6)
    assert write(WriteMesh(path=f"again.{name}", **options), repeated, tmp_path, threads=2)[0] == data
    if name == "glb":
        scene = trimesh.load(io.BytesIO(data), file_type="glb", process=False)
        assert len(scene.graph.nodes_geometry) == 6
        assert scene.to_mesh().volume * 1e9 == pytest.approx(volume(whole.vertices, whole.faces), rel=1e-4)


@pytest.mark.parametrize("name", ["3mf", "stl", "ply", "obj", "off"])
def test_copies_become_one_object_where_a_program_could_lay_them_side_by_side(name, repeated, tmp_path):
    data, context = write(WriteMesh(path=f"many.{name}"), repeated, tmp_path)
    assert context.reported["copies"] == 6
    assert context.reported["triangles"] == 6 * len(repeated.mesh.faces)
    read_again, _ = read(tmp_path / f"many.{name}")
    whole = repeated.whole()
    assert np.allclose(read_again.vertices[read_again.faces], whole.vertices[whole.faces], atol=2e-6)
    if name == "3mf":
        with zipfile.ZipFile(io.BytesIO(data)) as file:
            model = ElementTree.fromstring(file.read("3D/3dmodel.model"))
        assert len(model.findall(f"{CORE}resources/{CORE}object")) == len(list(model.iter(f"{CORE}mesh"))) == 1
        assert not list(model.iter(f"{CORE}component"))


def test_merged_copies_are_one_object_to_a_slicing_program(repeated, tmp_path):
    slicer = shutil.which("prusa-slicer")
    if slicer is None:
        pytest.skip("PrusaSlicer is not installed")

    def objects(path: Path) -> list[list[float]]:
        told = subprocess.run([slicer, "--info", str(path)], capture_output=True, text=True, check=True).stdout
        sizes = [float(line.split("=")[1]) for line in told.splitlines() if line.startswith("size_")]
        return [sizes[start : start + 3] for start in range(0, len(sizes), 3)]

    write(WriteMesh(path="merged.3mf"), repeated, tmp_path)
    write(WriteMesh(path="placed.3mf", copies="components"), repeated, tmp_path)
    assert objects(tmp_path / "merged.3mf") == [pytest.approx([8.0, 12.0, 4.0], abs=1e-3)]
    assert len(objects(tmp_path / "placed.3mf")) == 6


def test_more_vertices_than_a_mesh_counts_are_refused(repeated):
    many = np.zeros((2**31 // len(repeated.mesh.vertices) + 1, 3))
    with pytest.raises(DesignError, match=r"copies of .* vertices; one mesh counts 2147483647"):
        RepeatedMesh(repeated.mesh, many).whole()


def test_components_are_of_the_core_specification(repeated, tmp_path):
    data, _ = write(WriteMesh(path="mesh.3mf", copies="components"), repeated, tmp_path)
    with zipfile.ZipFile(io.BytesIO(data)) as file:
        model = ElementTree.fromstring(file.read("3D/3dmodel.model"))
    mesh, assembly = model.findall(f"{CORE}resources/{CORE}object")
    assert len(list(model.iter(f"{CORE}mesh"))) == 1
    components = assembly.findall(f"{CORE}components/{CORE}component")
    assert {entry.get("objectid") for entry in components} == {mesh.get("id")}
    matrices = np.array([[float(word) for word in entry.get("transform").split()] for entry in components])
    assert np.array_equal(matrices[:, :9], np.tile(np.eye(3).reshape(-1), (6, 1)))
    assert np.array_equal(matrices[:, 9:], repeated.offsets)
    assert [item.get("objectid") for item in model.iter(f"{CORE}item")] == [assembly.get("id")]


def test_no_copies_are_not_written(repeated, tmp_path):
    with pytest.raises(DesignError, match="no copies"):
        write(WriteMesh(path="mesh.3mf"), RepeatedMesh(repeated.mesh, np.zeros((0, 3))), tmp_path)


def test_a_pipeline_writes_copies(run_yaml, summary):
    record, folder = run_yaml("""
recipes:
  cell:
    - {stage: sample.mirrored_faces, count: 9, spacing: 0.2}
    - {stage: sample.dart_throwing, count: 12, spacing: 0.2}
    - {stage: connect.mst}
    - {stage: field.gaussian, pore_radius: 0.14, tunnel_radius: 0.05}
pipeline:
  - {stage: tune.porosity, recipe: cell, target: 0.5, resolution: 16}
  - {stage: tile.periodic, cells: [3, 3, 2], cell: 4 mm}
  - {stage: extract.unit_cell, resolution: 12}
  - {stage: write.mesh, id: for_slicers, path: lattice.3mf}
  - {stage: write.mesh, id: for_viewers, path: lattice.glb}
""")
    assert record["status"] == "done"
    assert summary(record, "extract.unit_cell")["copies"] == 18
    assert summary(record, "for_slicers")["copies"] == 18
    assert summary(record, "for_slicers")["triangles"] == summary(record, "for_viewers")["triangles"]
    for name in ("3mf", "glb"):
        file = decode_mesh_file((folder / f"lattice.{name}").read_bytes(), f"a.{name}")
        assert len(file.faces) == summary(record, "for_slicers")["triangles"]


def test_units_of_files_are_honoured(wedge, tmp_path):
    data, _ = write(WriteMesh(path="a.3mf"), wedge, tmp_path)
    with zipfile.ZipFile(io.BytesIO(data)) as file:
        parts = {name: file.read(name) for name in file.namelist()}
    for unit, mm in {"micron": 1e-3, "centimeter": 10, "inch": 25.4, "foot": 304.8, "meter": 1000}.items():
        with zipfile.ZipFile(tmp_path / "b.3mf", "w") as file:
            for name, content in parts.items():
                file.writestr(name, content.replace(b'unit="millimeter"', f'unit="{unit}"'.encode()))
        made, context = read(tmp_path / "b.3mf")
        assert np.allclose(made.vertices, wedge.vertices * mm)
        assert context.reported["unit"] == unit
        assert context.reported["mm_per_unit"] == mm
    made, context = read(tmp_path / "b.3mf", unit="mm")
    assert np.allclose(made.vertices, wedge.vertices)
    assert "states its unit as meter" in context.warnings[0]


def test_the_upward_axis_can_be_told(wedge, tmp_path):
    write(WriteMesh(path="a.glb"), wedge, tmp_path)
    write(WriteMesh(path="a.ply"), wedge, tmp_path)
    x, y, z = wedge.vertices.T
    made, context = read(tmp_path / "a.glb", up="z")
    assert np.allclose(made.vertices, np.stack([x, z, -y], 1), atol=1e-5)
    assert context.reported["up"] == "z"
    assert np.array_equal(read(tmp_path / "a.ply", up="y")[0].vertices, np.stack([x, -z, y], 1))
    assert np.array_equal(read(tmp_path / "a.ply", up="x")[0].vertices, np.stack([y, z, x], 1))


def test_meshes_as_viewers_like_them_are_closed_again(tmp_path):
    """Vertices are split where normals differ; several nodes and materials make one part."""
    scene = trimesh.Scene()
    for shift in (0.0, 3.0):
        box = trimesh.creation.box((1, 1, 2))
        box.unmerge_vertices()
        scene.add_geometry(box, transform=trimesh.transformations.translation_matrix([shift, 0, 0]))
    mirror = np.diag([-1.0, 1, 1, 1])
    mirror[0, 3] = 6.0
    scene.add_geometry(trimesh.creation.cone(0.5, 1.0), transform=mirror)
    (tmp_path / "a.glb").write_bytes(scene.export(file_type="glb"))
    made, context = read(tmp_path / "a.glb", unit="mm", up="z")
    assert context.reported["closed"]
    assert made.summary()["volume_mm3"] == pytest.approx(4 + trimesh.creation.cone(0.5, 1.0).volume, rel=1e-5)
    assert decode_mesh_file((tmp_path / "a.glb").read_bytes(), "a.glb").unit == "meter"


def said_by(*command: str | Path) -> list[str]:
    done = subprocess.run([str(word) for word in command], capture_output=True, timeout=600, check=True)
    return done.stdout.decode(errors="replace").splitlines()  # admesh prints bytes beyond the head


@pytest.mark.parametrize("name", ["stl", "3mf"])
def test_a_slicing_program_reads_them(name, ball, repeated, tmp_path):
    program = shutil.which("prusa-slicer")
    if program is None:
        pytest.skip("prusa-slicer is not installed")
    write(WriteMesh(path=f"a.{name}"), ball, tmp_path)
    lines = dict(line.split(" = ", 1) for line in said_by(program, "--info", tmp_path / f"a.{name}") if " = " in line)
    assert float(lines["size_z"]) == pytest.approx(10, abs=1e-4)
    assert lines["manifold"].strip() == "yes"
    assert int(lines["number_of_facets"]) == len(ball.faces)
    assert float(lines["volume"]) == pytest.approx(ball.summary()["volume_mm3"], rel=1e-4)


def test_a_checker_of_stl_finds_nothing_to_repair(ball, tmp_path):
    program = shutil.which("admesh")
    if program is None:
        pytest.skip("admesh is not installed")
    write(WriteMesh(path="a.stl"), ball, tmp_path)
    # "Total disconnected facets : 0 0", before and after
    counts = dict(line.split(":", 1) for line in said_by(program, tmp_path / "a.stl") if line.count(":") == 1)
    words = {key.strip(): set(value.split()) for key, value in counts.items()}
    assert words["Total disconnected facets"] == {"0"}
    for found in ("Degenerate facets", "Facets reversed", "Backwards edges", "Normals fixed", "Edges fixed"):
        assert words[found] == {"0"}, found
