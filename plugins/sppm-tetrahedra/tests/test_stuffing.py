"""Isosurface stuffing: volumes, angles, faces that match, faces of the box that stay planar."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sppm_tetrahedra import volume_mesh as periodic
from sppm_tetrahedra.numerics import faces
from sppm_tetrahedra.numerics.quality import dihedral_extremes, quality, volumes
from sppm_tetrahedra.stages.mesh_isosurface_stuffing import (
    ANGLES,
    TOO_CLOSE,
    require_room,
    stuff,
    without_islands,
)

from sppm_pipeline.errors import ResourceError
from sppm_pipeline.services.mesh.measures import edge_counts, volume


def box_of(n):
    return np.array([[0.0, 0, 0], [n, n, n]])


def conforms(mesh):
    """No face of three tetrahedra; the faces of one bound the same volume, and meet in pairs along edges."""
    neighbors = faces.face_neighbors(mesh.tets)
    assert not (neighbors == faces.NON_MANIFOLD).any()
    surface = faces.boundary_triangles(mesh.tets, neighbors)
    assert edge_counts(surface).bounds_solid
    assert volume(mesh.nodes, surface) == pytest.approx(volumes(mesh.nodes, mesh.tets).sum(), rel=1e-12)
    return surface


def good_angles(mesh):
    angles = dihedral_extremes(mesh.nodes, mesh.tets)
    assert angles[:, 0].min() >= ANGLES[0]
    assert angles[:, 1].max() <= ANGLES[1]


@pytest.mark.parametrize("repeats", [True, False])
def test_a_full_box_is_filled_exactly(repeats):
    mesh = stuff(np.full((11, 13, 9), -1, np.float32), repeats)
    assert volumes(mesh.nodes, mesh.tets).sum() == pytest.approx(5 * 6 * 4, rel=1e-14)
    assert set(np.round(volumes(mesh.nodes, mesh.tets), 12)) == {round(1 / 12, 12), round(1 / 24, 12)}
    surface = conforms(mesh)
    # all of the boundary lies in the six faces of the box
    low, high = periodic.on_faces(mesh.nodes, np.array([[0, 0, 0], [4, 6, 5.0]]))
    assert (low[surface].all(1) | high[surface].all(1)).any(1).all()
    assert quality(mesh.nodes, mesh.tets).minimum_dihedral == pytest.approx(45)


@pytest.mark.parametrize("repeats", [True, False])
@pytest.mark.parametrize("solid", [0.2, 0.5, 0.8])
@pytest.mark.parametrize("spread", [0.0, 0.3, 0.6, 2.0])
def test_noise_keeps_the_bounds(noise, repeats, solid, spread):
    for seed in range(3):
        mesh = stuff(noise(9, seed, repeats, solid, spread), repeats)
        good_angles(mesh)
        conforms(mesh)
        assert mesh.nodes.min() >= 0
        assert mesh.nodes.max() <= 9


@settings(deadline=None, derandomize=True, max_examples=20)
@given(st.integers(0, 10**6), st.floats(0.1, 0.9), st.floats(0, 3), st.booleans())
def test_any_noise_keeps_the_bounds(noise, seed, solid, spread, repeats):
    mesh = stuff(noise(6, seed, repeats, solid, spread), repeats)
    if len(mesh.tets):
        good_angles(mesh)
        conforms(mesh)


def test_opposite_faces_are_copies(noise):
    n = 9
    mesh = stuff(noise(n, 4), True)
    assert np.array_equal(periodic.matched_nodes(mesh.nodes, box_of(n)), mesh.twins)
    apart = mesh.nodes - mesh.nodes[mesh.twins]
    assert set(np.unique(apart)) == {0.0, float(n)}
    match = periodic.face_match(mesh.nodes, mesh.tets, box_of(n))
    assert (match.matched > 50).all()
    assert not match.mismatched.any()
    # with copies taken as one, no face of the box is left as a boundary but where the surface lies in it
    wrapped = faces.face_neighbors(mesh.twins[mesh.tets])
    plain = faces.face_neighbors(mesh.tets)
    assert (plain == faces.BOUNDARY).sum() - (wrapped == faces.BOUNDARY).sum() == 2 * match.matched.sum()


def test_a_shifted_torus_is_the_same_structure(lattice):
    def gyroid(shift):
        def f(x, y, z):
            x, y, z = (2 * np.pi * (v + shift) for v in (x, y, z))
            return np.sin(x) * np.cos(y) + np.sin(y) * np.cos(z) + np.sin(z) * np.cos(x) - 0.3

        return f

    found = [
        volumes(m.nodes, m.tets).sum() / 16**3 for m in (stuff(lattice(gyroid(s), 16), True) for s in (0, 0.25, 0.13))
    ]
    assert found[1] == pytest.approx(found[0], rel=1e-3)
    assert found[2] == pytest.approx(found[0], rel=5e-3)


def ball(radius, middle):
    def f(x, y, z):
        away = [np.abs(v - middle) for v in (x, y, z)]
        return np.sqrt(sum(np.minimum(v, 1 - v) ** 2 for v in away)) - radius

    return f


@pytest.mark.parametrize("middle", [0.5, 0.0, 0.03])
def test_volume_converges_with_the_square_of_the_spacing(lattice, middle):
    exact = 4 / 3 * np.pi * 0.4**3
    errors = []
    for n in (8, 16, 32):
        mesh = stuff(lattice(ball(0.4, middle), n), True)
        errors.append(abs(volumes(mesh.nodes, mesh.tets).sum() / n**3 - exact) / exact)
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert errors[-1] < 2.5e-3
    assert (orders > 1.7).all()


def test_nodes_of_the_surface_lie_on_it(lattice):
    n, radius = 24, 0.4
    mesh = stuff(lattice(ball(radius, 0.5), n), False)
    used = np.unique(conforms(mesh))
    away = np.linalg.norm(mesh.nodes[used] / n - 0.5, axis=1) - radius
    assert np.abs(away).max() < 0.02 / n * 8  # linear interpolation of a distance


def test_a_surface_parallel_to_a_face_of_the_box(lattice):
    for depth in np.linspace(0.001, 0.2, 15):
        mesh = stuff(lattice(lambda x, y, z: depth - z + 0 * x, 8, False), False)  # noqa: B023
        good_angles(mesh)
        conforms(mesh)
        # points in the face that are too close to the surface count as on it
        assert volumes(mesh.nodes, mesh.tets).sum() / 8**3 == pytest.approx(1 - depth, abs=0.45 * 0.5 / 8)


def test_two_fields_are_met_exactly(lattice):
    n = 12
    first, second = (
        lattice(lambda x, y, z: x - 0.53 + 0 * y + 0 * z, n),
        lattice(lambda x, y, z: 1000 * (y - 0.61) + 0 * x + 0 * z, n),
    )
    mesh = stuff(np.maximum(first, second), False, (first, second))
    used = np.unique(conforms(mesh))
    inner = mesh.nodes[used][((mesh.nodes[used] > 1) & (mesh.nodes[used] < n - 1)).all(1)] / n
    away = np.minimum(np.abs(inner[:, 0] - 0.53), np.abs(inner[:, 1] - 0.61))
    assert away.max() < 1e-4
    mixed = stuff(np.maximum(first, second), False)
    assert abs(volumes(mesh.nodes, mesh.tets).sum() - volumes(mixed.nodes, mixed.tets).sum()) > 1


def test_unmoved_points_can_never_spoil_the_angles():
    """All cuts of both kinds of tetrahedra with points in their places, at extreme and middling shares."""
    full = np.array([[0, 0, 0], [2, 0, 0], [1, -1, -1], [1, 1, -1]], float)  # corners of a square's edge, two centers
    half = np.array([[0, 0, 0], [2, 0, 0], [1, 1, 0], [1, 1, 1]], float)  # edge of a square, its center, that of a cube
    for corners in (full, half):
        pairs = list(itertools.combinations(range(4), 2))
        least, greatest = 180.0, 0.0
        for plus in itertools.product((1, 0, -1), repeat=4):
            cut = [p for p in pairs if plus[p[0]] * plus[p[1]] < 0]
            if sum(s > 0 for s in plus) != 1:
                continue  # corners that are cut off; prisms and pyramids are what the noise above is for
            top = plus.index(1)
            for shares in itertools.product((0, 0.5, 1), repeat=len(cut)):
                points = corners.copy()
                for (a, b), where in zip(cut, shares, strict=True):
                    other = b if a == top else a
                    square = int(((corners[a] - corners[b]) ** 2).sum())
                    limit = TOO_CLOSE[square]
                    share = limit + where * (1 - 2 * limit)
                    points[other] = corners[top] + share * (corners[other] - corners[top])
                tet = np.array([[0, 1, 2, 3]])
                if volumes(points, tet)[0] < 0:
                    tet = tet[:, [0, 1, 3, 2]]
                low, high = dihedral_extremes(points, tet)[0]
                least, greatest = min(least, low), max(greatest, high)
        assert least > ANGLES[0]
        assert greatest < ANGLES[1]


def test_islands_are_removed_on_the_torus(lattice):
    def two(x, y, z):  # a bar through the box and a ball across its faces
        bar = np.hypot(y - 0.5, z - 0.5) - 0.2 + 0 * x
        return np.minimum(bar, ball(0.2, 0.0)(x, y, z))

    mesh = stuff(lattice(two, 12), True)
    kept, removed = without_islands(mesh)
    small, large = 4 / 3 * np.pi * 0.008, np.pi * 0.04
    assert removed == pytest.approx(small / (small + large), rel=0.08)
    assert len(np.unique(kept.tets)) == len(kept.nodes)
    conforms(kept)
    assert np.array_equal(periodic.matched_nodes(kept.nodes, box_of(12)), kept.twins)
    again, nothing = without_islands(kept)
    assert nothing == 0.0
    assert np.array_equal(again.tets, kept.tets)


def test_pieces_that_touch_in_a_point_are_two(lattice):
    def f(x, y, z):  # two balls that nearly touch across a face of the box
        return ball(0.2, 0.5)(x, y, z)

    mesh = stuff(lattice(f, 8), True)
    assert faces.components(faces.face_neighbors(mesh.tets))[0] == 1
    doubled = np.concatenate([mesh.tets, mesh.tets + len(mesh.nodes)])
    doubled[len(mesh.tets) :][doubled[len(mesh.tets) :] == len(mesh.nodes)] = 0  # one node in common
    assert faces.components(faces.face_neighbors(doubled))[0] == 2


def test_nan_counts_as_void(lattice):
    values = lattice(lambda x, y, z: np.where(x < 0.5, np.nan, -1) + 0 * y + 0 * z, 8, False)
    mesh = stuff(values, False)
    assert np.isfinite(mesh.nodes).all()
    assert mesh.nodes[:, 0].min() >= 3


def test_nothing_solid():
    assert len(stuff(np.ones((9, 9, 9), np.float32), True).tets) == 0


def test_too_many_tetrahedra_are_refused_before_they_are_made(monkeypatch):
    values = np.full((13, 13, 13), -1, np.float32)
    count = len(stuff(values, True).tets)
    monkeypatch.setattr("sppm_tetrahedra.stages.mesh_isosurface_stuffing.MAX_TETRAHEDRA", count // 2)
    with pytest.raises(ResourceError, match="tetrahedra"):
        stuff(values, True)


def test_refused():
    with pytest.raises(ValueError, match="4 cubes"):
        stuff(np.ones((7, 9, 9), np.float32), True)
    with pytest.raises(ResourceError, match="limit"):
        require_room(1000, 1000, 1000)
