"""The vote of three axes equals the scan on closed meshes, and mends small holes."""

import numpy as np
import pytest

from sppm_pipeline.method.part.primitive_meshes import ball_mesh, box_mesh, torus_knot_mesh
from sppm_pipeline.method.part.ray_crossings import prepare_scan
from sppm_pipeline.method.part.scanline import prepare_three_axis, scan_layers, vote_layers
from sppm_pipeline.services.grid import Grid

GRID = Grid((-1.07, -1.1, -0.83), (0.031, 0.033, 0.025), (70, 68, 66))
KNOT = torus_knot_mesh((0, 0, 0), (2, 3), 0.6, 0.25, 0.15, 160, 24)


def iou(a, b):
    return (a & b).sum() / (a | b).sum()


def test_a_closed_mesh_gets_the_same_from_all_axes():
    expected = scan_layers(prepare_scan(*KNOT, GRID), 0, 66)
    prepared = prepare_three_axis(*KNOT, GRID)
    found = vote_layers(prepared, 0, 66)
    np.testing.assert_array_equal(found.mask, expected.mask)
    assert found.undecided == 0
    parts = [vote_layers(prepared, k, min(k + 17, 66)).mask for k in range(0, 66, 17)]
    np.testing.assert_array_equal(np.concatenate(parts), expected.mask)


@pytest.mark.parametrize("seed", range(4))
def test_holes_are_outvoted(seed):
    vertices, faces = ball_mesh((0, 0, 0), 0.78, 4)
    whole = scan_layers(prepare_scan(vertices, faces, GRID), 0, 66).mask
    rng = np.random.default_rng(seed)
    middle = vertices[faces].mean(axis=1)
    keep = np.ones(len(faces), bool)
    for hole in middle[rng.choice(len(faces), 5)]:
        keep &= np.linalg.norm(middle - hole, axis=1) > 0.06
    assert 20 < (~keep).sum() < 200
    found = vote_layers(prepare_three_axis(vertices, faces[keep], GRID), 0, 66)
    assert 0 < found.undecided < 0.05 * whole.sum()
    assert iou(found.mask, whole) > 0.997


def test_overlap_is_united():
    a, b = box_mesh((-0.2, 0, 0), (0.8, 1, 1)), box_mesh((0.2, 0, 0), (0.8, 1, 1))
    vertices, faces = np.concatenate([a[0], b[0]]), np.concatenate([a[1], b[1] + 8])
    one, other = (scan_layers(prepare_scan(*m, GRID), 0, 66).mask for m in (a, b))
    prepared = prepare_three_axis(vertices, faces, GRID)
    np.testing.assert_array_equal(vote_layers(prepared, 0, 66).mask, one | other)


def test_half_of_the_ballots_is_not_enough():
    vertices, faces = box_mesh((0, 0, 0), (1, 1, 1))
    normals = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    box = scan_layers(prepare_scan(vertices, faces, GRID), 0, 66).mask
    tube = faces[normals[:, 1] == 0]  # without the walls across y: no ray along y meets anything
    np.testing.assert_array_equal(vote_layers(prepare_three_axis(vertices, tube, GRID), 0, 66).mask, box)
    channel = faces[(normals[:, 1] == 0) & (normals[:, 0] <= 0)]  # along x only one end says inside: three of six
    assert not vote_layers(prepare_three_axis(vertices, channel, GRID), 0, 66).mask.any()
