"""Matrices, tensors, rotation, compliance and engineering constants."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sppm_pipeline.services.elastic.voigt import (
    compliance,
    engineering_constants,
    from_tensor,
    isotropic,
    mandel,
    null_space,
    rotated,
    tensor,
)


def random_stiffness(seed, rank=6):
    """A random positive stiffness of some rank, in Voigt's notation."""
    rng = np.random.default_rng(seed)
    weight = np.array([1, 1, 1, *(2**0.5,) * 3])
    factor = rng.normal(size=(6, rank))
    return factor @ factor.T / np.outer(weight, weight)


def random_rotation(seed):
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))


def test_isotropic_matrix_is_the_papers():
    young, poisson = 3.0, 0.3
    e_hat = young / ((1 - 2 * poisson) * (1 + poisson))
    made = isotropic(young, poisson)
    assert made[0, 0] == pytest.approx(e_hat * (1 - poisson))
    assert made[0, 1] == pytest.approx(e_hat * poisson)
    assert made[3, 3] == pytest.approx(young / (2 * (1 + poisson)))
    assert np.count_nonzero(made) == 12


@given(seed=st.integers(0, 10**6))
@settings(max_examples=30, derandomize=True, deadline=None)
def test_tensor_and_back(seed):
    stiffness = random_stiffness(seed)
    assert np.allclose(from_tensor(tensor(stiffness)), stiffness, rtol=1e-13)
    assert np.linalg.norm(tensor(stiffness)) == pytest.approx(np.linalg.norm(mandel(stiffness)))


@given(seed=st.integers(0, 10**6))
@settings(max_examples=30, derandomize=True, deadline=None)
def test_rotations_compose_and_keep_eigenvalues(seed):
    stiffness, first, second = random_stiffness(seed), random_rotation(seed + 1), random_rotation(seed + 2)
    assert np.allclose(rotated(rotated(stiffness, first), second), rotated(stiffness, second @ first), rtol=1e-10)
    assert np.allclose(np.linalg.eigvalsh(mandel(rotated(stiffness, first))), np.linalg.eigvalsh(mandel(stiffness)))


def test_a_quarter_turn_swaps_axes():
    stiffness = random_stiffness(3)
    quarter = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])
    turned = rotated(stiffness, quarter)
    assert turned[1, 1] == pytest.approx(stiffness[0, 0])
    assert turned[3, 3] == pytest.approx(stiffness[4, 4])


def test_isotropy_survives_rotation():
    stiffness = isotropic(2.0, 0.25)
    assert np.allclose(rotated(stiffness, random_rotation(1)), stiffness)


def test_compliance_of_a_regular_matrix_is_its_inverse():
    stiffness = random_stiffness(4)
    assert np.allclose(compliance(stiffness), np.linalg.inv(stiffness), rtol=1e-8)


@pytest.mark.parametrize("young", [7.0, 7e-6, 7e11])
def test_constants_of_an_isotropic_material(young):
    """Whatever the unit."""
    found = engineering_constants(isotropic(young, 0.2))
    assert found["E"] == pytest.approx([young] * 3)
    assert found["G"] == pytest.approx([young / 2.4] * 3)
    assert found["nu"][~np.eye(3, dtype=bool)] == pytest.approx([0.2] * 6)
    assert np.isnan(np.diag(found["nu"])).all()


def test_a_bar_along_x_resists_along_x_only():
    bar = np.zeros((6, 6))
    bar[0, 0] = 2.0
    found = engineering_constants(bar)
    assert found["E"].tolist() == [2.0, 0.0, 0.0]
    assert found["G"].tolist() == [0.0, 0.0, 0.0]
    assert np.isnan(found["nu"][1]).all()


def test_no_stiffness_at_all():
    found = engineering_constants(np.zeros((6, 6)))
    assert not found["E"].any()
    assert np.isnan(found["nu"]).all()


def test_a_mechanism_by_rounding_counts_as_one():
    """A plate in x and y: what single precision leaves along z is no stiffness."""
    plate = isotropic(1.0, 0.3)
    plate[2], plate[:, 2] = 0, 0
    plate[2, 2] = 1e-9
    assert engineering_constants(plate)["E"][2] == 0


def test_what_is_soft_is_so_beside_the_stiffest():
    stiffness = np.diag([100.0, 5, 20, 8, 8, 8])
    values, _ = null_space(stiffness, soft=0.1)
    assert values == pytest.approx([0, 16, 16, 16, 20, 100])  # shear counts twice in Mandel's basis
    assert null_space(stiffness, soft=0.01)[0] == pytest.approx([5, 16, 16, 16, 20, 100])
