"""The skin against scipy's exact distance transform, whole and slab by slab."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from sppm_pipeline.method.part.skin import halo_layers, skin_layers


def slow_skin(inside, spacing, thickness):
    distance = ndimage.distance_transform_edt(np.pad(inside, 1), sampling=spacing[::-1])[1:-1, 1:-1, 1:-1]
    return (inside > 0) & (distance <= thickness * (1 + 1e-6))


@settings(derandomize=True, deadline=None, max_examples=60)
@given(
    st.integers(0, 2**32 - 1),
    st.tuples(*[st.sampled_from([0.05, 0.1, 0.07, 1 / 3])] * 3),
    st.floats(0.0, 0.6),
    st.integers(1, 9),
)
def test_slabs_equal_the_distance_transform(seed, spacing, thickness, n):
    rng = np.random.default_rng(seed)
    blobs = ndimage.gaussian_filter(rng.standard_normal((14, 15, 16)), 1.2) > -0.15
    inside = blobs.astype(np.uint8)
    expected = slow_skin(inside, spacing, thickness)
    np.testing.assert_array_equal(skin_layers(inside, spacing, thickness, 0, 0), expected)
    halo = halo_layers(thickness, spacing[2])
    for start in range(0, 14, n):
        stop = min(start + n, 14)
        low, high = max(0, start - halo), min(14, stop + halo)
        part = skin_layers(inside[low:high], spacing, thickness, start - low, high - stop)
        np.testing.assert_array_equal(part, expected[start:stop])


@pytest.mark.parametrize("voxels", [1, 3, 7])
def test_rows_longer_than_a_block(voxels):
    h = 0.1
    z, y, x = (np.arange(n) * h + h / 2 - middle for n, middle in ((30, 1.5), (40, 2.0), (300, 15.0)))
    z, y, x = np.meshgrid(z, y, x, indexing="ij")
    torus, ball = (np.hypot(x, y) - 12) ** 2 + z**2 <= 1.4**2, x**2 + y**2 + z**2 <= 1.9**2
    inside = (torus | ball).astype(np.uint8)
    inside[:, 5:35, 2:140] = 1
    expected = slow_skin(inside, (h, h, h), voxels * h)
    found = skin_layers(inside, (h, h, h), voxels * h, 0, 0)
    np.testing.assert_array_equal(found, expected)
    assert 0 < found.sum() < inside.sum()


def test_a_block_that_fills_its_grid_has_a_skin_all_round():
    skin = skin_layers(np.ones((9, 10, 11), np.uint8), (1.0, 1.0, 1.0), 2.0, 0, 0)
    core = np.zeros((9, 10, 11), np.uint8)
    core[2:-2, 2:-2, 2:-2] = 1
    np.testing.assert_array_equal(skin, 1 - core)


def test_a_thickness_that_is_a_multiple_of_the_voxel_counts_it():
    inside = np.zeros((1, 1, 30), np.uint8)
    inside[..., 5:25] = 1
    wide = np.pad(inside, ((20, 20), (20, 20), (0, 0)), mode="edge")
    for n in range(1, 10):
        assert skin_layers(wide, (0.05,) * 3, n * 0.05, 20, 20)[0, 20].sum() == 2 * n
    assert halo_layers(0.15, 0.05) == 3
    assert halo_layers(0.149, 0.05) == 2


def test_no_thickness_no_skin():
    assert not skin_layers(np.ones((3, 3, 3), np.uint8), (1, 1, 1), 0.0, 0, 0).any()
    assert not skin_layers(np.ones((3, 3, 3), np.uint8), (1, 1, 1), 0.9, 1, 1).any()
