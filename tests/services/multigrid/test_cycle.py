"""The multigrid cycle and its iteration: Galerkin grids, symmetry, contraction, falling energies, no growth with n."""

import numpy as np
import pytest

from sppm_pipeline.features.flow.numerics.conduction import conduction_hierarchy, conductivity
from sppm_pipeline.features.stiffness.numerics.elasticity import stiffness
from sppm_pipeline.services.elastic.elastic_level import ElasticLevel, Moduli, grids_of
from sppm_pipeline.services.multigrid.hierarchy import coarser
from sppm_pipeline.services.multigrid.rows import APPLY
from sppm_pipeline.services.multigrid.solver import Stop, solve
from sppm_pipeline.services.multigrid.transfer import NodalTransfer, interpolate_add, restrict

PHYSICS = ["conduction", "elasticity"]


def hierarchy_of(physics, image, edges=(1.0, 1.0, 1.0), safe=False):
    if physics == "conduction":
        return conduction_hierarchy(image, edges, np.float64, safe=safe)
    return grids_of(ElasticLevel(Moduli.of(0.7 * image, image), edges, np.float64), safe=safe)


def applied(hierarchy, depth, v, work):
    out = np.empty_like(v)
    hierarchy.levels[depth].apply(APPLY, v, v, out, work)
    return out


def cycled(hierarchy, r, work):
    z, product = hierarchy.cycle(r, work)
    assert product == pytest.approx(r @ z, rel=1e-10)
    return z.copy()


def materials(shape, seed=0, void=0.0):
    rng = np.random.default_rng(seed)
    image = rng.uniform(0.2, 1.0, shape)
    image[rng.random(shape) < void] = 0
    return image


def in_the_range(hierarchy, work, seed):
    """Forces that some displacement balances; others are no right-hand side."""
    level = hierarchy.levels[0]
    v = np.random.default_rng(seed).standard_normal(level.components * level.weight.size)
    return applied(hierarchy, 0, v, work)


