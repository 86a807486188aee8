"""Measures of meshes whose numbers are known."""

import numpy as np
import pytest

from sppm_pipeline.services.mesh.measures import (
    balanced_edges,
    bounds,
    components,
    edge_counts,
    euler_number,
    genus,
    measure_surface,
    surface_area,
    volume,
)

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
TETRAHEDRON = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def ring(n: int) -> np.ndarray:
    """A torus of n x n quads."""
    i, j = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    a, b, c, d = (
        ((i + p) % n * n + (j + q) % n).ravel() for p, q in ((0, 0), (1, 0), (1, 1), (0, 1))
    )  # fmt: skip
    return np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def test_a_tetrahedron() -> None:
    measures = measure_surface(CORNERS, TETRAHEDRON)
    assert measures.edges == (6, 0, 0, 0)
    assert measures.edges.closed
    assert (measures.euler, measures.genus, measures.components) == (2, 0, 1)
    assert measures.volume == pytest.approx(1 / 6)
    assert measures.area == pytest.approx(1.5 + np.sqrt(3) / 2)
    assert (measures.low, measures.high) == ((0, 0, 0), (1, 1, 1))
    assert (measures.vertices, measures.faces, measures.degenerate) == (4, 4, 0)


def test_inside_out_is_negative_and_far_away_is_exact() -> None:
    assert volume(CORNERS, TETRAHEDRON[:, ::-1]) == pytest.approx(-1 / 6)
    assert volume(CORNERS + 1e6, TETRAHEDRON) == pytest.approx(1 / 6, rel=1e-9)


def test_a_ring_and_two_rings() -> None:
    one = ring(5)
    assert genus(one) == 1
    two = np.concatenate([one, one + 25])
    assert (genus(two), euler_number(two)) == (2, 0)
    count, labels = components(two)
    assert count == 2
    assert labels.tolist() == [0] * len(one) + [1] * len(one)


def test_a_hole() -> None:
    edges = edge_counts(TETRAHEDRON[1:])
    assert edges == (6, 3, 0, 3)
    assert not edges.closed
    assert edges.consistent
    assert not edges.bounds_solid
    with pytest.raises(ValueError, match="closed"):
        genus(TETRAHEDRON[1:])
    assert measure_surface(CORNERS, TETRAHEDRON[1:]).genus is None


def test_a_flipped_triangle() -> None:
    flipped = TETRAHEDRON.copy()
    flipped[0] = flipped[0, ::-1]
    edges = edge_counts(flipped)
    assert edges == (6, 0, 0, 3)
    assert not edges.closed
    assert not edges.consistent


def test_two_solids_that_share_an_edge_bound_a_volume_but_are_no_manifold() -> None:
    other = np.array([0, 1, 4, 5])[TETRAHEDRON]  # has vertices 0 and 1 in common with the first
    edges = edge_counts(np.concatenate([TETRAHEDRON, other]))
    assert edges == (11, 0, 1, 0)
    assert not edges.closed
    assert edges.bounds_solid


def test_a_fan_with_more_triangles_than_the_insertion_sort_takes() -> None:
    n = 500
    rim = np.random.default_rng(0).permutation(n) + 1
    fan = np.stack([np.zeros(n, int), rim, np.roll(rim, -1)], axis=1)
    assert edge_counts(fan) == (2 * n, n, 0, n)
    cone = np.concatenate([fan, np.stack([np.full(n, n + 1), np.roll(rim, -1), rim], axis=1)])
    assert edge_counts(cone).closed
    assert genus(cone) == 0


def test_edge_counts_against_a_dictionary() -> None:
    faces = np.random.default_rng(1).integers(0, 12, (60, 3))
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 0] != faces[:, 2])]
    uses: dict[tuple[int, int], list[int]] = {}
    for a, b, c in faces.tolist():
        for p, q in ((a, b), (b, c), (c, a)):
            uses.setdefault((min(p, q), max(p, q)), []).append(1 if p < q else -1)
    expected = (
        len(uses),
        sum(len(use) == 1 for use in uses.values()),
        sum(len(use) > 2 for use in uses.values()),
        sum(sum(use) != 0 for use in uses.values()),
    )
    assert edge_counts(faces) == expected


def test_degenerate_triangles() -> None:
    points = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1e-6, 0], [3, 3, 3]], float)
    faces = np.array([[0, 1, 2], [0, 1, 1], [0, 1, 3]])
    assert measure_surface(points, faces).degenerate == 2
    assert surface_area(points, faces) == pytest.approx(5e-7)
    assert not edge_counts(np.array([[0, 1, 1]])).bounds_solid


def test_vertices_without_triangle_do_not_count() -> None:
    points = np.concatenate([CORNERS, [[9.0, 9.0, 9.0]]])
    assert bounds(points, TETRAHEDRON)[1].tolist() == [1, 1, 1]
    assert measure_surface(points, TETRAHEDRON).vertices == 4


def test_no_triangles_and_wrong_numbers() -> None:
    none = np.empty((0, 3), np.int32)
    assert edge_counts(none) == (0, 0, 0, 0)
    assert not edge_counts(none).closed
    assert (euler_number(none), components(none)[0], volume(CORNERS, none)) == (0, 0, 0.0)
    with pytest.raises(ValueError, match="bounds"):
        bounds(CORNERS, none)
    with pytest.raises(ValueError, match="-1"):
        edge_counts(np.array([[0, 1, -1]]))
    with pytest.raises(ValueError, match="only 4"):
        volume(CORNERS, np.array([[0, 1, 4]]))


def test_balanced_edges_say_what_the_counts_say() -> None:
    flipped = TETRAHEDRON.copy()
    flipped[0] = flipped[0, ::-1]
    shared = np.concatenate([TETRAHEDRON, np.array([0, 1, 4, 5])[TETRAHEDRON]])
    doubled = np.concatenate([TETRAHEDRON, TETRAHEDRON])
    for faces in (TETRAHEDRON, TETRAHEDRON[1:], flipped, shared, doubled, ring(9), ring(9)[:-1], np.array([[0, 1, 1]])):
        assert balanced_edges(faces) == edge_counts(faces).bounds_solid
    assert not balanced_edges(np.empty((0, 3), np.int32))
    rng = np.random.default_rng(2)
    for seed in range(200):
        faces = np.random.default_rng(seed).integers(0, 5, (6, 3))
        assert balanced_edges(faces) == edge_counts(faces).bounds_solid
    faces = rng.integers(0, 2**31 - 1, (1000, 3)).astype(np.int32)
    assert balanced_edges(np.concatenate([faces, faces[rng.permutation(1000)][:, ::-1]]))
