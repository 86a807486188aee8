"""Effective stiffness: exact cases, independent codes, symmetries, bounds, order of convergence."""

import json
from pathlib import Path

import numpy as np
import pytest

from sppm_pipeline.features.stiffness.numerics.elasticity import ElasticBody, stiffness
from sppm_pipeline.services.elastic.voigt import from_lame, lame

CELLS = Path(__file__).parent / "cells"
REFERENCE = json.loads((CELLS / "reference.json").read_text())
TIGHT = {"precision": np.float64, "tolerance": 0.0, "residual": 1e-10}


def phases(image, young, poisson):
    """Lamé constants (nz, ny, nx) of an image indexed x, y, z."""
    image = np.asarray(image, int).T
    return lame(np.array(young)[image], np.array(poisson)[image])


def solid(image):
    return phases(image, [0.0, 1.0], [0.3, 0.3])


def blobs(n, share, seed=0, smooth=3):
    """A random two-phase image with features of some voxels."""
    noise = np.random.default_rng(seed).standard_normal((n, n, n))
    for _ in range(smooth):
        for axis in range(3):
            noise = noise + np.roll(noise, 1, axis)
    return noise < np.quantile(noise, share)


def distance(a, b):
    """Largest difference over the geometric mean of the diagonals."""
    root = np.sqrt(np.diag(b))
    return float(np.abs((a - b) / np.outer(root, root)).max())


@pytest.mark.parametrize("name", REFERENCE)
def test_independent_codes(name):
    cell = REFERENCE[name]
    constants = phases(np.load(next(CELLS.glob(f"{name}.npy"))), cell["phase_E"], cell["phase_nu"])
    expected = np.array(cell["C"])
    largest = max(1e-6, np.abs(expected).max())
    tight = stiffness(*constants, **TIGHT)
    assert tight.stiffness == pytest.approx(expected, abs=1e-9 * largest)
    assert all(case.converged and case.residual <= 1e-10 for case in tight.solved)
    single = stiffness(*constants, tolerance=0.0, residual=1e-6)
    assert single.stiffness == pytest.approx(expected, abs=1e-6 * largest)
    default = stiffness(*constants)
    assert default.stiffness == pytest.approx(expected, abs=1e-4 * largest)
    assert default.precision == single.precision == "float32"
    assert max(case.iterations for case in default.solved) < 20


def test_homogeneous_body_needs_no_iteration():
    result = stiffness(*solid(np.ones((7, 5, 6))))
    assert result.stiffness == pytest.approx(from_lame(*lame(1.0, 0.3)), rel=1e-6, abs=1e-7)
    assert all(case.iterations == 0 for case in result.solved)


def test_void_has_no_stiffness():
    result = stiffness(*solid(np.zeros((3, 4, 5))))
    assert not result.stiffness.any()


def laminate(lam, mu, axis):
    """Exact stiffness of layers normal to `axis` (Backus)."""
    normal, others = axis, [a for a in range(3) if a != axis]
    m = lam + 2 * mu
    c = np.zeros((6, 6))
    c[normal, normal] = 1 / np.mean(1 / m)
    ratio = np.mean(lam / m)
    for a in others:
        c[a, normal] = c[normal, a] = ratio * c[normal, normal]
        for b in others:
            inner = 4 * mu * (lam + mu) / m if a == b else 2 * mu * lam / m
            c[a, b] = np.mean(inner) + ratio**2 * c[normal, normal]
    for shear in range(3):
        c[3 + shear, 3 + shear] = np.mean(mu) if shear == axis else 1 / np.mean(1 / mu)
    return c


@pytest.mark.parametrize("axis", range(3))
def test_laminates_are_exact(axis):
    young, poisson = np.array([1.0, 0.05, 0.4, 0.4, 3.0]), np.array([0.3, 0.45, 0.1, -0.2, 0.0])
    shape = [1, 1, 1]
    shape[axis] = 5
    image = np.broadcast_to(np.arange(5).reshape(shape), [5 if a == axis else 3 for a in range(3)])
    expected = laminate(*lame(young, poisson), axis)
    assert stiffness(*phases(image, young, poisson), **TIGHT).stiffness == pytest.approx(expected, abs=1e-9)
    single = stiffness(*phases(image, young, poisson), tolerance=0.0, residual=1e-5)
    assert single.stiffness == pytest.approx(expected, abs=1e-6 * expected.max())


@pytest.mark.parametrize("edges", [(1.0, 1.0, 1.0), (0.5, 1.0, 1.3)])
@pytest.mark.parametrize("shape", [(6, 7, 8), (9, 5, 3)])
def test_materials_with_different_ratios(assembled_stiffness, shape, edges):
    image = np.random.default_rng(3).integers(0, 3, shape)
    constants = phases(image, [1.0, 0.02, 5.0], [0.3, 0.48, -0.3])
    expected = assembled_stiffness(*constants, edges)
    assert distance(stiffness(*constants, edges, **TIGHT).stiffness, expected) < 1e-9
    assert distance(stiffness(*constants, edges).stiffness, expected) < 1e-4