@pytest.mark.parametrize("fine", [(8, 6, 4), (5, 7, 9), (12, 1, 3), (16, 15, 14)])
@pytest.mark.parametrize("components", [1, 3])
@pytest.mark.parametrize("open_ends", [False, True])
def test_restriction_is_the_adjoint_of_interpolation(fine, components, open_ends):
    coarse = coarser(fine, open_ends=open_ends)
    assert not open_ends or coarse == tuple(n // 2 + 1 if n > 2 else n for n in fine)
    shapes, rng = NodalTransfer.between(fine, coarse, open_ends=open_ends).shapes, np.random.default_rng(4)
    c, f = rng.standard_normal(components * np.prod(coarse)), rng.standard_normal(components * np.prod(fine))
    up, down, scratch = np.zeros_like(f), np.empty_like(c), np.empty(max(fine) + 3)
    interpolate_add(c, up, shapes, scratch)
    restrict(f, down, shapes, scratch)
    assert up @ f == pytest.approx(c @ down, rel=1e-12)
    ones = np.zeros_like(f)
    interpolate_add(np.ones_like(c), ones, shapes, scratch)
    assert ones == pytest.approx(1)


@pytest.mark.parametrize("physics", PHYSICS)
@pytest.mark.parametrize("edges", [(1.0, 1.0, 1.0), (0.6, 1.0, 1.4)])
def test_the_coarse_operator_is_that_of_galerkin_where_voxels_agree(physics, edges):
    """Trilinear functions of a coarse grid are ones of the fine grid: restricted and interpolated, forces are equal."""
    image = materials((4, 3, 5)).repeat(2, 0).repeat(2, 1).repeat(2, 2)
    hierarchy = hierarchy_of(physics, image, edges)
    work, shapes = hierarchy.workspace(), hierarchy.transfers[0].shapes
    coarse = hierarchy.levels[1]
    v = np.random.default_rng(1).standard_normal(coarse.components * coarse.weight.size)
    fine, forces = np.zeros(8 * v.size), np.empty_like(v)
    interpolate_add(v, fine, shapes, work.line)
    restrict(applied(hierarchy, 0, fine, work), forces, shapes, work.line)
    assert forces == pytest.approx(applied(hierarchy, 1, v, work), rel=1e-11, abs=1e-11)


@pytest.mark.parametrize("physics", PHYSICS)
@pytest.mark.parametrize(("shape", "void"), [((8, 8, 8), 0.0), ((9, 7, 10), 0.0), ((8, 8, 8), 0.3)])
def test_the_cycle_is_symmetric_and_positive(physics, shape, void):
    """Otherwise it is no preconditioner of conjugate gradients."""
    hierarchy = hierarchy_of(physics, materials(shape, 2, void), safe=True)
    work = hierarchy.workspace()
    r, s = (in_the_range(hierarchy, work, seed) for seed in (5, 6))
    zr, zs = cycled(hierarchy, r, work), cycled(hierarchy, s, work)
    assert zr @ s == pytest.approx(r @ zs, rel=1e-10)
    assert zr @ r > 0
    assert zs @ s > 0


@pytest.mark.parametrize("physics", PHYSICS)
@pytest.mark.parametrize("n", [8, 16])
def test_a_cycle_halves_nearly_any_error(physics, n):
    """Power iteration on the error of a cycle, in the energy norm, for a homogeneous body, whatever its size."""
    hierarchy = hierarchy_of(physics, np.ones((n, n, n)))
    work = hierarchy.workspace()
    error = np.random.default_rng(7).standard_normal(hierarchy.levels[0].components * n**3)
    force, factor = applied(hierarchy, 0, error, work), 1.0
    for _ in range(12):
        before = error @ force
        error = error - cycled(hierarchy, force, work)
        force = applied(hierarchy, 0, error, work)
        factor = np.sqrt((error @ force) / before)
    assert factor < 0.6


@pytest.mark.parametrize("physics", PHYSICS)
def test_the_energy_norm_of_the_error_falls_with_every_iteration(physics):
    hierarchy = hierarchy_of(physics, materials((9, 8, 7), 3, 0.2))
    work = hierarchy.workspace()
    b = in_the_range(hierarchy, work, 8)
    u, p = np.empty((2, b.size))

    def solved(iterations):
        rest = b.copy()
        found = solve(hierarchy, rest, u, p, work, Stop(1e-13, 0.0, iterations), 10.0, 1e-6)
        return found, rest, u.copy()

    _, _, exact = solved(200)
    norms = []
    for iterations in range(1, 9):
        found, rest, value = solved(iterations)
        error = exact - value
        norms.append(float(np.sqrt(error @ applied(hierarchy, 0, error, work))))
        # what the iteration keeps account of is what is there
        assert rest == pytest.approx(b - applied(hierarchy, 0, value, work), abs=1e-10 * np.abs(b).max())
        assert found.residual == pytest.approx(np.linalg.norm(rest) / np.linalg.norm(b), rel=1e-8)
        assert found.energy == pytest.approx(10.0 - b @ value, rel=1e-9)
    start = float(np.sqrt(exact @ applied(hierarchy, 0, exact, work)))
    assert (np.diff([start, *norms]) < 0).all()
    assert norms[-1] < 1e-3 * start


def blobs(n, seed=0):
    noise = np.random.default_rng(seed).standard_normal((n, n, n))
    for _ in range(2):
        for axis in range(3):
            noise = noise + np.roll(noise, 1, axis)
    return (noise < np.median(noise)) * 1.0


def test_iterations_do_not_grow_with_the_number_of_voxels():
    """One porous cell on grids of 8, 16 and 32 voxels an axis: a single-level solver would take twice as many each."""
    coarse = blobs(8)
    mechanical, thermal = [], []
    for factor in (1, 2, 4):
        image = coarse.repeat(factor, 0).repeat(factor, 1).repeat(factor, 2)
        thermal.append(max(c.iterations for c in conductivity(image, residual=1e-6, tolerance=0.0).solved))
        found = stiffness(0.6 * image, 0.4 * image, residual=1e-5, tolerance=0.0)
        mechanical.append(max(case.iterations for case in found.solved))
    assert max(thermal) <= 1.3 * thermal[0] + 2
    assert max(mechanical) <= 1.3 * mechanical[0] + 2
