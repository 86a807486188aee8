"""Richardson's extrapolation and its error bars."""

import numpy as np
import pytest

from sppm_pipeline.services.elastic.convergence import richardson


@pytest.mark.parametrize("order", [0.8, 1.0, 2.0, 3.1])
@pytest.mark.parametrize("spacings", [[0.4, 0.2, 0.1], [1 / 32, 1 / 48, 1 / 64]])
def test_a_pure_power_is_extrapolated_exactly(order, spacings):
    limit = np.array([[1.0, -2.0], [0.0, 5.0]])
    slope = np.array([[0.3, 0.1], [0.0, -0.7]])
    found = richardson(spacings, [limit + slope * h**order for h in spacings])
    assert found.observed
    assert found.order == pytest.approx(order, abs=1e-6)
    assert np.allclose(found.value, limit, atol=1e-8)
    assert found.error == pytest.approx(1.25 * np.abs(slope) * spacings[-1] ** order, rel=1e-5)  # Roache's factor


def test_two_grids_take_the_assumed_order_and_a_larger_bar():
    found = richardson([0.2, 0.1], [np.array([1 + 0.04]), np.array([1 + 0.01])])
    assert not found.observed
    assert found.value == pytest.approx([1.0])
    assert found.error == pytest.approx([0.03])


def test_grids_that_do_not_converge_claim_no_limit():
    found = richardson([0.4, 0.2, 0.1], [np.array([1.0]), np.array([1.1]), np.array([0.9])])
    assert not found.observed
    assert found.value == pytest.approx([0.9])
    assert found.error[0] >= 0.6


@pytest.mark.parametrize(("order", "accepted"), [(0.48, False), (0.52, True), (3.9, True), (4.2, False)])
def test_orders_that_no_method_has_are_not_believed(order, accepted):
    found = richardson([0.4, 0.2, 0.1], [np.array([1 + 0.3 * h**order]) for h in (0.4, 0.2, 0.1)])
    assert found.observed == accepted


def test_no_change_means_no_error():
    found = richardson([0.4, 0.2, 0.1], [np.ones(2)] * 3)
    assert found.error.tolist() == [0.0, 0.0]
    assert found.value.tolist() == [1.0, 1.0]


def test_what_is_no_sequence_is_refused():
    with pytest.raises(ValueError, match="fall"):
        richardson([0.1, 0.2], [np.ones(1)] * 2)
    with pytest.raises(ValueError, match="two or three"):
        richardson([0.1], [np.ones(1)])
