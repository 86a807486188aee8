"""Checks of volume meshes: faults are found, sound meshes pass."""

import dataclasses

import numpy as np
import pytest
from sppm_tetrahedra.stages.check_volume_mesh import CheckVolumeMesh
from sppm_tetrahedra.stages.mesh_isosurface_stuffing import IsosurfaceStuffing
from sppm_tetrahedra.volume_mesh import VolumeMesh

from sppm_pipeline.stage import Rejected
from sppm_pipeline.testing.plain_context import PlainContext


@pytest.fixture(scope="module")
def sound(cell):
    return IsosurfaceStuffing(resolution=12, order=2).run(PlainContext(), cell)


def check(mesh, **options):
    context = PlainContext()
    assert CheckVolumeMesh(**options).run(context, mesh) is mesh
    return context


def test_a_sound_mesh_passes(sound):
    reported = check(sound, one_piece=True).reported
    assert reported["inverted"] == 0
    assert reported["folded"] == 0
    assert reported["components"] == 1
    assert reported["boundary_closed"]
    assert reported["non_manifold_faces"] == 0
    assert reported["unused_nodes"] == 0
    assert reported["mismatched_triangles"] == [0, 0, 0]
    assert sum(reported["dihedral_histogram"]) == 6 * len(sound.cells)
    assert reported["dihedral_histogram"][0] == 0
    assert reported["volume_mm3"] == pytest.approx(sound.volume)


def changed(mesh, **parts):
    cells = parts.get("cells", mesh.cells)
    return dataclasses.replace(mesh, **parts, materials=np.ones(len(cells), np.uint8))


def straight(mesh):
    used, cells = np.unique(mesh.cells[:, :4], return_inverse=True)
    return changed(mesh, nodes=mesh.nodes[used], cells=cells.reshape(-1, 4).astype(np.int32))


def inside_out(mesh):
    cells = mesh.cells.copy()
    cells[0, [0, 1]] = cells[0, [1, 0]]
    return changed(mesh, cells=cells)


def doubled(mesh):
    return changed(mesh, cells=np.concatenate([mesh.cells, mesh.cells[:1]]))


def shifted(mesh):
    nodes = mesh.nodes.copy()
    high = np.abs(nodes[:, 0] - mesh.box[1, 0]) < 1e-9
    nodes[high, 1] += 0.01
    return changed(mesh, nodes=nodes)


def folded(mesh):
    nodes = mesh.nodes.copy()
    corners = mesh.cells[0, :2]
    nodes[mesh.cells[0, 4]] = nodes[corners[0]] + 0.9 * (nodes[corners[1]] - nodes[corners[0]])
    return changed(mesh, nodes=nodes)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda m: inside_out(straight(m)), "no positive volume"),
        (lambda m: doubled(straight(m)), "three or more"),
        (lambda m: shifted(straight(m)), "no copies"),
        (folded, "Jacobian"),
    ],
)
def test_faults_are_rejected_or_reported(sound, spoil, words):
    broken = spoil(sound)
    with pytest.raises(Rejected, match=words):
        check(broken)
    assert any(words in warning for warning in check(broken, accept="any").warnings)


def test_the_limit_of_angles(sound):
    least = check(sound).reported["minimum_dihedral_degrees"]
    check(sound, minimum_angle=least - 0.01)
    with pytest.raises(Rejected, match="dihedral"):
        check(sound, minimum_angle=least + 0.01)


def test_pieces_are_counted_on_the_torus():
    corner = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    two = VolumeMesh(np.concatenate([corner, corner + 3]), np.arange(8).reshape(2, 4))
    assert check(two).reported["components"] == 2
    with pytest.raises(Rejected, match="2 components"):
        check(two, one_piece=True)


def test_an_empty_mesh_is_rejected():
    with pytest.raises(Rejected, match="no cells"):
        check(VolumeMesh(np.zeros((0, 3)), np.zeros((0, 4), np.int32)))
