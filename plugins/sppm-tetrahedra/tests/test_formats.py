"""What the encoders of volume meshes write is read back by an independent reader."""

import meshio
import numpy as np
import pytest
from sppm_tetrahedra.formats import inp, msh, vtu
from sppm_tetrahedra.numerics.quality import minimum_jacobian, with_mid_nodes
from sppm_tetrahedra.stages.mesh_isosurface_stuffing import stuff
from sppm_tetrahedra.stages.write_volume_mesh import (
    SIDES,
    boundary_surfaces,
    box_copies,
    box_node_sets,
)
from sppm_tetrahedra.volume_mesh import matched_nodes

N = 6
BOX = np.array([[0.1, 0.1, 0.1], [0.1 + 0.3 * N] * 3])


@pytest.fixture(scope="module", params=[1, 2])
def mesh(request):
    """A periodic cell of two materials; nodes, cells, materials."""
    grid = np.indices((2 * N + 1,) * 3).astype(float) * np.pi / N
    values = (np.cos(grid[0]) + np.cos(grid[1]) + np.cos(grid[2]) - 0.4).astype(np.float32)
    made = stuff(values, True)
    nodes = BOX[0] + made.nodes * ((BOX[1] - BOX[0]) / N)
    materials = 1 + (nodes[made.tets].mean(1)[:, 2] > 1).astype(np.uint8)
    assert 100 < materials.sum() - len(materials) < len(materials)
    return *(with_mid_nodes(nodes, made.tets) if request.param == 2 else (nodes, made.tets)), materials


def tetrahedra(read):
    """Corners and mid-edge nodes of all tetrahedra that meshio found, block after block."""
    blocks = [(k, block.data) for k, block in enumerate(read.cells) if block.type.startswith("tetra")]
    return np.concatenate([data for _, data in blocks]), [k for k, _ in blocks]


def read_back(chunks, path):
    path.write_bytes(b"".join(chunks))
    return meshio.read(path)


@pytest.mark.parametrize("compress", [False, True])
def test_vtu(mesh, tmp_path, compress):
    nodes, cells, materials = mesh
    read = read_back(vtu.encode(nodes, cells, materials, compress), tmp_path / "a.vtu")
    assert np.array_equal(read.points, nodes)
    assert np.array_equal(read.cells[0].data, cells)
    assert read.cells[0].type == ("tetra" if cells.shape[1] == 4 else "tetra10")
    assert np.array_equal(read.cell_data["material"][0], materials)


def test_vtk(mesh, tmp_path):
    nodes, cells, materials = mesh
    read = read_back(vtu.encode_legacy(nodes, cells, materials), tmp_path / "a.vtk")
    assert np.array_equal(read.points, nodes)
    assert np.array_equal(read.cells[0].data, cells)
    assert read.cells[0].type == ("tetra" if cells.shape[1] == 4 else "tetra10")
    assert np.array_equal(np.ravel(read.cell_data["material"][0]), materials)


def test_inp(mesh, tmp_path):
    nodes, cells, materials = mesh
    sets = box_node_sets(nodes, BOX)
    read = read_back(inp.encode(nodes, cells, materials, sets, comments=("mm",)), tmp_path / "a.inp")
    assert np.array_equal(read.points, nodes)
    order = np.argsort(materials, kind="stable")
    found, _ = tetrahedra(read)
    assert np.array_equal(found, cells[order])
    for name in SIDES:
        assert np.array_equal(np.sort(np.ravel(read.point_sets[name])), sets[name])
    text = (tmp_path / "a.inp").read_text()
    assert f"TYPE={'C3D4' if cells.shape[1] == 4 else 'C3D10'}, ELSET=MATERIAL2" in text
    assert max(map(len, text.splitlines())) < 256


