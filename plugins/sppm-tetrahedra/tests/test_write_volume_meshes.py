"""Volume meshes are written, and read back by ``read.volume_mesh``."""

import dataclasses
import re
import shutil
import subprocess
import sys
from pathlib import Path

import meshio
import numpy as np
import pytest
from sppm_tetrahedra.stages.homogenize_tet import HomogenizeTet
from sppm_tetrahedra.stages.mesh_isosurface_stuffing import IsosurfaceStuffing
from sppm_tetrahedra.stages.read_volume_mesh import ReadVolumeMesh
from sppm_tetrahedra.stages.write_volume_mesh import WriteVolumeMesh

from sppm_pipeline.errors import ConfigError, DesignError, InputError, ResourceError
from sppm_pipeline.testing.plain_context import PlainContext

FILES = ("a.vtu", "a.vtk", "a.inp", "a.msh")


@pytest.fixture(scope="module", params=[1, 2])
def mesh(request, cell):
    made = IsosurfaceStuffing(resolution=8, order=request.param).run(PlainContext(), cell)
    materials = 1 + (np.arange(len(made.cells)) >= len(made.cells) // 2)
    return dataclasses.replace(made, materials=materials.astype(np.uint8))


def written(stage, mesh):
    context = PlainContext()
    stage.run(context, mesh)
    path = context.directory / stage.path
    assert context.reported["bytes"] == path.stat().st_size
    return path, context


@pytest.mark.parametrize("name", FILES)
def test_what_is_written_can_be_read(mesh, name):
    path, _keep = written(WriteVolumeMesh(path=name), mesh)
    context = PlainContext()
    read = ReadVolumeMesh(path=path, periodic=True).run(context)
    assert np.array_equal(read.nodes, mesh.nodes)
    assert np.array_equal(read.cells, mesh.cells)
    assert np.array_equal(read.materials, mesh.materials)
    assert read.matched
    assert np.array_equal(read.box, mesh.box)
    assert not context.warnings


def test_units(mesh):
    path, _keep = written(WriteVolumeMesh(compress=True), mesh)
    assert np.allclose(ReadVolumeMesh(path=path, unit="m").run(PlainContext()).nodes, 1000 * mesh.nodes)


def test_constraints_need_matching_faces(mesh):
    path, _keep = written(WriteVolumeMesh(path="mesh.inp", tie_faces=True), mesh)
    assert "*EQUATION" in path.read_text()
    with pytest.raises(DesignError, match="do not match"):
        written(WriteVolumeMesh(path="mesh.inp", tie_faces=True), dataclasses.replace(mesh, matched=False))


def test_reference_nodes_stand_in_the_one_block_of_nodes(mesh):
    path, _keep = written(WriteVolumeMesh(path="mesh.inp", tie_faces=True), mesh)
    assert path.read_text().count("*NODE,") == 1
    read = meshio.read(path)
    assert len(read.points) == len(mesh.nodes) + 3
    assert [read.point_sets[f"REF{axis}"].tolist() for axis in "XYZ"] == [[len(mesh.nodes) + i] for i in range(3)]


RECIPE = Path(__file__).parents[3] / "docs" / "howto" / "mesh-for-finite-elements.md"


def test_calculix_finds_the_stiffness_of_the_homogenizer(mesh):
    solver = shutil.which("ccx")
    if solver is None:
        pytest.skip("CalculiX is not installed")
    young, poisson = (2000.0, 800.0), (0.35, 0.2)
    path, _keep = written(
        WriteVolumeMesh(path="mesh.inp", tie_faces=True, job=True, young=young, poisson=poisson), mesh
    )
    subprocess.run([solver, "mesh"], cwd=path.parent, check=True, capture_output=True, timeout=600)
    dat = path.with_suffix(".dat").read_text()
    code = re.search(r"```python\n(.*?)```", RECIPE.read_text(), re.DOTALL)
    names: dict = {}
    exec(code[1], names)
    edges = mesh.box[1] - mesh.box[0]
    found = names["stiffness"](dat, edges)
    expected = HomogenizeTet(young=young, poisson=poisson, residual=1e-10).run(PlainContext(), mesh).stiffness
    assert np.allclose(found, expected, rtol=0, atol=3e-5 * expected.max())
    energies = [float(word) for word in re.findall(r"total internal energy for set SOLID .*\n\n\s*(\S+)", dat)]
    assert np.allclose(energies, np.diag(np.linalg.inv(expected)) / 2 * np.prod(edges), rtol=1e-4)


def test_options_of_a_job():
    with pytest.raises(ConfigError, match="a job needs tied faces"):
        WriteVolumeMesh(path="a.inp", job=True).check_options()
    with pytest.raises(ConfigError, match="materials of a job"):
        WriteVolumeMesh(path="a.inp", tie_faces=True, young=3.0).check_options()
    with pytest.raises(ConfigError, match=r"`job` is an option of \.inp files"):
        WriteVolumeMesh(path="a.msh", job=True).check_options()


def test_a_job_needs_constants_of_each_material(mesh):
    with pytest.raises(ConfigError, match="the mesh has 2 materials, `young` gives values for 1"):
        written(WriteVolumeMesh(path="mesh.inp", tie_faces=True, job=True, young=(1.0,)), mesh)


def test_options():
    with pytest.raises(ConfigError, match="must end"):
        WriteVolumeMesh(path="a.stl").check_options()
    with pytest.raises(ConfigError, match=r"`compress` is an option of \.vtu files; a \.vtk file"):
        WriteVolumeMesh(path="a.vtk", compress=True).check_options()
    with pytest.raises(ConfigError, match=r"`tie_faces` is an option of \.inp files"):
        WriteVolumeMesh(path="a.MSH", tie_faces=True).check_options()
    with pytest.raises(ConfigError, match="known are"):
        ReadVolumeMesh(path=Path("a.step")).check_options()


CORNER = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])


