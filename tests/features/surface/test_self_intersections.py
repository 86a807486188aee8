"""Exact predicates against fractions, pairs of triangles against a slow exact test, and meshes of known overlap."""

from fractions import Fraction
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sppm_pipeline.features.surface.numerics.meshcheck.self_intersections import (
    is_flat,
    self_intersections,
    triangles_meet,
)
from sppm_pipeline.method.part.primitive_meshes import ball_mesh, box_mesh, torus_knot_mesh
from sppm_pipeline.services.mesh.box_tree import box_tree
from sppm_pipeline.services.mesh.predicates import side_of_line, side_of_plane

LATTICE = st.integers(-2, 2)
POINT = st.tuples(LATTICE, LATTICE, LATTICE)


def sign(value):
    return int(value > 0) - int(value < 0)


def exactly(points):
    return [[Fraction(float(v)) for v in p] for p in points]


def determinant(a, b, c):
    return a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0]) + a[2] * (b[0] * c[1] - b[1] * c[0])


def minus(a, b):
    return [x - y for x, y in zip(a, b, strict=True)]


def test_sides_are_exact_where_doubles_are_not():
    rng = np.random.default_rng(0)
    wrong_in_doubles = 0
    for i in range(2000):
        a, b, c = rng.normal(size=(3, 3)) * 10.0 ** rng.integers(-5, 6, (3, 3))
        s, r = rng.random(2)
        p = a + s * (b - a) + r * (c - a)
        if i % 3 == 0:
            p = p + rng.integers(-2, 3, 3) * np.spacing(p)
        if i % 5 == 0:
            a, b, c, p = (np.round(v * 4) * 0.1 for v in (a / abs(a).max(), b / abs(b).max(), c / abs(c).max(), p * 0))
        x, y, z, q = exactly((a, b, c, p))
        expected = sign(determinant(minus(x, q), minus(y, q), minus(z, q)))
        assert side_of_plane(a, b, c, p) == expected
        wrong_in_doubles += int(sign(np.linalg.det([a - p, b - p, c - p])) != expected)
        flat = sign((x[0] - q[0]) * (y[1] - q[1]) - (x[1] - q[1]) * (y[0] - q[0]))
        assert side_of_line(a[0], a[1], b[0], b[1], p[0], p[1]) == flat
    assert wrong_in_doubles > 100


def meets_slowly(t, s):
    """Whether the triangles share a point that is no common corner or edge: every edge against every triangle, exactly.

    The edges of one are clipped by the other: by its plane, then by its three sides within the plane.
    """
    t, s = exactly(t), exactly(s)
    common = [p for p in t if p in s]
    if len(common) == 3:
        return True
    for one, other in ((t, s), (s, t)):
        a, b, c = other
        normal = cross(minus(b, a), minus(c, a))
        for p, q in combinations(one, 2):
            low, high = Fraction(0), Fraction(1)
            step = minus(q, p)
            limits = [(dot(normal, minus(p, a)), dot(normal, step), True)]
            for u, v, w in ((a, b, c), (b, c, a), (c, a, b)):
                inwards = cross(normal, minus(v, u))
                assert dot(inwards, minus(w, u)) > 0
                limits.append((dot(inwards, minus(p, u)), dot(inwards, step), False))
            for value, slope, equal in limits:
                if slope == 0:
                    if value < 0 or (equal and value != 0):
                        low, high = Fraction(1), Fraction(0)
                    continue
                at = -value / slope
                if equal:
                    low, high = max(low, at), min(high, at)
                elif slope > 0:
                    low = max(low, at)
                else:
                    high = min(high, at)
            if low > high:
                continue
            ends = [[x + at * d for x, d in zip(p, step, strict=True)] for at in (low, high)]
            if not on_common(ends, common):
                return True
    return False


def on_common(ends, common):
    if len(common) == 1:
        return all(end == common[0] for end in ends)
    if len(common) == 2:
        u, v = common
        return all(not any(cross(minus(end, u), minus(v, u))) for end in ends)
    return False


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def dot(a, b):
    return sum(x * y for x, y in zip(a, b, strict=True))


@settings(max_examples=600, deadline=None, derandomize=True)
@given(st.lists(POINT, min_size=6, max_size=6), st.integers(0, 2))
def test_pairs_on_a_coarse_lattice(points, shared):
    """On five positions an axis, triangles touch, share corners, and lie in one plane all the time."""
    corners = np.array(points, float) * 0.1
    corners[3 : 3 + shared] = corners[:shared]
    t, s = corners[:3].copy(), corners[3:].copy()
    if is_flat(t) or is_flat(s):
        areas = [abs(np.cross(x[1] - x[0], x[2] - x[0])).max() for x in (t, s)]
        assert min(areas) < 1e-12
        return
    expected = meets_slowly(t, s)
    for one in (t, t[::-1].copy(), t[[1, 2, 0]]):
        for other in (s, s[[2, 0, 1]], s[::-1].copy()):
            assert triangles_meet(one, other) == expected
            assert triangles_meet(other, one) == expected


def found_in(vertices, faces):
    return self_intersections(box_tree(np.asarray(vertices, float)[faces]))


@pytest.mark.parametrize("seed", range(3))
def test_all_pairs_are_found(seed):
    rng = np.random.default_rng(seed)
    t = rng.random((150, 3, 1)) * np.ones(3) + rng.normal(scale=0.2, size=(150, 3, 3))
    expected = np.zeros(150, bool)
    pairs = 0
    for i, j in combinations(range(150), 2):
        if triangles_meet(t[i], t[j]):
            pairs += 1
            expected[[i, j]] = True
    found = self_intersections(box_tree(t))
    assert pairs > 300
    assert (found.pairs, found.complete) == (pairs, True)
    assert np.array_equal(found.faces, expected)
    again = self_intersections(box_tree(t), max_pairs=pairs)
    assert not again.complete


def test_sound_meshes_do_not_meet_themselves():
    for vertices, faces in (
        ball_mesh((0.1, 0.2, 0.3), 1.7, 4),
        box_mesh((0, 0, 0), (1, 2, 3)),
        torus_knot_mesh((0, 0, 0), (2, 3), 0.6, 0.25, 0.1, 160, 24),
    ):
        turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
        for points in (vertices, vertices @ turn):
            assert found_in(points, faces).pairs == 0


def test_two_boxes():
    a, faces = box_mesh((0, 0, 0), (1, 1, 1))
    both = np.concatenate([faces, faces + 8])
    for shift, meet in (((0.5, 0.4, 0.3), True), ((1, 0, 0), True), ((1, 1, 1), False), ((1.001, 0, 0), False)):
        found = found_in(np.concatenate([a, a + np.array(shift)]), both)
        assert (found.pairs > 0) == meet
        assert found.faces[:12].any() == found.faces[12:].any() == meet


def test_a_fold_a_duplicate_and_a_flat_one():
    points = np.array([(0, 0, 0), (1, 0, 0), (0.3, 1, 0), (0.6, 0.7, 0), (0.3, -1, 0), (2, 0, 0)], float)
    assert found_in(points, np.array([(0, 1, 2), (1, 0, 3)])).pairs == 1
    assert found_in(points, np.array([(0, 1, 2), (1, 0, 4)])).pairs == 0
    assert found_in(points, np.array([(0, 1, 2), (2, 1, 0)])).pairs == 1
    assert found_in(points, np.array([(0, 1, 2), (0, 1, 5)])).pairs == 0
    with pytest.raises(ValueError, match="triangle"):
        box_tree(np.empty((0, 3, 3)))
