"""Orientations: directions, turns, and the scan of a turned body against that of a body that was laid out so."""

import numpy as np
import pytest

from sppm_pipeline.features.printing.numerics.layers import PrintScan
from sppm_pipeline.features.printing.stages.tune_orientation import (
    not_dominated,
    score_turned,
    turn_up,
    upward_directions,
)
from sppm_pipeline.services.mesh.rotation import rotation


def scanned(solid, plate):
    """Costs of a body as it lies, with a margin of void."""
    solid = np.pad(solid, 1)
    scan = PrintScan(solid.shape[::-1], (1.0, 1.0), 1.0, plate, pictures=0)
    for layer in solid:
        scan.add(np.ascontiguousarray(layer))
    curves = scan.finish().curves
    height = np.ptp(np.flatnonzero(curves["area"])) + 1
    return curves["overhang"].sum(), curves["sealed"].max(), height, curves["area"].max()


@pytest.fixture
def mug():
    """A mug that is open at +z, with a handle; no side of it is like another."""
    solid = np.zeros((9, 8, 12), np.uint8)
    solid[1:8, 1:7, 1:8] = 1
    solid[2:8, 2:6, 2:7] = 0
    solid[5, 3, 8:11] = 1
    solid[3:6, 3, 10] = 1
    return solid


def test_directions_are_spread_evenly_and_turn_up():
    ups = upward_directions(26)
    assert np.allclose(np.linalg.norm(ups, axis=1), 1)
    assert (upward_directions(6) == ups[:6]).all()
    between = np.degrees(np.arccos(np.clip(ups @ ups.T, -1, 1)))
    np.fill_diagonal(between, 360)
    assert between.min() > 20
    assert np.allclose(ups.sum(0), 0)
    assert np.allclose(ups.T @ ups, 26 / 3 * np.eye(3))  # no direction is preferred
    assert turn_up(ups[0]) == (0, 0, 0)
    for up in ups:
        assert np.allclose(rotation(turn_up(up)) @ up, (0, 0, 1), atol=1e-6)


@pytest.mark.parametrize("plate", ["sealed", "supports"])
def test_quarter_turns_are_exact(mug, plate):
    x, y, z = 2, 1, 0
    laid = {
        (0, 0, 1): mug,
        (0, 0, -1): mug[::-1],
        (1, 0, 0): mug.transpose(x, y, z),
        (-1, 0, 0): mug.transpose(x, y, z)[::-1],
        (0, 1, 0): mug.transpose(y, z, x),
        (0, -1, 0): mug.transpose(y, z, x)[::-1],
    }
    for up, expected in laid.items():
        found = score_turned(mug, turn_up(np.array(up, float)), plate)
        assert tuple(found[:4]) == scanned(expected, plate), up
    cups = [score_turned(mug, turn_up(np.array(up, float)), plate).cups for up in laid]
    # the mug sucks while it opens to the film; the other way up, unless the void opens below; never on its side
    assert cups == [20, 0 if plate == "supports" else 20, 0, 0, 0, 0]


def test_view_is_from_the_front(mug):
    view = score_turned(mug, (0.0, 0.0, 0.0), "sealed").view
    inner = mug[1:8, 1:7, 1:11]  # the box of the body, with a margin around it
    seen = inner.any(1)
    assert (np.isnan(view[1:-1, 1:-1]) == ~seen).all()
    assert np.allclose(view[1:-1, 1:-1][seen], (inner.argmax(1)[seen] + 1) / 8)
    assert np.isnan(view[[0, -1]]).all()


def test_a_ball_is_the_same_in_all_orientations():
    z, y, x = np.indices((32, 32, 32)) - 15.5
    scores = [
        score_turned((x**2 + y**2 + z**2 < 14**2).astype(np.uint8), turn_up(up), "sealed")
        for up in upward_directions(26)
    ]
    assert max(abs(s.height - 28) for s in scores) <= 2
    assert all(s.area == pytest.approx(np.pi * 14**2, rel=0.03) for s in scores)
    assert all(s.cups < 0.02 * s.area for s in scores)  # pits of a few voxels between the stairs of turned surfaces
    # what hangs farther than a voxel is pi/4 - 1/2 of the section; stairs add to it
    assert all(0.18 < s.supports / (np.pi * 14**2) < 0.32 for s in scores)
    for orbit in (slice(0, 6), slice(6, 14), slice(14, 26)):  # which turns of the grid map onto each other
        assert len({s[:4] for s in scores[orbit]}) == 1


def test_not_dominated_against_all_pairs():
    costs = np.random.default_rng(3).integers(0, 4, (40, 3)).astype(float)
    expected = [not any((other <= one).all() and (other < one).any() for other in costs) for one in costs]
    assert not_dominated(costs).tolist() == expected


def test_overhang_counts_beyond_its_reach():
    """A pyramid on its tip that widens by two voxels a layer, by one on a side of each."""
    solid = np.zeros((6, 24, 24), np.uint8)
    for k in range(6):
        solid[k, 11 - 2 * k : 13 + 2 * k, 11 - 2 * k : 13 + 2 * k] = 1
    found = [score_turned(solid, (0.0, 0.0, 0.0), "supports", reach).supports for reach in (1.0, 1.5, 2.0, 3.0)]
    inner, outer = ([(2 + 4 * k + 2 * more) ** 2 for k in range(5)] for more in (1, 2))
    # of each ring the corners are farther than its sides: at reach 1 all but the inner ring without its corners
    assert found[0] == sum(o - i + 4 for i, o in zip(inner, outer, strict=True))
    # a reach of 1.5 takes in the corners of the inner ring, one of 2 the sides of the outer one
    assert found[1] == sum(o - i for i, o in zip(inner, outer, strict=True))
    assert found[2] == 5 * 4 * 3
    assert found[3] == 0