def test_solid_fractions_of_a_porous_cell(assembled_stiffness):
    fraction = np.clip(np.random.default_rng(4).standard_normal((8, 10, 9)) + 0.6, 0, 1)
    constants = lame(fraction, 0.3)
    expected = assembled_stiffness(*constants)
    assert (fraction == 0).mean() > 0.2
    assert distance(stiffness(*constants, **TIGHT).stiffness, expected) < 1e-9


@pytest.mark.parametrize(("n", "share"), [(12, 0.3), (17, 0.3), (21, 0.3), (25, 0.6), (30, 0.6)])
def test_default_tolerance_is_kept(n, share):
    constants = solid(blobs(n, share, seed=n))
    exact, default = stiffness(*constants, tolerance=0.0, residual=1e-6), stiffness(*constants)
    assert all(case.converged for case in (*exact.solved, *default.solved))
    assert distance(default.stiffness, exact.stiffness) < 1e-4


ROTATION = [1, 2, 0, 4, 5, 3]
"""Voigt numbers after x -> y -> z -> x."""


def test_rotated_cell_has_the_rotated_stiffness():
    image = blobs(11, 0.5)[:, :9, :10]
    first = stiffness(*solid(image), **TIGHT).stiffness
    second = stiffness(*solid(image.transpose(2, 0, 1)), **TIGHT).stiffness
    assert second[np.ix_(ROTATION, ROTATION)] == pytest.approx(first, abs=1e-10)
    # a quarter turn about z: x -> y, y -> -x; yz and xz change places, and so do signs of shears
    turned = stiffness(*solid(np.rot90(image, axes=(0, 1))), **TIGHT).stiffness
    order, sign = [1, 0, 2, 4, 3, 5], np.array([1, 1, 1, 1, -1, -1])
    assert (turned * np.outer(sign, sign))[np.ix_(order, order)] == pytest.approx(first, abs=1e-10)


def test_moved_cell_has_the_same_stiffness():
    image = blobs(12, 0.4)
    first = stiffness(*solid(image), **TIGHT).stiffness
    assert stiffness(*solid(np.roll(image, (5, -2, 3), (0, 1, 2))), **TIGHT).stiffness == pytest.approx(
        first, abs=1e-10
    )
    assert stiffness(*solid(np.tile(image, (2, 1, 1))), **TIGHT).stiffness == pytest.approx(first, abs=1e-10)


def test_size_and_unit_do_not_matter():
    lam, mu = solid(blobs(10, 0.5))
    first = stiffness(lam, mu, **TIGHT).stiffness
    scaled = stiffness(lam * 2.1e5, mu * 2.1e5, (1e-3,) * 3, **TIGHT).stiffness
    assert scaled == pytest.approx(2.1e5 * first, rel=1e-8, abs=1e-5)


@pytest.mark.parametrize("seed", range(3))
def test_bounds_of_voigt_and_reuss(seed):
    image = np.random.default_rng(seed).integers(0, 2, (6, 6, 6))
    young, poisson = [1.0, 0.05], [0.2, 0.4]
    found = stiffness(*phases(image, young, poisson), **TIGHT).stiffness
    parts = [from_lame(*lame(e, v)) for e, v in zip(young, poisson, strict=True)]
    shares = [1 - image.mean(), image.mean()]
    upper = sum(s * c for s, c in zip(shares, parts, strict=True))
    lower = np.linalg.inv(sum(s * np.linalg.inv(c) for s, c in zip(shares, parts, strict=True)))
    assert np.linalg.eigvalsh(upper - found)[0] > 0
    assert np.linalg.eigvalsh(found - lower)[0] > 0


def test_partial_voxels_converge_with_second_order():
    def schwarz(n):
        fine = 8
        x = 2 * np.pi * (np.arange(n * fine) + 0.5) / (n * fine)
        field = np.cos(x)[:, None, None] + np.cos(x)[:, None] + np.cos(x)
        return (field < 0).reshape(n, fine, n, fine, n, fine).mean((1, 3, 5))

    c = [stiffness(*lame(schwarz(n), 0.3), **TIGHT).stiffness[0, 0] for n in (8, 16, 32)]
    order = np.log2((c[0] - c[1]) / (c[1] - c[2]))
    assert 1.5 < order < 2.5
    # the limit of finer grids and of body-fitted quadratic tetrahedra
    assert c[2] + (c[2] - c[1]) / 3 == pytest.approx(0.328, abs=0.001)


def test_threads_change_no_bit():
    constants = solid(blobs(14, 0.5))
    results = [stiffness(*constants, threads=threads) for threads in (1, 2, 5)]
    assert len({result.stiffness.tobytes() for result in results}) == 1
    assert results[0].solved == results[1].solved == results[2].solved


