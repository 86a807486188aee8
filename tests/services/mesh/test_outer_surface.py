"""The surface of shells that overlap: the volume of their union is known, and buried triangles are left out."""

import numpy as np
import pytest

from sppm_pipeline.method.part.inside import inside_layers, prepare_inside
from sppm_pipeline.method.part.primitive_meshes import ball_mesh, box_mesh
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.mesh.measures import volume
from sppm_pipeline.services.mesh.outer_surface import outer_surface

CUBE = (4.0, 4.0, 4.0)


def joined(*shells):
    """One mesh of several (vertices, faces)."""
    offsets = np.cumsum([0, *(len(vertices) for vertices, _ in shells)])
    faces = [faces + offset for (_, faces), offset in zip(shells, offsets, strict=False)]
    return np.concatenate([vertices for vertices, _ in shells]), np.concatenate(faces).astype(np.int32)


def area(triangles):
    return (
        np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1).sum() / 2
    )


def test_one_shell_is_its_own_surface():
    assert outer_surface(*ball_mesh((0.0, 0.0, 0.0), 2.0, 2)) is None


@pytest.mark.parametrize(
    ("place", "united", "surface"),
    [
        ((2.0, 0.0, 0.0), 96.0, 2 * 16 + 4 * 4 * 6),  # four faces in common planes
        ((2.0, 1.0, 0.0), 128 - 2 * 3 * 4, None),
        ((2.1, 1.3, 0.7), 128 - 1.9 * 2.7 * 3.3, 192 - 2 * (1.9 * 2.7 + 1.9 * 3.3 + 2.7 * 3.3)),
        ((4.0, 0.0, 0.0), 128.0, 2 * 16 + 4 * 4 * 8),  # face to face
        ((4.0, 1.0, 0.0), 128.0, 192 - 2 * 12),
        ((9.0, 0.0, 0.0), 128.0, 192.0),
    ],
)
def test_two_cubes(place, united, surface):
    found = outer_surface(*joined(box_mesh((0.0, 0.0, 0.0), CUBE), box_mesh(place, CUBE)))
    assert found.volume == pytest.approx(united, rel=1e-9)
    if surface is not None and 0.0 not in place[1:]:  # where faces lie on each other, both are kept
        assert area(found.triangles) == pytest.approx(surface, rel=1e-5)


def test_balls_overlap_in_a_lens():
    (v, f), (w, g) = ball_mesh((0.0, 0.0, 0.0), 2.0, 4), ball_mesh((2.0, 0.1, 0.2), 2.0, 4)
    found = outer_surface(*joined((v, f), (w, g)))
    d = np.sqrt(4.05)
    lens = np.pi * (2 * 2 - d) ** 2 * (d * d + 4 * d * 2) / (12 * d)
    assert found.volume == pytest.approx(2 * volume(v, f) - lens, rel=2e-3)
    middles = found.triangles.mean(axis=1)
    assert np.linalg.norm(middles, axis=1).min() > 1.98
    assert np.linalg.norm(middles - (2.0, 0.1, 0.2), axis=1).min() > 1.98


def test_shells_within_and_upon_each_other():
    outer, inner = ball_mesh((0.0, 0.0, 0.0), 3.0, 3), ball_mesh((0.2, 0.0, 0.0), 1.0, 3)
    nested = outer_surface(*joined(outer, inner))
    assert nested.volume == pytest.approx(volume(*outer), rel=1e-9)
    assert np.array_equal(nested.owners, np.arange(len(outer[1])))
    doubled = outer_surface(*joined(outer, outer))
    assert doubled.volume == pytest.approx(volume(*outer), rel=1e-9)
    hollow = outer_surface(*joined(outer, (inner[0], inner[1][:, ::-1])))
    assert hollow.volume == pytest.approx(volume(*outer) - volume(*inner), rel=1e-9)
    assert len(hollow.triangles) == len(outer[1]) + len(inner[1])


def test_many_shells_at_random():
    """Against a count of points, and the same bytes each time."""
    rng = np.random.default_rng(3)
    centers = rng.random((12, 3)) * 6
    mesh = joined(*(ball_mesh(tuple(center), 1.5, 2) for center in centers))
    found, again = outer_surface(*mesh), outer_surface(*mesh)
    assert np.array_equal(found.triangles, again.triangles)
    h, n = 0.0723, 130
    grid = Grid((-1.7, -1.7, -1.7), (h, h, h), (n, n, n))
    counted = int(inside_layers(prepare_inside(*mesh, grid), 0, n).mask.sum()) * h**3
    assert found.volume == pytest.approx(counted, rel=2e-3)
