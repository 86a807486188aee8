"""Mesh measures on bodies whose numbers are known, and on broken ones."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sppm_pipeline.errors import InputError
from sppm_pipeline.numerics.domain.mesh_measures import (
    as_mesh,
    bounding_box,
    face_areas,
    mesh_topology,
    signed_volume,
    surface_area,
)
from sppm_pipeline.numerics.domain.primitive_meshes import ball_mesh, box_mesh, torus_mesh

BOX = box_mesh((1.0, 2.0, 3.0), (2.0, 3.0, 4.0))


def test_a_box():
    vertices, faces = BOX
    assert signed_volume(vertices, faces) == pytest.approx(24.0)
    assert signed_volume(vertices, faces[:, ::-1]) == pytest.approx(-24.0)
    assert surface_area(vertices, faces) == pytest.approx(52.0)
    low, high = bounding_box(vertices, faces)
    assert low.tolist() == [0.0, 0.5, 1.0]
    assert high.tolist() == [2.0, 3.5, 5.0]
    assert sorted(face_areas(vertices, faces)) == pytest.approx([3] * 4 + [4] * 4 + [6] * 4)


@settings(derandomize=True, deadline=None)
@given(st.tuples(*[st.floats(-1e4, 1e4)] * 3), st.integers(0, 3))
def test_measures_do_not_depend_on_the_place(shift, subdivisions):
    here, there = ball_mesh((0, 0, 0), 1.0, subdivisions), ball_mesh(shift, 1.0, subdivisions)
    assert signed_volume(*there) == pytest.approx(signed_volume(*here), rel=1e-9)
    assert surface_area(*there) == pytest.approx(surface_area(*here), rel=1e-9)


def test_volume_and_area_of_a_finer_ball_converge_to_second_order():
    errors = []
    for s in (2, 3, 4):
        mesh = ball_mesh((0, 0, 0), 1.0, s)
        errors.append((4 / 3 * np.pi - signed_volume(*mesh), 4 * np.pi - surface_area(*mesh)))
    ratios = np.array(errors[:-1]) / np.array(errors[1:])
    assert (ratios > 3.8).all()
    assert (ratios < 4.2).all()


def test_topology_of_closed_meshes():
    ball, ring = ball_mesh((0, 0, 0), 1.0, 2), torus_mesh((5, 0, 0), 1.0, 0.3, 12, 8)
    both = np.concatenate([ball[1], ring[1] + len(ball[0])])
    report = mesh_topology(len(ball[0]) + len(ring[0]) + 7, both)
    assert report == (0, 0, 0, 0, 2, 2, True, True)
    assert report.genus == 1
    assert mesh_topology(len(ball[0]), ball[1]).genus == 0


def test_a_missing_triangle_opens_three_edges():
    report = mesh_topology(8, BOX[1][1:])
    assert (report.boundary_edges, report.branching_edges, report.watertight, report.consistent) == (3, 0, False, False)
    assert report.genus is None


def test_a_flipped_triangle_is_closed_but_not_consistent():
    faces = BOX[1].copy()
    faces[4] = faces[4, ::-1]
    report = mesh_topology(8, faces)
    assert (report.misoriented_edges, report.watertight, report.consistent) == (3, True, False)


def test_a_fin_branches():
    faces = np.concatenate([BOX[1], [[0, 2, 8]]])
    report = mesh_topology(9, faces)
    assert (report.boundary_edges, report.branching_edges, report.watertight) == (2, 1, False)


def test_a_triangle_that_names_a_vertex_twice_is_degenerate():
    report = mesh_topology(8, np.concatenate([BOX[1], [[1, 1, 2]]]))
    assert report.degenerate_faces == 1
    assert (report.boundary_edges, report.components, report.euler, report.watertight) == (0, 1, 2, False)


def test_nothing_at_all():
    empty = np.zeros((0, 3), np.int32)
    assert mesh_topology(0, empty) == (0, 0, 0, 0, 0, 0, False, False)
    assert signed_volume(np.zeros((0, 3)), empty) == 0.0
    with pytest.raises(InputError, match="no triangles"):
        bounding_box(np.zeros((4, 3)), empty)


def test_unused_vertices_do_not_widen_the_box():
    vertices = np.concatenate([BOX[0], [[100.0, 0, 0]]])
    assert bounding_box(vertices, BOX[1])[1].tolist() == [2.0, 3.5, 5.0]


def test_a_mesh_gets_the_types_of_the_kernels():
    vertices, faces = as_mesh(BOX[0].astype(np.float32), np.asfortranarray(BOX[1].astype(np.uint64)))
    assert (vertices.dtype, faces.dtype, faces.flags.c_contiguous) == (np.float64, np.int32, True)


def test_impossible_meshes_are_refused():
    with pytest.raises(InputError, match="2 of 3 vertices"):
        as_mesh([[0, 0, 0], [0, np.nan, 0], [np.inf, 0, 0]], [[0, 1, 2]])
    for index in (-1, 8):
        with pytest.raises(InputError, match="the mesh has 8"):
            as_mesh(BOX[0], np.array([[0, 1, index]]))
    with pytest.raises(ValueError, match="a mesh is"):
        as_mesh(BOX[0], np.zeros((4, 4), int))
    with pytest.raises(ValueError, match="a mesh is"):
        as_mesh(BOX[0], np.zeros((4, 3)))