def test_a_row_longer_than_a_block():
    image = np.tile(blobs(8, 0.5), (65, 1, 1))[:, :4, :4]
    image[:, 0, 0] = True
    short = np.roll(image[:8], 3, 0)
    long = stiffness(*solid(np.roll(image, 3, 0)), **TIGHT).stiffness
    assert long == pytest.approx(stiffness(*solid(short), **TIGHT).stiffness, abs=1e-9)


def test_parts_that_hang_on_nothing_carry_nothing():
    image = np.zeros((9, 10, 11), bool)
    image[2:5, 3:6, 1:7] = True
    result = stiffness(*solid(image))
    assert not result.stiffness.any()
    plate = np.zeros((8, 8, 8), bool)
    plate[2:5] = True
    alone = stiffness(*solid(plate), **TIGHT).stiffness
    plate[6, 3:6, 3:6] = True
    assert stiffness(*solid(plate), **TIGHT).stiffness == pytest.approx(alone, abs=1e-5)
    assert not alone[0].any()
    assert not alone[4:].any()
    assert alone[1, 1] == pytest.approx(3 / 8 / (1 - 0.3**2), rel=1e-5)


def test_cubes_that_touch_at_edges_and_corners():
    """Hinges: the damping of the smoother has to follow the largest eigenvalue."""
    i = np.indices((12, 12, 12)).sum(0)
    board = i % 2 == 0
    exact, default = stiffness(*solid(board), **TIGHT), stiffness(*solid(board))
    assert all(case.converged for case in (*exact.solved, *default.solved))
    assert distance(default.stiffness, exact.stiffness) < 1e-4


def test_double_precision_takes_over_where_single_fails(monkeypatch):
    """An energy that does not belong to the displacements is noticed, not reported."""

    from sppm_pipeline.services.multigrid import solver

    original = solver.solve

    def spoiled(hierarchy, b, u, *rest):
        solved = original(hierarchy, b, u, *rest)
        if u.dtype == np.float32:
            u += np.random.default_rng(0).standard_normal(u.shape).astype(np.float32)
        return solved

    constants = solid(blobs(8, 0.4))
    expected = stiffness(*constants)
    monkeypatch.setattr(solver, "solve", spoiled)
    result = stiffness(*constants)
    assert result.precision == "float64"
    assert distance(result.stiffness, expected.stiffness) < 2e-4


def test_an_unreachable_residual_ends_without_a_claim():
    result = stiffness(*solid(blobs(8, 0.4)), tolerance=0.0, residual=1e-30, iterations=40)
    assert not all(case.converged for case in result.solved)
    expected = stiffness(*solid(blobs(8, 0.4)), **TIGHT)
    assert distance(result.stiffness, expected.stiffness) < 1e-5


@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf])
def test_nonsense_is_refused(value):
    lam, mu = solid(np.ones((2, 2, 2)))
    mu[0, 0, 0] = value
    with pytest.raises(ValueError, match="finite"):
        stiffness(lam, mu)


def test_shapes_must_agree():
    with pytest.raises(ValueError, match="axes"):
        stiffness(np.ones((2, 2)), np.ones((2, 2)))


@pytest.mark.parametrize("edges", [(1.0, 1.0, 1.0), (1.0, 1.0, 2.4), (3.0, 1.0, 1.0), (1.0, 3.0, 3.0)])
def test_elongated_voxels_need_no_second_attempt(cell, edges, monkeypatch):
    """A smoother damped by an estimate diverged on the last of these, in single as in double precision."""
    from sppm_pipeline.features.stiffness.numerics import elasticity
    from sppm_pipeline.features.stiffness.stages.homogenize_voxel import HomogenizeVoxel

    attempts, grids_of = [], elasticity.grids_of
    monkeypatch.setattr(
        elasticity, "grids_of", lambda *given, **options: attempts.append(1) or grids_of(*given, **options)
    )
    share = HomogenizeVoxel(resolution=24).sampled(cell, 1).fraction.T
    lam, mu = lame(1.0, 0.3)
    found = elasticity.stiffness(lam * share, mu * share, edges)
    assert len(attempts) == 1
    assert found.precision == "float32"
    assert max(case.iterations for case in found.solved) <= 22


@pytest.mark.parametrize("shape", [(12, 4, 4), (4, 20, 8), (8, 9, 36)])
@pytest.mark.parametrize("seed", range(2))
def test_a_shear_that_the_coarsest_grids_can_not_have_moves_nothing(shape, seed):
    """Across a single voxel its forces are rounding, of which a start from there made translations of any size."""
    image = (np.random.default_rng(seed).random(shape) < 0.7).astype(np.float32)
    share = (image + np.roll(image, 1, 0) + np.roll(image, 1, 1)) / 3
    found = ElasticBody.of(1.5 * share, share).stiffness(fields=True, tolerance=1e-3)
    assert found.precision == "float32"
    assert max(step * np.abs(packed.astype(float)).max() for packed, step in found.fields) < 5
