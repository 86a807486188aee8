"""Overhang, center of mass and foot, and the colors of the worst layers."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy import ndimage

from sppm_pipeline.features.printing.numerics.layers import (
    CUP,
    ISLAND,
    OVERHANG,
    SOLID,
    TRAP,
    VOID,
    PrintScan,
    convex_hull,
    margin_inside,
    reach_of,
    unsupported,
)
from sppm_pipeline.method.connectivity.runs import find_runs


def scanned(solid, plate="sealed", pixel=(1.0, 1.0), overhang=1.0, pictures=6):
    nz, ny, nx = solid.shape
    scan = PrintScan((nx, ny, nz), pixel, overhang, plate, pictures)
    for layer in np.ascontiguousarray(solid).view(np.uint8):
        scan.add(layer)
    return scan.finish()


def porous(shape, seed=1, share=0.5):
    field = ndimage.gaussian_filter(np.random.default_rng(seed).standard_normal(shape), 1.5)
    return field > np.quantile(field, share)


@pytest.mark.parametrize(("pixel", "distance"), [((1, 1), 1), ((1, 1), 2.3), ((0.019, 0.024), 0.05), ((2, 1), 0.5)])
def test_overhang_is_what_a_disk_around_the_layer_below_leaves(pixel, distance):
    layers = porous((6, 40, 50))
    y, x = np.mgrid[-40:41, -50:51]
    disk = (x * pixel[0]) ** 2 + (y * pixel[1]) ** 2 <= distance**2 * (1 + 1e-9)
    for below, layer in itertools.pairwise(layers):
        apart = [find_runs(np.ascontiguousarray(one[None]).view(np.uint8)) for one in (layer, below)]
        found = unsupported(*apart, reach_of(distance, pixel))
        expected = layer & ~ndimage.binary_dilation(below, disk)
        wanted = find_runs(expected[None].view(np.uint8))
        assert np.array_equal(found.rows, wanted.rows)
        assert np.array_equal(found.bounds, wanted.bounds)


def test_curves_and_center_are_those_of_the_voxels():
    solid = porous((12, 20, 25))
    solid[:2] = False
    found = scanned(solid)
    assert found.ground == 2
    assert np.array_equal(found.curves["area"], solid.sum((1, 2)))
    assert found.center == pytest.approx([i.mean() + 0.5 for i in np.nonzero(solid)[::-1]])
    assert found.curves["overhang"][2] == 0


def test_a_foot_of_known_margin():
    foot = np.zeros((1, 20, 30), np.uint8)
    foot[0, 5:15, 4:24] = 1
    hull = convex_hull(find_runs(foot))
    assert sorted(map(tuple, hull)) == [(4, 5), (4, 15), (24, 5), (24, 15)]
    assert margin_inside(hull, (14, 8)) == 3
    assert margin_inside(hull, (27, 8)) == -3
    foot[0, 0, 29] = 1
    corner = convex_hull(find_runs(foot))
    assert [30.0, 0.0] in corner.tolist()
    assert margin_inside(corner, (14, 8)) == 3 or margin_inside(corner, (14, 8)) > 3


def fates(solid, plate="sealed"):
    """Codes of every layer, by labels of the whole part and of each half-stack."""
    codes = []
    whole, _ = ndimage.label(~solid)
    rims = [whole[:, 0], whole[:, -1], whole[:, :, 0], whole[:, :, -1], whole[-1], whole[0]]
    drained = np.unique(np.concatenate([rim.ravel() for rim in rims]))
    for k, layer in enumerate(solid):
        held, _ = ndimage.label(solid[: k + 1])
        hanging = layer & ~np.isin(held[k], held[0])
        void, _ = ndimage.label(~solid[: k + 1])
        rims = [void[:, 0], void[:, -1], void[:, :, 0], void[:, :, -1], *([void[0]] if plate == "supports" else [])]
        shut = ~layer & ~np.isin(void[k], np.concatenate([rim.ravel() for rim in rims]))
        code = np.where(layer, SOLID, VOID)
        if k:
            over = layer & ~ndimage.binary_dilation(solid[k - 1])
            code[over] = OVERHANG
        code[hanging] = ISLAND
        code[shut] = np.where(np.isin(whole[k], drained), CUP, TRAP)[shut]
        codes.append(code)
    return codes


@pytest.mark.parametrize("plate", ["sealed", "supports"])
def test_colors_of_the_worst_layers(plate):
    solid = np.pad(porous((30, 24, 28), seed=4, share=0.3), ((0, 0), (1, 1), (1, 1)))
    solid[:, 3:-3, 3] = solid[:, 3:-3, -4] = solid[:, 3, 3:-3] = solid[:, -4, 3:-3] = True
    solid[0] = porous((1, 26, 30), seed=9)[0]
    expected = fates(solid, plate)
    found = scanned(solid, plate, pictures=24)
    assert len(found.worst) > 6
    seen = set()
    for k, codes in found.worst:
        assert np.array_equal(codes, expected[k]), k
        seen |= set(np.unique(codes))
    assert seen == {VOID, SOLID, OVERHANG, ISLAND, CUP, TRAP}


def test_the_layer_with_most_cups_is_shown():
    solid = porous((30, 24, 28), seed=4, share=0.3)
    found = scanned(solid, pictures=1)
    assert [k for k, _ in found.worst] == [int(np.argmax(found.curves["sealed"]))]
    assert scanned(solid, pictures=0).worst == []
