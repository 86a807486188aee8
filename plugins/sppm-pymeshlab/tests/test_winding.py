"""Winding numbers against closed forms and against the obvious sum."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sppm_pymeshlab.outward import turned_outward
from sppm_pymeshlab.winding import spread_points, winding_change, winding_numbers

from sppm_pipeline.services.mesh.measures import volume


def angles_one_by_one(points, vertices, faces):
    """The spherical excess of each triangle as seen from each point, from its three dihedral angles."""
    total = np.zeros(len(points))
    for i, point in enumerate(points):
        for face in faces:
            a, b, c = (vertex / np.linalg.norm(vertex) for vertex in vertices[face] - point)
            normals = [np.cross(a, b), np.cross(b, c), np.cross(c, a)]
            normals = [n / np.linalg.norm(n) for n in normals]
            inner = [np.arccos(np.clip(-np.dot(normals[k], normals[k - 1]), -1, 1)) for k in range(3)]
            total[i] += np.sign(np.dot(a, np.cross(b, c))) * (sum(inner) - np.pi)
    return total / (4 * np.pi)


def test_an_octant_is_an_eighth():
    corner = (np.eye(3), np.array([[0, 1, 2]], np.int32))
    np.testing.assert_allclose(winding_numbers(np.zeros((1, 3)), corner), 1 / 8, rtol=1e-14)


def test_a_closed_mesh_counts_whole_times(boxes):
    mesh = boxes(((0, 0, 0), (4, 4, 4), False), ((0, 0, 0), (2, 2, 2), True), ((9, 0, 0), (2, 2, 2), True))
    points = np.array([[0, 0, 0], [1.5, 0.1, 0.2], [9, 0.1, 0.2], [20, 1, 2]])
    found = winding_numbers(points, (mesh.vertices, mesh.faces))
    np.testing.assert_allclose(found, [0, 1, -1, 0], atol=1e-12)


@settings(deadline=None, derandomize=True, max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_equals_the_sum_over_angles(seed):
    rng = np.random.default_rng(seed)
    vertices, points = rng.random((9, 3)) * 10.0 ** rng.integers(-2, 3), rng.random((5, 3)) * 4
    faces = np.array([[0, 1, 2], [3, 4, 5], [6, 7, 8], [0, 4, 8]], np.int32)
    found = winding_numbers(points, (vertices, faces))
    np.testing.assert_allclose(found, angles_one_by_one(points, vertices, faces), atol=1e-7)


def test_threads_change_nothing(ball):
    points = spread_points(ball.lower, ball.upper, 101)
    mesh = (ball.vertices, ball.faces)
    np.testing.assert_array_equal(winding_numbers(points, mesh), winding_numbers(points, mesh, threads=3))


def test_a_change_is_the_difference(ball):
    points = spread_points(ball.lower, ball.upper, 60)
    before = (ball.vertices, ball.faces)
    moved = ball.vertices.copy()
    moved[7] *= 1.3
    turned = ball.faces.copy()
    turned[:50] = turned[:50, ::-1]
    for after in [(moved, ball.faces), (ball.vertices, np.roll(ball.faces[40:], 1, axis=1)), (ball.vertices, turned)]:
        expected = winding_numbers(points, after) - winding_numbers(points, before)
        np.testing.assert_allclose(winding_change(points, before, after), expected, atol=1e-12)
    shuffled = (ball.vertices[::-1].copy(), (len(ball.vertices) - 1 - np.roll(ball.faces, 2, axis=1))[::-1].copy())
    assert not winding_change(points, before, shuffled).any()


def test_points_are_spread_evenly():
    points = spread_points(np.array([1.0, 2, 3]), np.array([2.0, 4, 6]), 1000)
    assert (points >= [1, 2, 3]).all()
    assert (points <= [2, 4, 6]).all()
    counts, _ = np.histogramdd(points, bins=(4, 4, 4), range=[(1, 2), (2, 4), (3, 6)])
    assert counts.min() > 10
    assert counts.max() < 22


@pytest.mark.parametrize("turn", [(False, False, False), (True, False, True), (True, True, True), (False, True, False)])
def test_pieces_are_turned_by_their_nesting(boxes, turn):
    mesh = boxes(((0, 0, 0), (6, 6, 6), turn[0]), ((0, 0, 0), (4, 4, 4), turn[1]), ((0, 0, 0), (2, 2, 2), turn[2]))
    faces = turned_outward(mesh.vertices, mesh.faces, as_whole=False)
    volumes = [volume(mesh.vertices, faces[12 * k : 12 * k + 12]) for k in range(3)]
    np.testing.assert_allclose(volumes, [216, -64, 8])


def test_a_mesh_that_agrees_with_itself_is_turned_as_a_whole(boxes):
    mesh = boxes(((0, 0, 0), (6, 6, 6), True), ((1, 0, 0), (4, 2, 2), False))
    faces = turned_outward(mesh.vertices, mesh.faces, as_whole=True)
    np.testing.assert_array_equal(faces, mesh.faces[:, ::-1])
    assert turned_outward(mesh.vertices, faces, as_whole=True) is faces


def test_overlapping_pieces_that_do_not_enclose_each_other_all_face_outward(boxes):
    mesh = boxes(((0, 0, 0), (4, 4, 4), True), ((3, 0, 0), (4, 2, 2), False))
    faces = turned_outward(mesh.vertices, mesh.faces, as_whole=False)
    assert volume(mesh.vertices, faces[:12]) == pytest.approx(64)
    assert volume(mesh.vertices, faces[12:]) == pytest.approx(16)
