"""Pictures of deformed voxels: their surface, and a view that holds still."""

import numpy as np
import pytest
from sppm_crushing.stages.write_frames import exposed_triangles, frame_pictures

from sppm_pipeline.services.pictures.camera import Camera
from sppm_pipeline.services.pictures.shading import BONE

CORNERS = np.array([[i, j, k] for k in (0, 1) for j in (0, 1) for i in (0, 1)])
GRID = (3, 3, 2)
VOXELS = np.array([v for v in np.ndindex(GRID) if v[:2] != (1, 1)], np.int32)  # a square ring


def elements_of(voxels):
    ids = (voxels[:, None] + CORNERS) @ (1, 4, 16)
    used, numbered = np.unique(ids, return_inverse=True)
    return np.stack([used % 4, used // 4 % 4, used // 16], 1).astype(np.float32), numbered.reshape(len(voxels), 8)


NODES, ELEMENTS = elements_of(VOXELS)


def volume(nodes, triangles):
    a, b, c = (nodes[triangles[:, i]].astype(float) for i in range(3))
    return np.einsum("ij,ij->", a, np.cross(b, c)) / 6


def test_the_surface_bounds_the_voxels_and_knows_their_owners():
    triangles, owners = exposed_triangles(VOXELS, GRID, ELEMENTS)
    assert volume(NODES, triangles) == pytest.approx(16)  # outwards, or it would be negative
    stretched = NODES @ np.array([[1.2, 0.1, 0], [0, 0.9, 0], [0.2, 0, 0.5]])
    assert volume(stretched, triangles) == pytest.approx(16 * 1.2 * 0.9 * 0.5)
    assert len(triangles) == 2 * (2 * 8 + (12 + 4) * 2)
    middles = NODES[triangles].mean(axis=1)
    assert np.abs(middles - VOXELS[owners] - 0.5).max(axis=1) == pytest.approx(0.5)
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()


def pictures(frames, axis="z", section=None, colors=None, released=None):
    colors = colors or [np.tile(np.array(BONE, np.uint8), (len(VOXELS), 1))] * len(frames)
    drawn = frame_pictures(
        VOXELS, GRID, ELEMENTS, np.array(frames, np.float32), iter(colors), axis=axis, camera=Camera(elevation=0.0),
        size=(60, 60), section=section, released=released,
    )  # fmt: skip
    return [picture.astype(int) for picture in drawn]


def covered(picture):
    """Rows and columns that show the body: what is darker than the background."""
    body = np.abs(picture - picture[:, :1]).sum(axis=2) > 30
    return int(body.any(axis=1).sum()), int(body.any(axis=0).sum())


def test_all_frames_are_seen_at_one_scale_with_the_axis_of_compression_upright():
    (high, wide), (low, same) = map(covered, pictures([NODES, NODES * (1, 1, 0.5)]))
    assert low == pytest.approx(high / 2, abs=1)
    assert same == wide
    for axis, scale in (("x", (0.5, 1, 1)), ("y", (1, 0.5, 1))):
        (high, wide), (low, same) = map(covered, pictures([NODES, NODES * scale], axis))
        assert low == pytest.approx(high / 2, abs=1), axis
        assert same == wide


def test_a_section_keeps_a_layer_at_least():
    assert covered(*pictures([NODES], section=1e-300)) == covered(*pictures([NODES], section=1 / 3))


def test_voxels_that_have_failed_are_not_drawn():
    upper = VOXELS[:, 2] == 1
    whole, half, same = pictures([NODES] * 3, released=np.stack([upper & False, upper, upper]))
    (high, wide), (low, as_wide) = covered(whole), covered(half)
    assert low == pytest.approx(high / 2, abs=1)
    assert wide == as_wide
    assert np.array_equal(half, same)


def test_colors_are_those_of_the_voxels_and_a_section_leaves_some_out():
    red = np.tile(np.array((250, 20, 20), np.uint8), (len(VOXELS), 1))
    blue = red[:, ::-1]
    front = VOXELS[:, 1] == 0
    for section, seen in ((None, 0), (2 / 3, 2)):  # the near row of voxels hides the far ones
        (picture,) = pictures([NODES], section=section, colors=[np.where(front[:, None], red, blue)])
        body = np.abs(picture - picture[:, :1]).sum(axis=2) > 30
        channels = picture[body].mean(axis=0)
        assert channels[seen] > 2 * channels[2 - seen], section
