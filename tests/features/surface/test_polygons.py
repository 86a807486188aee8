"""Polygons with rim points in a cube: triangles that hold together, and that nothing crosses."""

from __future__ import annotations

import numpy as np
import pytest

from sppm_pipeline.features.surface.numerics.polygons import crossing, fans_from_ends

ANGLES = np.linspace(0, 2 * np.pi, 6, endpoint=False)
HEXAGON = np.stack([np.cos(ANGLES), np.sin(ANGLES), 0 * ANGLES], axis=1)
ORDER = np.arange(6)


def fans(places, masks, single=False):
    triangles = np.empty((12, 3), np.int64)
    made = fans_from_ends(ORDER, 6, single, places, np.asarray(masks), 0, triangles)
    return triangles[:made]


@pytest.mark.parametrize("single", [False, True])
def test_triangles_cover_a_polygon(single):
    triangles = fans(HEXAGON, 1 << ORDER, single)
    t = HEXAGON[triangles]
    areas = np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0])[:, 2] / 2
    assert (areas > 0).all()
    assert areas.sum() == pytest.approx(1.5 * np.sqrt(3))
    ends = (triangles == 0) if single else (triangles == 0) | (triangles == 5)
    assert ends.any(axis=1).all()
    assert not crossing(triangles, len(triangles), HEXAGON)


def test_the_least_area_is_chosen():
    places = HEXAGON.copy()
    places[[0, 2], 2] = 5.0  # a fan around 0 is less bent than one around 5, but for corner 3 and 4
    chosen = fans(places, 1 << ORDER)

    def area(turn):
        made = [(t, t + 1, 0 if t < turn else 5) for t in range(1, 4)] + [(0, turn, 5)]
        t = places[np.array(made)]
        return np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1).sum()

    t = places[chosen]
    found = np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1).sum()
    assert found == pytest.approx(min(area(turn) for turn in range(1, 5)))


def test_no_diagonal_lies_in_a_face_of_the_cube():
    masks = 1 << ORDER
    masks[0] |= masks[2]
    assert not (fans(HEXAGON, masks) == np.array([1, 2, 0])).all(axis=1).any()
    assert len(fans(HEXAGON, masks, single=True)) == 0
    assert len(fans(HEXAGON, np.ones(6, np.int64))) == 0


def test_crossing_triangles_are_seen():
    places = np.array([[0, 0, 0], [2, 0, 0], [0, 2, 0], [0.5, 0.5, -1], [0.5, 0.5, 1], [3, 3, 0]], float)
    assert crossing(np.array([[0, 1, 2], [3, 4, 5]]), 2, places)
    assert not crossing(np.array([[0, 1, 2], [3, 4, 5]]), 1, places)
    assert not crossing(np.array([[0, 1, 2], [1, 5, 2]]), 2, places)
