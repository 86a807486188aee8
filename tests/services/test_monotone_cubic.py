import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from sppm_pipeline.services.monotone_cubic import monotone_cubic


@pytest.mark.parametrize("m", [2, 3, 4, 9])
@pytest.mark.parametrize("seed", range(5))
def test_it_is_the_interpolant_of_fritsch_and_butland(m, seed):
    rng = np.random.default_rng(seed)
    x, y = np.cumsum(rng.uniform(0.1, 3, m)), rng.normal(size=m)
    if seed == 0:
        y = np.sort(y)
    if seed == 1:
        y[1:3] = y[1]
    at = np.linspace(x[0], x[-1], 101)
    known = PchipInterpolator(x, y)
    assert monotone_cubic(x, y).at(at) == pytest.approx(known(at), abs=1e-12)
    assert monotone_cubic(x, y).slope_at(at) == pytest.approx(known.derivative()(at), abs=1e-11)


def test_it_rises_where_its_points_do():
    x, y = np.array([0.0, 1, 2, 3, 10]), np.array([0.0, 0, 5, 5.01, 6])
    found = monotone_cubic(x, y).at(np.linspace(0, 10, 1001))
    assert (np.diff(found) >= -1e-12).all()
    assert found.min() >= 0
    assert found.max() <= 6
