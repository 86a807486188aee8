"""Voxel images: phases and fractions."""

import numpy as np
import pytest

from sppm_pipeline.method.nouns.voxels import Voxels


def voxels(values, **changed):
    return Voxels(
        np.asarray(values), **{"spacing": (0.5, 0.5, 0.5), "physical": True, "periodic": (True,) * 3, **changed}
    )


def test_phases_are_counted():
    image = np.zeros((2, 3, 4), np.int64)
    image[0], image[1, 0] = 1, 2
    made = voxels(image)
    made.check()
    assert not made.fractions
    assert made.summary()["porosity"] == pytest.approx(8 / 24)
    assert made.summary()["phases"] == pytest.approx([12 / 24, 4 / 24])
    assert made.solid().sum() == 16
    assert made.values.flags.f_contiguous
    assert not made.values.flags.writeable


def test_fractions_are_summed_up():
    made = voxels(np.full((2, 2, 2), 0.25))
    made.check()
    assert made.fractions
    assert made.summary()["porosity"] == pytest.approx(0.75)
    assert not made.solid().any()


def test_the_input_stays_the_callers():
    image = np.asfortranarray(np.zeros((2, 2, 2), np.uint8))
    made = voxels(image)
    image[:] = 1
    assert not made.values.any()


@pytest.mark.parametrize(
    ("values", "changed"),
    [
        (np.zeros((2, 2)), {}),
        (np.zeros((0, 2, 2)), {}),
        (np.full((1, 1, 1), 1.5), {}),
        (np.full((1, 1, 1), np.nan), {}),
        (np.zeros((1, 1, 1)), {"spacing": (1.0, 0.0, 1.0)}),
    ],
)
def test_contradictions_are_refused(values, changed):
    with pytest.raises(ValueError):
        voxels(values, **changed).check()
