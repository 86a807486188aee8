"""Streamed distances, throats, thin features and cure-through against whole volumes and closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import ndimage

from sppm_pipeline.features.printing.numerics.openings import (
    Coarsened,
    CureThrough,
    StreamedDistance,
    ThinFeatures,
    Throats,
    coarse_factors,
)
from sppm_pipeline.features.printing.numerics.routes import Depth


def porous(shape, seed=1, share=0.5, sigma=2.0):
    field = ndimage.gaussian_filter(np.random.default_rng(seed).standard_normal(shape), sigma)
    return np.ascontiguousarray(field > np.quantile(field, share)).view(np.uint8)


def streamed(tool, layers):
    return np.array([out.copy() for layer in layers for out in tool.add(layer)] + [o.copy() for o in tool.finish()])


@pytest.mark.parametrize("pitch", [(1.0, 1.0, 1.0), (0.019, 0.024, 0.05)])
@pytest.mark.parametrize("voxels", [1, 3, 7.5])
def test_distances_are_exact_up_to_the_reach(pitch, voxels):
    marked = porous((23, 31, 37), share=0.9)
    reach = voxels * pitch[0]
    found = streamed(StreamedDistance((37, 31), pitch, reach), marked)
    exact = ndimage.distance_transform_edt(1 - marked, sampling=pitch[::-1])
    near = exact <= reach * (1 + 1e-9)
    assert np.sqrt(found[near]) == pytest.approx(exact[near], rel=1e-5)
    assert np.isinf(found[~near]).all()
    assert near.any()


def test_nothing_is_near_nothing():
    found = streamed(StreamedDistance((5, 4), (1, 1, 1), 9.0), np.zeros((3, 4, 5), np.uint8))
    assert found.shape == (3, 4, 5)
    assert np.isinf(found).all()


def test_coarse_voxels_hold_the_majority():
    solid = porous((7, 9, 11))
    factors = coarse_factors((0.02, 0.025, 0.05), 0.075)
    assert factors == (3, 3, 1)
    found = streamed(Coarsened((11, 9), (3, 2, 2)), solid)
    padded = np.pad(solid, ((0, 1), (0, 1), (0, 1)))
    blocks = padded.reshape(4, 2, 5, 2, 4, 3).sum((1, 3, 5))
    assert np.array_equal(found, 2 * blocks >= 12)


@pytest.mark.parametrize("pitch", [(1.0, 1.0, 1.0), (0.8, 0.9, 1.1)])
def test_throats_are_those_of_labels_of_the_eroded_void(pitch):
    solid = porous((40, 44, 48), share=0.45, sigma=2.5)
    solid[:3] = solid[-3:] = solid[:, :3] = solid[:, -3:] = solid[:, :, :3] = solid[:, :, -3:] = 1
    solid[18:24, 18:24, :5] = 0  # a window
    diameters = (1.0, 2.0, 3.5, 5.0, 7.0)
    throats = Throats((48, 44), pitch, diameters)
    for layer in solid:
        throats.add(layer)
    exact = ndimage.distance_transform_edt(1 - solid, sampling=pitch[::-1])
    drained_at = []
    for level in throats.finish():
        roomy = 2 * exact >= (level.diameter + np.mean(pitch)) * (1 - 1e-6)
        labels, _ = ndimage.label(roomy)
        rims = [labels[0], labels[-1], labels[:, 0], labels[:, -1], labels[:, :, 0], labels[:, :, -1]]
        outside = np.unique(np.concatenate([rim.ravel() for rim in rims]))
        assert level.room == roomy.sum()
        assert level.undrained == (roomy & ~np.isin(labels, outside)).sum()
        drained_at.append(level.undrained < level.room)
    # the window is six voxels wide, so a ball of seven stays inside
    assert drained_at[:3] == [True, True, True]
    assert not drained_at[-1]


@pytest.mark.parametrize("throat", [3, 5, 7])
def test_a_shell_with_a_drain_of_known_width(throat):
    solid = np.ones((30, 30, 30), np.uint8)
    solid[5:25, 5:25, 5:25] = 0
    solid[25:, 12 : 12 + throat, 12 : 12 + throat] = 0
    throats = Throats((30, 30), (1, 1, 1), range(1, 10))
    for layer in solid:
        throats.add(layer)
    opens = [level.diameter for level in throats.finish() if not level.undrained]
    assert max(opens) == throat


@pytest.mark.parametrize("diameter", [2.0, 3.0, 4.6])
def test_thin_features_are_what_an_opening_takes_away(diameter):
    solid = porous((24, 30, 34), sigma=1.5)
    thin = ThinFeatures((34, 30), (1, 1, 1), diameter, outside=False)
    for layer in solid:
        thin.add(layer)
    found, total = thin.finish()
    padded = np.pad(solid, 1)
    need = (diameter + 1) / 2 * (1 - 1e-6)
    core = ndimage.distance_transform_edt(padded) >= need
    opened = ndimage.distance_transform_edt(~core) < need
    assert np.array_equal(found, (padded.astype(bool) & ~opened)[1:-1, 1:-1, 1:-1].sum((1, 2)))
    assert np.array_equal(total, solid.sum((1, 2)))


def test_features_smaller_than_a_layer_is_high():
    """No layer waits for another then."""
    solid = porous((5, 12, 14))
    thin = ThinFeatures((14, 12), (1, 1, 9), 1.0, outside=False)
    for layer in solid:
        thin.add(layer)
    found, total = thin.finish()
    assert np.array_equal(total, solid.sum((1, 2)))
    assert len(found) == 5


def test_a_wall_is_thin_up_to_its_width():
    for width in (1, 3, 5):
        wall = np.zeros((40, 40, 20), np.uint8)
        wall[:, :, 8 : 8 + width] = 1
        shares = []
        for diameter in (1.0, 3.0, 5.0, 7.0):
            thin = ThinFeatures((20, 40), (1, 1, 1), diameter, outside=False)
            for layer in wall:
                thin.add(layer)
            found, total = thin.finish()
            shares.append(found[15:25].sum() / total[15:25].sum())
        # only the rims of the wall are rounded off by balls that fit
        assert [share > 0.5 for share in shares] == [d > width for d in (1, 3, 5, 7)]


def print_through(cure_depth, penetration, layer):
    """Depth of cured resin below a thick horizontal ceiling, from the bottom of its lowest layer."""
    return cure_depth + penetration * math.log(1 / (1 - math.exp(-layer / penetration)))


@pytest.mark.parametrize(("penetration", "depth"), [(0.1, 0.1), (0.12, 0.06), (0.05, 0.2)])
def test_below_a_thick_ceiling_cure_goes_as_deep_as_the_closed_form(penetration, depth):
    h = 0.01
    solid = np.zeros((120, 2, 3), np.uint8)
    solid[70:] = 1
    cured = streamed(CureThrough((3, 2), h, penetration, depth), solid)
    clogged = int((cured - solid)[:, 0, 0].sum())
    assert abs(clogged * h - print_through(depth, penetration, h)) <= h
    assert cured.shape == solid.shape
    assert (cured[70:] == 1).all()


def test_print_through_of_a_usual_resin():
    assert print_through(0.1, 0.1, 0.05) == pytest.approx(0.193, abs=5e-4)


def test_a_single_layer_cures_to_its_cure_depth():
    solid = np.zeros((30, 3, 3), np.uint8)
    solid[20, 1, 1] = 1
    cured = streamed(CureThrough((3, 3), 0.02, 0.1, 0.13), solid)
    # layer 20 - j has seen exp(-j h / D_p): cured while j h <= C_d
    assert np.flatnonzero(cured[:, 1, 1]).tolist() == list(range(20 - math.floor(0.13 / 0.02), 21))
    assert cured[:, 0].sum() == 0


def test_the_longest_way_out_is_that_of_steps_through_blocks():
    """Against dilations of what is reached, and a channel that goes back and forth."""
    rng = np.random.default_rng(4)
    for block, porosity in ((1, 0.45), (2, 0.12), (3, 0.05)):
        void = (rng.random((13, 17, 20)) < porosity).astype(np.uint8)
        shape = [-(-n // block) for n in void.shape]
        padded = np.pad(void, [(0, block * m - n) for m, n in zip(shape, void.shape, strict=True)])
        blocks = padded.reshape(shape[0], block, shape[1], block, shape[2], block).max((1, 3, 5)) > 0
        inner = np.zeros(shape, bool)
        inner[1:-1, 1:-1, 1:-1] = True
        reached, steps = blocks & ~inner, 0
        while (more := ndimage.binary_dilation(reached) & blocks).sum() > reached.sum():
            reached, steps = more, steps + 1
        depth = Depth(void.shape[:0:-1], block)
        for layer in void:
            depth.add(layer)
        assert depth.longest() == block * steps > 0
    maze = np.zeros((3, 9, 9), np.uint8)
    maze[1, 1:8:2, 1:8] = 1
    maze[1, 2, 7] = maze[1, 4, 1] = maze[1, 6, 7] = maze[1, 1, 0] = 1
    depth = Depth((9, 9), 1)
    for layer in maze:
        depth.add(layer)
    assert depth.longest() == 4 * 7 + 3
    assert Depth((3, 3), 2).longest() == 0
