"""Bent cells: places are found again, volumes are those of the body, meshes that do not fit are refused by name."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sppm_pipeline.features.grading.curved_cells import CylinderCells, HexahedralCells, SphereCells
from sppm_pipeline.features.grading.numerics.hexahedral_mesh import (
    PLACES,
    above_throughout,
    boundary_triangles,
    checked_mesh,
    determinant_coefficients,
    outer_hexahedra,
    split,
)
from sppm_pipeline.features.grading.numerics.hexahedral_places import points_in
from sppm_pipeline.services.mesh.measures import edge_counts, volume
from tests.features.grading.hexahedral_meshes import o_grid, squares, star

TURN = 2 * math.pi


def bent_block(shape=(3, 2, 2), bend=0.22, seed=3):
    rng = np.random.default_rng(seed)
    nodes = np.stack(np.meshgrid(*(np.arange(n + 1.0) for n in shape), indexing="ij"), -1)
    nodes += rng.uniform(-bend, bend, nodes.shape)
    corners = np.empty((*shape, 2, 2, 2, 3))
    nx, ny, nz = shape
    for i, j, k in np.ndindex(2, 2, 2):
        corners[:, :, :, i, j, k] = nodes[i : i + nx, j : j + ny, k : k + nz]
    return HexahedralCells(corners.reshape(-1, 2, 2, 2, 3), 1, shape)


ALL = {
    "tube": CylinderCells((8, 2, 3), 2.0, 3.0, TURN),
    "shell": CylinderCells((3, 2, 1), 2.0, 3.0, math.radians(200)),
    "sphere": SphereCells((8, 3, 2), 2.0, 5.0, TURN, math.radians(-40), math.radians(90)),
    "block": bent_block(),
    "star": HexahedralCells(split(checked_mesh(*star(5, 2.0)).corners, (2, 2, 2)), 8),
}


@pytest.mark.parametrize("cells", ALL.values(), ids=ALL)
def test_places_are_found_again(cells):
    rng = np.random.default_rng(0)
    cell, within = rng.integers(0, cells.count, 2000), rng.random((2000, 3))
    points, of_unit = cells.mapped_with_volume(cell, within)
    np.testing.assert_allclose(points, cells.points(cell, within), atol=1e-12)
    found = cells.places(points)
    np.testing.assert_array_equal(found.cell, cell)
    np.testing.assert_allclose(found.within, within, atol=1e-9)
    np.testing.assert_allclose(of_unit, np.abs(np.linalg.det(cells.derivatives(cell, within))), rtol=1e-6)
    # the order of points, and what is asked beside them, do not matter
    some = rng.permutation(2000)[:300]
    again = cells.places(points[some])
    np.testing.assert_array_equal(again.within, found.within[some])
    assert (cells.places(cells.box[1] + rng.random((50, 3)) * 3 + 0.1).cell == -1).all()
    low, high = cells.box
    assert ((points > low - 0.2) & (points < high + 0.2)).all()
    assert len(np.unique(cells.names, axis=0)) == cells.count
    assert cells.names.shape[1] == len(cells.columns)


def test_volumes_are_those_of_the_bodies():
    assert ALL["tube"].volumes.sum() == pytest.approx(math.pi * (9**2 - 3**2) * 4, rel=1e-9)
    r = 9.0**3 - 5.0**3
    zone = TURN / 3 * r * (math.sin(math.radians(50)) - math.sin(math.radians(-40)))
    assert ALL["sphere"].volumes.sum() == pytest.approx(zone, rel=2e-3)  # three points along each axis
    assert ALL["star"].volumes.sum() == pytest.approx(5 * 4 * math.sin(TURN / 5) * 4, rel=1e-12)


def test_parts_of_a_hexahedron_are_exact():
    rng = np.random.default_rng(1)
    whole = bent_block().corners
    parts = split(whole, (2, 3, 1))
    t = rng.random((200, 3))
    cell = rng.integers(0, len(whole), 200)
    site = rng.integers(0, [2, 3, 1], (200, 3))
    own = cell * 6 + site[:, 0] * 3 + site[:, 1]
    at, _ = points_in(parts, own, t)
    np.testing.assert_allclose(at, points_in(whole, cell, (site + t) / [2, 3, 1])[0], atol=1e-13)


def test_cells_are_continued_beyond_the_mesh():
    cells = ALL["block"]
    outer = outer_hexahedra(cells.corners, 0.5)
    assert len(outer.cell) == 2 * (3 * 2 + 3 * 2 + 2 * 2)
    rng = np.random.default_rng(2)
    cell, places = cells.continued(cells.points(np.zeros(100, np.int32), rng.random((100, 3)) - [0.4, 0, 0]))
    assert (cell >= 0).mean() > 0.9  # beyond corners there is nothing
    inside = cells.points(np.arange(12).repeat(5), np.tile(rng.random((5, 3)), (12, 1)))
    number, places = cells.continued(inside)
    at = cells.places(inside)
    np.testing.assert_array_equal(number, at.cell)
    site = np.stack(np.unravel_index(at.cell, cells.shape), 1)
    np.testing.assert_allclose(places, site + at.within, atol=1e-12)


@pytest.mark.parametrize("parts", [1, 3])
@pytest.mark.parametrize("mesh", [star(5, 2.0), o_grid(5, 2, 2, 1, 1, 3), squares([(0, 0), (1, 0), (0, 1)], 2.0)])
def test_the_boundary_is_closed_and_holds_the_cells(mesh, parts):
    made = checked_mesh(*mesh)
    vertices, faces = boundary_triangles(made, parts)
    counts = edge_counts(faces)
    assert counts.bounds_solid
    assert counts.non_manifold == 0
    assert volume(vertices, faces) == pytest.approx(HexahedralCells(made.corners).volumes.sum(), rel=1e-9)


def test_nodes_may_be_numbered_as_other_programs_do():
    points, hexes = star(5, 2.0)
    expected = np.sort(checked_mesh(points, hexes).corners.reshape(-1, 3), axis=0)
    for order, words in (([4, 5, 6, 7, 0, 1, 2, 3], "upper"), ([0, 1, 3, 2, 4, 5, 7, 6], "row by row")):
        made = checked_mesh(points, hexes[:, order])
        assert words in made.turned
        np.testing.assert_allclose(np.sort(made.corners.reshape(-1, 3), axis=0), expected)
    # nodes listed once an element, as some programs write them
    apart = checked_mesh(points[hexes].reshape(-1, 3), np.arange(hexes.size).reshape(-1, 8))
    assert len(apart.nodes) == len(points)
    assert len(apart.boundary) == len(checked_mesh(points, hexes).boundary)


def test_what_does_not_fit_is_refused_by_name():
    points, hexes = star(5, 2.0)
    for where, cells, words in (
        (points, np.concatenate([hexes, hexes[3:4, [1, 2, 3, 0, 5, 6, 7, 4]]]), "hexahedra 3 and 10 have the same"),
        (
            points,
            np.concatenate([hexes[:4], hexes[4:5, [4, 5, 6, 7, 0, 1, 2, 3]], hexes[5:]]),
            "hexahedron 4 is inside",
        ),
        (points * [1, 1, 0], hexes, "hexahedron 0 is inside out or flat"),
        (points * 0, hexes, "in one place"),
    ):
        with pytest.raises(ValueError, match=words):
            checked_mesh(where, cells)
    # a large cube beside four small ones
    coarse, one = squares([(0, 0)], 2.0, layers=1)
    fine, four = squares([(2, 0), (2, 1)], 1.0, layers=2)
    with pytest.raises(ValueError, match=r"the node at \[2\.0, .*\] hangs"):
        checked_mesh(np.concatenate([coarse, fine]), np.concatenate([one, four + len(coarse)]))
    # a third one at the face between two
    points, pair = squares([(0, 0), (1, 0)], 1.0, layers=1)
    far = np.flatnonzero(points[:, 0] > 1.5)
    third = pair[1].copy()
    for new, node in enumerate(far):
        third[third == node] = len(points) + new
    with pytest.raises(ValueError, match="3 hexahedra share a face of hexahedron"):
        checked_mesh(np.concatenate([points, points[far] + [0.5, 0.0, 0.0]]), np.concatenate([pair, third[None]]))


def twisted(turn, across=1.0, along=1.0):
    """Corners of a cube whose upper face is turned about z by so many degrees, and stretched."""
    corners = np.stack(np.meshgrid([0.0, 1.0], [0.0, 1.0], [0.0, 1.0], indexing="ij"), -1)[None] - [0.5, 0.5, 0.0]
    c, s = math.cos(math.radians(turn)), math.sin(math.radians(turn))
    top = corners[:, :, :, 1].copy()
    corners[:, :, :, 1, 0] = across * c * top[..., 0] - along * s * top[..., 1]
    corners[:, :, :, 1, 1] = across * s * top[..., 0] + along * c * top[..., 1]
    return corners


def test_coefficients_of_the_determinant_are_exact():
    corners = bent_block(bend=0.5).corners
    t = np.random.default_rng(5).random((40, 3))
    basis = np.stack([(1 - t) ** 2, 2 * t * (1 - t), t**2], -1)  # Bernstein polynomials of degree two
    found = np.einsum("na,nb,nc,mabc->mn", *(basis[:, a] for a in range(3)), determinant_coefficients(corners))
    cell = np.repeat(np.arange(len(corners)), len(t))
    expected = np.linalg.det(points_in(corners, cell, np.tile(t, (len(corners), 1)))[1])
    np.testing.assert_allclose(found.ravel(), expected, atol=1e-13)


@pytest.mark.parametrize(
    ("turn", "across", "along", "good"),
    [
        # the determinant at the height z is ((1 - z) - across z) ((1 - z) - along z) at half a turn
        (180, 1.2, 1.1, False),  # below zero from z = .4545 to .4762 only, and above it in all of 27 places
        (180, 1.0, 1.0, False),  # zero at z = 1/2
        (180, 2.0, 2.0, False),  # zero at z = 1/3, where no halving ever looks
        (178, 2.0, 2.0, True),  # 1.5e-4 there at least
        (170, 1.0, 1.0, True),
        (0, 1.0, 1.0, True),
    ],
)
def test_hexahedra_that_are_inside_out_within_are_found(turn, across, along, good):
    corners = twisted(turn, across, along)
    assert (determinant_coefficients(corners)[:, ::2, ::2, ::2] > 0.9).all()
    assert above_throughout(corners, np.array([1e-9])).tolist() == [good]


def test_no_point_is_lost_or_found_elsewhere_in_strongly_distorted_hexahedra():
    """Newton steps from the middle miss some ten of these points, or end where the map folds back beyond a face."""
    rng = np.random.default_rng(1)
    cube = np.stack(np.meshgrid([0.0, 1.0], [0.0, 1.0], [0.0, 1.0], indexing="ij"), -1)
    corners = cube + rng.uniform(-0.8, 0.8, (40_000, 2, 2, 2, 3))
    corners = corners[above_throughout(corners, np.full(len(corners), 1e-8))][:400]
    assert len(corners) == 400
    within = rng.random((100, 3))
    within[:10] = rng.integers(0, 2, (10, 3))  # corners, which rounding may put just outside
    lost = 0
    for own in corners:
        cells = HexahedralCells(own[None])
        points = cells.points(np.zeros(100, int), within)
        found = cells.places(points)
        lost += np.count_nonzero(found.cell < 0)
        back = cells.points(np.zeros(100, int), found.within)
        np.testing.assert_allclose(back[found.cell == 0], points[found.cell == 0], atol=1e-8)
        inner = (found.cell == 0) & (np.arange(100) >= 10)
        np.testing.assert_allclose(found.within[inner], within[inner], atol=1e-5)
    assert lost == 0


def test_a_strongly_distorted_block_is_filled_once():
    """Each point of the block is in one cell, in which its place maps to it again; those outside are in none."""
    cells = bent_block((3, 3, 3), bend=0.44, seed=172)
    assert above_throughout(cells.corners, np.zeros(27)).all()
    rng = np.random.default_rng(0)
    cell, within = rng.integers(0, 27, 20_000), rng.random((20_000, 3))
    found = cells.places(cells.points(cell, within))
    np.testing.assert_array_equal(found.cell, cell)
    np.testing.assert_allclose(found.within, within, atol=1e-6)
    np.testing.assert_array_equal(cells.continued(cells.points(cell, within))[0], cell)
    low, high = cells.box
    inside = cells.places(low + (high - low) * rng.random((40_000, 3))).cell >= 0
    assert inside.mean() * np.prod(high - low) == pytest.approx(cells.volumes.sum(), rel=0.02)


def test_no_sample_belies_the_proof():
    """Corners anywhere: where the proof holds no place has a determinant below zero, and elsewhere one nearly has."""
    rng = np.random.default_rng(0)
    cube = np.stack(np.meshgrid([0.0, 1.0], [0.0, 1.0], [0.0, 1.0], indexing="ij"), -1)
    corners = cube + rng.uniform(-0.6, 0.6, (1500, 2, 2, 2, 3))
    corners = corners[(determinant_coefficients(corners)[:, ::2, ::2, ::2] > 0).all(axis=(1, 2, 3))]
    above = above_throughout(corners, np.zeros(len(corners)))
    t = np.stack(np.meshgrid(*(np.linspace(0, 1, 11),) * 3, indexing="ij"), -1).reshape(-1, 3)
    cell = np.repeat(np.arange(len(corners)), len(t))
    least = np.linalg.det(points_in(corners, cell, np.tile(t, (len(corners), 1)))[1]).reshape(-1, len(t)).min(axis=1)
    assert 5 < (~above).sum() < 60
    assert (least[above] > 0).all()
    assert (least[~above] < 0.01).all()


def test_a_hexahedron_inside_out_within_is_refused_by_its_number():
    points, hexes = squares([(0, 0), (3, 0)], 1.0, layers=1)
    bad = twisted(180, 1.2, 1.1)[0]
    own = np.array([8.0, 0.0, 0.0]) + bad.reshape(8, 3)[np.argsort(PLACES)]
    with pytest.raises(ValueError, match=r"hexahedron 2 is inside out or flat somewhere within, .* 1 of 3"):
        checked_mesh(np.concatenate([points, own]), np.concatenate([hexes, np.arange(8)[None] + len(points)]))


@pytest.mark.parametrize("around", [300.0, 330.0, 360.0, 80.0])
def test_the_box_of_a_tube_holds_its_wall_and_little_more(around):
    for cells in (CylinderCells((1, 1, 1), 1.0, 10.0, math.radians(around)),
                  CylinderCells((284, 3, 2), 2.0, 100.0, math.radians(around))):  # fmt: skip
        t = np.linspace(0, cells.shape[0], 20001)
        wall = np.concatenate([cells.mapped(np.stack([t, 0 * t, 0 * t + z], 1))[0] for z in (0, cells.shape[2])])
        low, high = cells.box
        assert (low[:2] <= wall[:, :2].min(0)).all()
        assert (high[:2] >= wall[:, :2].max(0)).all()
        radius = cells.inner_radius + cells.edge * cells.shape[2]
        assert np.abs(low - wall.min(0))[:2].max() < 2e-3 * radius
        assert low[2] == 0
        assert high[2] == pytest.approx(cells.shape[1] * cells.edge)


def test_a_gap_belongs_to_no_other_cell_whatever_was_asked_before():
    """Cells are continued half a cell beyond the mesh, and so into those on the other side of a slit."""
    angle = np.linspace(math.radians(1), math.radians(359), 25)
    ring = np.array([[[[r * math.cos(a), r * math.sin(a), z] for z in (0.0, 1.0)] for r in (3.0, 4.0)] for a in angle])
    corners = np.stack([ring[:-1], ring[1:]], axis=1)
    cells = HexahedralCells(corners, 1)
    x, y = np.meshgrid(np.linspace(3, 4, 31), np.linspace(0.9, -0.9, 181), indexing="ij")  # across the slit
    points = np.stack([x.ravel(), y.ravel(), np.full(x.size, 0.5)], axis=1)
    own = cells.places(points).cell
    found = cells.continued(points)[0]
    assert np.array_equal(found[own >= 0], own[own >= 0])
