"""Thresholds and labels."""

import numpy as np
import pytest

from sppm_pipeline.services.segmentation import MAX_LABELS, labels_of, otsu


def test_labels_of_a_few_values_and_of_many():
    image = np.zeros((3, 4, 5), np.int16)
    image[1], image[2, 0, 0] = 7, -2
    assert labels_of(image).tolist() == [-2, 0, 7]
    assert labels_of(np.arange(MAX_LABELS + 1).reshape(1, 1, -1)) is None


@pytest.mark.parametrize("scale", [1.0, 255.0, 65535.0])
def test_otsu_splits_two_heaps_between_them(scale):
    rng = np.random.default_rng(1)
    low, high = rng.normal(0.2, 0.03, 7000), rng.normal(0.8, 0.05, 3000)
    cut = otsu(scale * np.concatenate([low, high]))
    assert low.max() * scale < cut < high.min() * scale


def test_otsu_is_the_best_of_all_thresholds():
    """Against the definition: the largest variance between the classes, over all cuts."""
    values = np.random.default_rng(2).integers(0, 50, 500).astype(float)

    def between(cut):
        lower, upper = values[values < cut], values[values >= cut]
        if not len(lower) or not len(upper):
            return 0.0
        return len(lower) * len(upper) * (lower.mean() - upper.mean()) ** 2

    best = max(between(cut) for cut in np.arange(0.5, 50))
    assert between(otsu(values)) == pytest.approx(best, rel=1e-3)


def test_one_value_has_no_classes():
    with pytest.raises(ValueError, match="two classes"):
        otsu(np.ones(5))
