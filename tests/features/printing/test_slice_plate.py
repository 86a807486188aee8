"""Several parts on one plate: each whole, none touched by another, tags beside them."""

import numpy as np
import pytest
from scipy import ndimage

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.printing.stages.slice_plate import SlicePlate, packed, tag
from sppm_pipeline.method.nouns.printer import cards
from sppm_pipeline.method.slicing.slice_stack import SliceStack
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.testing.plain_context import PlainContext


def stack(shape, printer=None, seed=0, pixel=(0.05, 0.1)):
    """Random layers with all borders solid, so that the outline is seen."""
    layers = np.random.default_rng(seed).integers(1, 256, shape).astype(np.uint8)
    return SliceStack.from_array(layers, pixel_mm=pixel, layer_mm=0.1, printer=printer), layers


def test_copies_and_different_parts_keep_their_layers():
    (a, la), (b, lb) = stack((4, 10, 20), seed=1), stack((7, 16, 9), seed=2)
    context = PlainContext()
    plate = SlicePlate(quantity=(3, 2), separation=Length(0.3, "mm")).run(context, (a, b))
    whole = plate.to_numpy()
    assert plate.shape == whole.shape[::-1]
    assert plate.shape[2] == 7
    covered = np.zeros(whole.shape[1:], int)
    for place in context.reported["places"]:
        layers = (la, lb)[place["part"] - 1]
        x, y = round(place["x_mm"] / 0.05), round(place["y_mm"] / 0.1)
        nz, ny, nx = layers.shape
        assert np.array_equal(whole[:nz, y : y + ny, x : x + nx], layers)
        assert not whole[nz:, y : y + ny, x : x + nx].any()
        covered[max(0, y - 3) : y + ny, max(0, x - 6) : x + nx] += 1  # the part and the gap below and before it
    assert len(context.reported["places"]) == 5
    assert covered.max() == 1
    slabs = plate.slabs()
    assert sum(len(slab) for _, slab in slabs) == 7
    expected = (3 * la.sum(dtype=float) + 2 * lb.sum(dtype=float)) / 255 * 0.05 * 0.1 * 0.1
    assert slabs.findings["solid_volume_mm3"] == pytest.approx(expected)
    assert whole.sum(dtype=float) / 255 * 0.05 * 0.1 * 0.1 == pytest.approx(expected)


@pytest.mark.parametrize("seed", range(8))
def test_rectangles_do_not_overlap_and_stay_in_the_room(seed):
    rng = np.random.default_rng(seed)
    sizes = [tuple(map(int, rng.integers(1, 40, 2))) for _ in range(25)]
    gap = (int(rng.integers(0, 5)), int(rng.integers(0, 5)))
    room = (170, 210)
    for bound in (None, room):
        corners, (nx, ny) = packed(sizes, gap, bound)
        board = np.zeros((ny + gap[1], nx + gap[0]), int)
        for (x, y), (sx, sy) in zip(corners, sizes, strict=True):
            board[y : y + sy + gap[1], x : x + sx + gap[0]] += 1
            assert x + sx <= nx
            assert y + sy <= ny
        assert board.max() == 1
        if bound is not None:
            assert nx <= room[0]
            assert ny <= room[1]
    assert packed(sizes, gap, (39, 60)) is None
    assert packed([(50, 1)], gap, (49, 60)) is None


def test_rows_end_at_the_room():
    four = [(10, 10)] * 4
    assert packed(four, (2, 3), (22, 23)) == ([(0, 0), (12, 0), (0, 13), (12, 13)], (22, 23))
    assert packed(four, (2, 3), (21, 100)) == ([(0, 0), (0, 13), (0, 26), (0, 39)], (10, 49))
    assert packed(four, (2, 3), (21, 48)) is None


def test_tags_stand_below_their_parts():
    part, _ = stack((30, 40, 80), seed=5)
    context = PlainContext()
    plate = SlicePlate(quantity=(2,), labels=True).run(context, (part,))
    whole = plate.to_numpy()
    assert ndimage.label(whole[0] > 0)[1] == 4  # two parts, two tags, and none touches another
    assert ndimage.label(whole[5] > 0)[1] >= 4  # letters
    assert (whole[5] > 0).sum() < (whole[0] > 0).sum()
    assert np.array_equal(whole[10] > 0, whole[29] > 0)  # above the tags the parts alone
    letters = np.flatnonzero(tag("1", (0.05, 0.1))[1].any(axis=1))
    assert (letters[-1] - letters[0] + 1) * 0.1 == pytest.approx(3, abs=0.2)
    solid = part.slabs()
    assert len(list(solid)) == 30
    slabs = plate.slabs()
    assert len(list(slabs)) == 30
    assert slabs.findings["solid_volume_mm3"] == pytest.approx(whole.sum(dtype=float) / 255 * 0.05 * 0.1 * 0.1)


def test_what_does_not_go_together():
    printer = cards().printer("prusa_sl1s")
    a, _ = stack((2, 20, 20))
    b, _ = stack((2, 20, 20), printer, pixel=(0.05, 0.05))
    with pytest.raises(DesignError, match="need the same pixels, layers and printer"):
        SlicePlate().run(PlainContext(), (a, b))
    with pytest.raises(ConfigError, match="`quantity` has 3 numbers for 1 part"):
        SlicePlate(quantity=(1, 2, 3)).run(PlainContext(), (a,))
    with pytest.raises(ConfigError, match="`quantity` is empty"):
        SlicePlate(quantity=()).check_options()
    large, _ = stack((2, 800, 800), printer, pixel=(0.05, 0.05))
    six = SlicePlate(quantity=(6,), separation=Length(0)).run(PlainContext(), (large,))
    assert six.printer is printer
    assert (six.extent[0] <= 2560, six.extent[1] <= 1620) == (True, True)
    with pytest.raises(DesignError, match=r"7 parts 0 mm apart do not fit the plate of prusa_sl1s"):
        SlicePlate(quantity=(7,), separation=Length(0)).run(PlainContext(), (large,))
