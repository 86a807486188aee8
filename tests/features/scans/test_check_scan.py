"""Scans of what was built against their designs, made with known errors."""

import numpy as np
import pytest
from scipy.ndimage import affine_transform, gaussian_filter
from scipy.spatial.transform import Rotation

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.scans.image_field import ImageField
from sppm_pipeline.features.scans.stages.check_scan import CheckScan
from sppm_pipeline.testing.plain_context import PlainContext

N = 48


def field_of(values, physical=True):
    """A field of 0.1 mm a voxel."""
    return ImageField.through(np.asfortranarray(values, np.float32), (0.1,) * 3, physical=physical, periodic=False)


def distance(n):
    """Samples of a smooth random field whose slope at the surface is one, nearly a distance, voxels."""
    values = gaussian_filter(np.random.default_rng(3).normal(size=(n, n, n)), 5, mode="wrap")
    values -= np.quantile(values, 0.45)
    slope = np.sqrt(sum(part**2 for part in np.gradient(values)))
    return values / np.maximum(slope, 0.3 * np.median(slope))


@pytest.fixture(scope="module")
def wide():
    return distance(N + 16)


def compared(design, scan, **options):
    context = PlainContext()
    CheckScan(resolution=N, properties=False, **options).run(context, field_of(design), field_of(scan))
    return context.reported


@pytest.mark.parametrize("grown", [0.0, 0.3, -0.4])
def test_an_offset_turn_and_bias_are_found(wide, grown):
    """Half a voxel and two degrees off, blurred and noisy: thickness to a tenth of a voxel."""
    design = wide[8:-8, 8:-8, 8:-8]
    turn = Rotation.from_rotvec([1.2, 0.0, 1.6], degrees=True).as_matrix()
    middle = np.full(3, (N + 15) / 2)
    moved = affine_transform(wide, turn, middle - turn @ middle + [0.5, -0.3, 0.2], order=3)[8:-8, 8:-8, 8:-8]
    rng = np.random.default_rng(0)
    scan = gaussian_filter(moved - grown / 2 + rng.normal(0, 0.2, moved.shape), 0.7)
    found = compared(design, scan)
    assert found["angle"] == pytest.approx(2, abs=0.1)
    still = compared(design, gaussian_filter(design, 0.7))["thickness_bias"]
    assert (found["thickness_bias"] - still) / 0.1 == pytest.approx(grown, abs=0.1)
    assert abs(still) < 0.01
    assert found["matched"] > 0.95
    assert found["overlap"] > 0.85


def test_a_design_is_its_own_scan(wide):
    design = wide[8:-8, 8:-8, 8:-8]
    found = compared(design, design)
    assert abs(found["thickness_bias"]) < 1e-6
    assert found["angle"] < 1e-3
    assert found["overlap"] == pytest.approx(1, abs=1e-3)
    assert found["porosity"][0] == found["porosity"][1]


def test_what_can_not_be_compared_is_refused(wide):
    design = wide[8:-8, 8:-8, 8:-8]
    with pytest.raises(ConfigError, match="the scan has no physical size"):
        CheckScan(resolution=N).run(PlainContext(), field_of(design), field_of(design, physical=False))
    ball = np.linalg.norm(np.indices((N,) * 3) - N / 2, axis=0)
    with pytest.raises(DesignError, match="can't be registered"):
        CheckScan(resolution=N).run(PlainContext(), field_of(np.maximum(ball - 4, -20)), field_of(ball - 20))
