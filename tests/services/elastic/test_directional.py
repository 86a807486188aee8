"""Young's modulus over the sphere."""

import numpy as np
import pytest

from sppm_pipeline.services.elastic.directional import extremes, sphere_mesh, young_along
from sppm_pipeline.services.elastic.voigt import engineering_constants, isotropic, rotated
from tests.conftest import cubic

IRON = cubic(231.4, 134.7, 116.4)


@pytest.mark.parametrize("rounds", [0, 1, 3])
def test_the_sphere_is_closed_and_looks_outward(rounds):
    vertices, faces = sphere_mesh(rounds)
    assert len(faces) == 20 * 4**rounds
    assert len(vertices) == 10 * 4**rounds + 2
    assert np.linalg.norm(vertices, axis=1) == pytest.approx(1)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    assert (np.einsum("ij,ij->i", np.cross(b - a, c - a), a) > 0).all()
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    assert {tuple(edge) for edge in edges} == {tuple(edge[::-1]) for edge in edges}


def test_isotropic_material_is_the_same_everywhere():
    assert young_along(isotropic(3.0, 0.3), sphere_mesh(2)[0]) == pytest.approx(3.0)


def test_axes_agree_with_the_engineering_constants():
    turned = rotated(IRON, np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0])
    assert young_along(turned, np.eye(3)) == pytest.approx(engineering_constants(turned)["E"])


def test_closed_form_for_cubic_symmetry():
    """1/E(n) = S11 - 2 (S11 - S12 - S44/2) (x2 y2 + y2 z2 + x2 z2)."""
    s = np.linalg.inv(IRON)
    n = sphere_mesh(2)[0]
    x, y, z = (n**2).T
    expected = 1 / (s[0, 0] - 2 * (s[0, 0] - s[0, 1] - s[3, 3] / 2) * (x * y + y * z + x * z))
    assert young_along(IRON, n) == pytest.approx(expected)


def test_iron_is_stiffest_along_the_space_diagonal_in_any_frame():
    turn = np.linalg.qr(np.random.default_rng(8).normal(size=(3, 3)))[0]
    s = np.linalg.inv(IRON)
    found = extremes(rotated(IRON, turn))
    value, where = found["max"]
    assert value == pytest.approx(1 / (s[0, 0] - 2 / 3 * (s[0, 0] - s[0, 1] - s[3, 3] / 2)), rel=1e-7)
    assert np.abs(turn.T @ where) == pytest.approx([3**-0.5] * 3, abs=1e-3)
    value, where = found["min"]
    assert value == pytest.approx(1 / s[0, 0], rel=1e-7)
    assert np.sort(np.abs(turn.T @ where)) == pytest.approx([0, 0, 1], abs=1e-3)


def test_a_bar_carries_along_itself_only():
    bar = np.zeros((6, 6))
    bar[0, 0] = 2.0
    assert young_along(bar, np.array([[1.0, 0, 0], [0, 1, 0], [0.6, 0.8, 0]])).tolist() == [2.0, 0.0, 0.0]
