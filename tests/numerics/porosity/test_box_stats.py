"""Box-plot numbers by hand and by their order."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sppm_pipeline.numerics.porosity.box_stats import box_stats, box_stats_by_group


def test_one_to_nine_with_an_outlier():
    stats = box_stats([9, 1, 2, 3, 4, 5, 6, 7, 8, 30])
    assert (stats.minimum, stats.lower_quartile, stats.median, stats.upper_quartile, stats.maximum) == (
        1,
        3.25,
        5.5,
        7.75,
        30,
    )
    assert (stats.whisker_low, stats.whisker_high, stats.outliers) == (1, 9, (30.0,))
    assert (stats.mean, stats.samples) == (7.5, 10)


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=40))
def test_the_numbers_are_in_order_and_every_sample_is_inside_or_an_outlier(values):
    s = box_stats(values)
    ladder = [s.minimum, s.whisker_low, s.lower_quartile, s.median, s.upper_quartile, s.whisker_high, s.maximum]
    assert ladder == sorted(ladder)
    inside = [v for v in values if s.whisker_low <= v <= s.whisker_high]
    assert len(inside) + len(s.outliers) == s.samples == len(values)
    assert list(s.outliers) == sorted(v for v in values if not s.whisker_low <= v <= s.whisker_high)


def test_groups_come_in_order_of_n():
    groups = box_stats_by_group([30, 10, 30, 10, 20], [3.0, 1.0, 5.0, 2.0, 9.0])
    assert list(groups) == [10, 20, 30]
    assert [g.median for g in groups.values()] == [1.5, 9.0, 4.0]
    assert groups[20].samples == 1


def test_nonsense_is_refused():
    with pytest.raises(ValueError, match="at least one"):
        box_stats([])
    with pytest.raises(ValueError, match="finite"):
        box_stats([1.0, np.inf])
    with pytest.raises(ValueError, match="one length"):
        box_stats_by_group([1, 2], [0.5])
