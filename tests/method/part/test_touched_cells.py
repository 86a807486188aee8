"""Cells that a part touches, against polygons cut by the faces of each cell."""

import numpy as np
import pytest

from sppm_pipeline.method.part.inside import _touch, cells_touched


def meets(triangle, low, high):
    """Whether anything is left of a triangle that is cut by the six faces of a box."""
    polygon = [np.asarray(corner, float) for corner in triangle]
    for axis in range(3):
        for sign, bound in ((1, high[axis]), (-1, -low[axis])):
            inside = [bound - sign * corner[axis] for corner in polygon]
            kept = []
            for n, corner in enumerate(polygon):
                if inside[n - 1] * inside[n] < 0:
                    share = inside[n - 1] / (inside[n - 1] - inside[n])
                    kept.append(polygon[n - 1] + share * (corner - polygon[n - 1]))
                if inside[n] >= 0:
                    kept.append(corner)
            polygon = kept
    return bool(polygon)


@pytest.mark.parametrize("kind", ["any", "thin", "in a line", "along an axis"])
def test_a_large_triangle_touches_the_cells_that_it_meets(kind):
    rng = np.random.default_rng(3)
    shape, origin, edge = (6, 5, 7), np.array([-1.3, 0.2, 4.0]), 0.7
    counts = []
    for _ in range(60):
        corners = origin + edge * rng.uniform(0, 1, (3, 3)) * shape
        if kind == "thin":
            corners[2] = corners[0] + 0.4 * (corners[1] - corners[0]) + 1e-6 * rng.standard_normal(3)
        elif kind == "in a line":
            corners[2] = corners[0] + rng.uniform(0.1, 0.9) * (corners[1] - corners[0])
        elif kind == "along an axis":
            corners[:, rng.integers(3)] = corners[0, 0] if rng.integers(2) else origin[0] + 0.35 * edge
            corners = np.clip(corners, origin, origin + edge * np.array(shape))
        low, high = (np.floor((f(corners, axis=0) - origin) / edge).astype(int) for f in (np.min, np.max))
        if (high - low).max() < 2:
            continue  # its box decides
        touched = np.zeros(shape, np.bool_)
        _touch(corners[None], origin, edge, touched)
        expected = np.zeros(shape, np.bool_)
        for cell in np.ndindex(shape):
            lower = origin + edge * np.array(cell)
            expected[cell] = meets(corners, lower, lower + edge)
        assert not (expected & ~touched).any()
        # beyond the cells that are met, those that it comes near to, as touching counts
        for cell in np.argwhere(touched & ~expected):
            lower = origin + edge * cell
            assert meets(corners, lower - 1e-6, lower + edge + 1e-6)
        counts.append(touched.sum())
    assert len(counts) > 20


def test_a_triangle_between_two_cells_is_in_one_of_them_however_far_away():
    rng = np.random.default_rng(3)
    for _ in range(100):
        origin, axis, edge = 1e8 * rng.uniform(-1, 1, 3), rng.integers(3), 0.7
        corners = origin + edge * np.array([[0.5, 0.5, 0.5], [0.7, 5.5, 0.6], [5.5, 0.6, 5.5]])
        corners[:, axis] = origin[axis] + rng.integers(1, 6) * edge
        touched = np.zeros((6, 6, 6), np.bool_)
        _touch(corners[None], origin, edge, touched)
        assert touched.any()


def test_a_slanting_bar_of_few_triangles_has_the_cells_of_one_of_many():
    corners = np.array([[x, y, z] for x in (0.0, 30.0) for y in (-0.4, 0.4) for z in (0.0, 0.8)])
    faces = np.array(
        [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
         [1, 5, 7], [1, 7, 3]]
    )  # fmt: skip
    turn = np.array([[1, -1, 0], [1, 1, 0], [0, 0, np.sqrt(2)]]) / np.sqrt(2)
    few = corners @ turn.T, faces
    many = few
    for _ in range(5):
        many = halved(*many)
    origin, shape = np.array([-1.013, -1.027, -0.1]), (24, 24, 1)
    of_few, of_many = (cells_touched(*mesh, origin, 1.0, shape) for mesh in (few, many))
    assert of_few.sum() <= of_many.sum() < 90  # a box of the bar has 576
    places = np.floor(many[0] - origin).astype(int)
    assert of_few[tuple(places.T)].all()


def halved(vertices, faces):
    """Four triangles for each; vertices are not shared."""
    a, b, c = (vertices[faces[:, n]] for n in range(3))
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    points = np.concatenate([np.stack(part, axis=1) for part in parts])
    return points.reshape(-1, 3), np.arange(3 * len(points)).reshape(-1, 3)
