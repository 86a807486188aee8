"""Boxes around what moves most, and what is gained by solving them by themselves."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, label

from sppm_pipeline.services.elastic.elastic_level import Moduli
from sppm_pipeline.services.elastic.loaded import HeldBody
from sppm_pipeline.services.elastic.local_solves import SURROUNDINGS, TOLERANCE, correct_locally, moving_boxes
from sppm_pipeline.services.multigrid.solver import CORRECTED

SIZE, EDGES = 32, (1.0, 0.9, 1.2)
USED = np.ones((SIZE + 1,) * 3)


def body_with_flaps():
    """A block held at its base; on it two plates, each over a gap of one voxel on a neck, pressed down."""
    mu = np.zeros((SIZE, SIZE, SIZE))
    mu[: SIZE - 4] = 1.0
    for y, x in ((3, 4), (18, 16)):
        mu[SIZE - 4, y : y + 2, x : x + 2] = 1.0
        mu[SIZE - 3 : SIZE - 1, y : y + 5, x : x + 7] = 1.0
    mu[8:14, 9:20] = 0.5
    fixed = np.zeros((3, SIZE + 1, SIZE + 1, SIZE + 1), bool)
    fixed[:, 0] = True
    loads = np.zeros(fixed.shape)
    loads[2, SIZE - 1, :SIZE, :SIZE] = np.where(mu[SIZE - 2] > 0, -1.0, 0.0)
    loads[2, SIZE - 4, :SIZE, :SIZE] = -1.0
    return Moduli(mu, None, 1.5), fixed, loads


def energy_of(body, loads, u):
    """Twice the energy of displacements under loads."""
    return np.vdot(u, body.forces(u)) - 2 * np.vdot(loads, u)


def test_few_iterations_where_a_load_bends_what_hangs_by_little():
    """A random blob, pressed down at its top: half the iterations, and the same answer."""
    noise = gaussian_filter(np.random.default_rng(1).standard_normal((48, 48, 48)), 2, mode="nearest")
    labels, _ = label(noise > np.quantile(noise, 0.6))
    solid = np.isin(labels, np.unique(labels[0])[1:])
    fixed = np.zeros((3, 49, 49, 49), bool)
    fixed[:, 0] = True
    loads = np.zeros(fixed.shape)
    loads[2, -1, :48, :48] = -1.0 * solid[-1]
    body = HeldBody(Moduli(solid.astype(np.float32), None, 1.5), (1.0, 1.0, 1.0), fixed, np.float32)
    exact = body.solve(loads, energy=1e-6, local=False).displacement
    least = energy_of(body, loads, exact)
    counts = {}
    for local in (True, False):
        found = body.solve(loads, energy=1e-3, local=local)
        assert found.solved.converged
        assert 0 <= energy_of(body, loads, found.displacement) - least < -1e-3 * least
        counts[local] = found.solved.iterations
    assert CORRECTED < counts[True] < 0.65 * counts[False]


def test_gains_and_residuals_are_those_of_the_whole_body():
    moduli, fixed, loads = body_with_flaps()
    body = HeldBody(moduli, EDGES, fixed, np.float64)
    u = body.solve(loads, residual=1e-9, iterations=5, local=False).displacement
    moved = body.solve(loads, residual=1e-9, iterations=30, local=False).displacement - u
    left = np.where(fixed, 0, loads - body.forces(u))
    before = energy_of(body, loads, u)
    gain, rest = correct_locally(
        moduli, fixed, USED, lambda some, held: HeldBody(some, EDGES, held, np.float64),
        left.reshape(-1), u.reshape(-1), moved.reshape(-1),
    )  # fmt: skip
    assert gain == pytest.approx(before - energy_of(body, loads, u), rel=1e-9)
    assert gain > -0.05 * before
    assert 0 < rest < 2 * TOLERANCE * gain
    np.testing.assert_allclose(left, np.where(fixed, 0, loads - body.forces(u)), atol=1e-9)
    assert (u[fixed] == 0).all()


def test_what_moves_as_a_whole_is_left_alone():
    moduli, fixed, _ = body_with_flaps()
    rest = np.zeros(fixed.size)
    z = np.broadcast_to(np.linspace(0, 1, SIZE + 1)[:, None, None], fixed.shape)
    assert moving_boxes(z, USED) == []
    assert correct_locally(moduli, fixed, USED, None, rest, rest.copy(), np.ascontiguousarray(z).reshape(-1)) == (0, 0)
    assert not rest.any()


def test_boxes_hold_what_moves_with_its_surroundings_and_end_at_the_body():
    p = np.zeros((3, 65, 65, 129))  # blocks of five
    p[:, 2, 60, 40] = 1.0
    p[0, 30, 30, 100] = 2.0
    p[0] += 1e-3
    assert SURROUNDINGS == 2
    used = np.ones(p.shape[1:])
    used[50] = 0
    p[1, 50, 10, 10] = 100.0
    assert moving_boxes(p, used) == [((0, 50, 30), (15, 64, 55)), ((20, 20, 90), (45, 45, 115))]
    # along a diagonal the box would be nearly all of the body
    p = np.zeros((3, 33, 33, 33))
    p[0, range(32), range(32), range(32)] = 1.0
    assert moving_boxes(p, np.ones(p.shape[1:])) == []