def test_msh(mesh, tmp_path):
    nodes, cells, materials = mesh
    surfaces = boundary_surfaces(nodes, cells, BOX)
    copies = box_copies(nodes, matched_nodes(nodes, BOX), BOX)
    read = read_back(msh.encode(nodes, cells, materials, surfaces, copies), tmp_path / "a.msh")
    assert np.array_equal(read.points, nodes)
    found, blocks = tetrahedra(read)
    assert np.array_equal(found, cells[np.argsort(materials, kind="stable")])
    if cells.shape[1] == 10:
        assert (minimum_jacobian(read.points, found) > 0).all()
    tags = np.concatenate([read.cell_data["gmsh:physical"][k] for k in blocks])
    assert np.array_equal(tags, np.sort(materials))
    assert {"XMIN", "ZMAX", "SURFACE", "material1", "material2"} <= set(read.field_data)
    triangles = [b.data for b in read.cells if b.type.startswith("triangle")]
    assert sum(map(len, triangles)) == sum(map(len, surfaces.values()))
    assert len(read.gmsh_periodic) == 3
    for axis, (dimension, _, affine, pairs) in enumerate(read.gmsh_periodic):
        assert dimension == 2
        shift = nodes[pairs[:, 0]] - nodes[pairs[:, 1]]
        expected = np.eye(3)[axis] * (BOX[1] - BOX[0])
        assert np.abs(shift - expected).max() < 1e-12
        assert np.reshape(affine, (4, 4))[:3, 3] == pytest.approx(expected)
        assert len(pairs) > 20


def test_each_surface_of_quadratic_cells_has_its_mid_nodes(mesh):
    nodes, cells, _ = mesh
    total = 0.0
    for name, triangles in boundary_surfaces(nodes, cells, BOX).items():
        a, b, c = (nodes[triangles[:, i]] for i in range(3))
        total += np.einsum("ij,ij->", np.cross(a, b), c) / 6
        if cells.shape[1] == 10:
            assert np.array_equal(nodes[triangles[:, 3:]], np.stack([(a + b) / 2, (b + c) / 2, (c + a) / 2], 1)), name
    corners = nodes[cells[:, :4]]
    assert total == pytest.approx(np.linalg.det(corners[:, 1:] - corners[:, :1]).sum() / 6)


def test_the_sets_of_a_box_take_it_apart(mesh):
    nodes, _, _ = mesh
    sets = box_node_sets(nodes, BOX)
    apart = [name for name in sets if name not in SIDES]
    assert len(apart) == 6 + 12 + 8
    members = np.concatenate([sets[name] for name in apart])
    assert len(np.unique(members)) == len(members)
    assert np.array_equal(np.unique(members), np.unique(np.concatenate([sets[name] for name in SIDES])))


def equations(text):
    """The constraints of a file, as lists of (node, component, factor)."""
    lines = text.split("*EQUATION\n")[1].splitlines()
    found = []
    while lines:
        count = int(lines.pop(0))
        numbers = []
        while len(numbers) < 3 * count:
            numbers += [float(v) for v in lines.pop(0).split(",")]
        found.append(np.reshape(numbers, (count, 3)))
    return found


def test_constraints_are_met_by_every_mean_strain(mesh):
    nodes, cells, materials = mesh
    standing = matched_nodes(nodes, BOX)
    text = b"".join(inp.encode(nodes, cells, materials, {}, standing)).decode()
    found = equations(text)
    assert len(found) == 3 * (standing != np.arange(len(nodes))).sum()
    gradient = np.random.default_rng(0).normal(size=(3, 3))
    moved = nodes @ gradient.T + np.random.default_rng(1).normal(size=nodes.shape)[standing]  # and any periodic part
    moved = np.concatenate([moved, (gradient * (BOX[1] - BOX[0])).T])
    dependent = set()
    for terms in found:
        values = [factor * moved[int(node) - 1, int(i) - 1] for node, i, factor in terms]
        assert sum(values) == pytest.approx(0, abs=1e-12)
        dependent.add((terms[0, 0], terms[0, 1]))
    assert len(dependent) == len(found)
    others = {(node, i) for terms in found for node, i, _ in terms[1:]}
    assert not dependent & others


def test_the_same_bytes_again(mesh):
    sets = box_node_sets(mesh[0], BOX)
    for encode in (vtu.encode, vtu.encode_legacy, lambda *m: inp.encode(*m, sets), lambda *m: msh.encode(*m, {})):
        assert b"".join(encode(*mesh)) == b"".join(encode(*mesh))


@pytest.mark.parametrize(
    "encode", [vtu.encode, vtu.encode_legacy, lambda *m: inp.encode(*m, {}), lambda *m: msh.encode(*m, {})]
)
def test_refused(encode):
    corner = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    one, single = np.array([[0, 1, 2, 3]]), np.ones(1, np.uint8)
    for wrong in (
        (corner * np.nan, one, single),
        (corner, one + 1, single),
        (corner, one[:, :3], single),
        (corner, one, np.ones(2, np.uint8)),
    ):
        with pytest.raises(ValueError):
            list(encode(*wrong))