def test_cells_inside_out_are_turned(mesh, tmp_path):
    kind = "tetra" if mesh.cells.shape[1] == 4 else "tetra10"
    mirrored = mesh.nodes * [1, 1, -1]
    meshio.Mesh(mirrored, [(kind, mesh.cells)]).write(tmp_path / "a.vtu")
    context = PlainContext()
    read = ReadVolumeMesh(path=tmp_path / "a.vtu").run(context)
    assert read.volume == pytest.approx(mesh.volume)
    assert "inside out" in context.warnings[0]
    if kind == "tetra10":
        from sppm_tetrahedra.numerics.quality import minimum_jacobian

        assert (minimum_jacobian(read.nodes, read.cells) > 0).all()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ([("hexahedron", [[0, 1, 2, 3, 4, 5, 6, 7]])], "hexahedron"),
        ([("triangle", [[0, 1, 2]])], "no tetrahedra"),
        ([("tetra", [[0, 1, 2, 3]]), ("tetra10", [list(range(10))])], "both"),
        ([("tetra", [[0, 1, 2, 2]])], "no volume"),
    ],
)
def test_what_is_no_mesh_of_tetrahedra(tmp_path, content, words):
    points = np.random.default_rng(0).random((10, 3))
    meshio.Mesh(points, content).write(tmp_path / "a.vtu")
    with pytest.raises(InputError, match=words):
        ReadVolumeMesh(path=tmp_path / "a.vtu").run(PlainContext())


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("content", [b"", b"nonsense", b"<VTKFile>", b"$MeshFormat\n9 0 8\n", b"\xff\x00" * 50, None])
def test_broken_files_are_refused(tmp_path, capsys, name, content):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError):
        ReadVolumeMesh(path=tmp_path / name).run(PlainContext())
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize("name", FILES)
def test_cut_files_are_refused(mesh, name, tmp_path):
    path, _keep = written(WriteVolumeMesh(path=name), mesh)
    data = path.read_bytes()
    for share in (0.1, 0.4, 0.7):
        (tmp_path / name).write_bytes(data[: int(share * len(data))])
        try:
            read = ReadVolumeMesh(path=tmp_path / name).run(PlainContext())
        except InputError:
            continue
        assert name == "a.inp"  # a text of rows without a count; what is cut off is not missed
        assert len(read.cells) < len(mesh.cells)


def test_a_hint_without_the_library(tmp_path, monkeypatch):
    (tmp_path / "a.vtu").write_bytes(b"x")
    monkeypatch.setitem(sys.modules, "meshio.vtu", None)
    with pytest.raises(ResourceError, match="meshio"):
        ReadVolumeMesh(path=tmp_path / "a.vtu").run(PlainContext())


def test_many_materials_become_one(tmp_path):
    points = np.concatenate([CORNER + 3 * i for i in range(300)])
    cells = np.arange(1200).reshape(300, 4)
    meshio.Mesh(points, [("tetra", cells)], cell_data={"material": [np.arange(300)]}).write(tmp_path / "a.vtu")
    context = PlainContext()
    assert set(ReadVolumeMesh(path=tmp_path / "a.vtu").run(context).materials) == {1}
    assert "too many" in context.warnings[0]
