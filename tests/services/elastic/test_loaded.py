"""Bodies that are held and loaded: against an assembled matrix, exact solutions, and the theory of beams and bars."""

import numpy as np
import pytest
import scipy.sparse as sparse
from scipy.sparse.linalg import spsolve

from sppm_pipeline.services.elastic.elastic_level import Moduli
from sppm_pipeline.services.elastic.loaded import HeldBody, brick_strains, packed, strains_of, unpacked, von_mises
from sppm_pipeline.services.elastic.voigt import from_lame, lame

EDGES = (1.0, 0.8, 1.3)


def corner(a):
    return a >> 2, a >> 1 & 1, a & 1


def element(matrix, edges):
    """A brick by two Gauss points along each axis, corners i + 2 j + 4 k: written apart from what is tested."""
    h, points, found = np.array(edges), (-1 / np.sqrt(3), 1 / np.sqrt(3)), np.zeros((24, 24))
    signs = np.array([corner(a)[::-1] for a in range(8)]) * 2 - 1
    for point in np.stack(np.meshgrid(points, points, points), -1).reshape(-1, 3):
        terms = 1 + signs * point
        slope = np.stack([signs[:, d] * np.prod(np.delete(terms, d, 1), 1) / 8 * 2 / h[d] for d in range(3)])
        b = np.zeros((6, 8, 3))
        for d in range(3):
            b[d, :, d] = slope[d]
        for row, (d, e) in {3: (1, 2), 4: (0, 2), 5: (0, 1)}.items():
            b[row, :, d], b[row, :, e] = slope[e], slope[d]
        b = b.reshape(6, 24)
        found += b.T @ matrix @ b * h.prod() / 8
    return found


def assembled(matrices, edges):
    """Sparse stiffness of voxels (nz, ny, nx, 6, 6); unknowns are components, then nodes."""
    shape = np.array(matrices.shape[:3])
    nodes = np.arange(np.prod(shape + 1)).reshape(shape + 1)
    rows, columns, values = [], [], []
    for place in np.argwhere(matrices[..., 0, 0] > 0):
        own = [nodes[tuple(place + corner(a))] for a in range(8)]
        unknowns = np.array([c * nodes.size + n for n in own for c in range(3)])
        rows.append(np.repeat(unknowns, 24))
        columns.append(np.tile(unknowns, 24))
        values.append(element(matrices[tuple(place)], edges).reshape(-1))
    size = 3 * nodes.size
    return sparse.csr_matrix((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), (size, size))


def random_body(shape=(5, 4, 7), seed=0):
    """Voxels of any stiffness, a fifth of them void, on a solid plate at the low end of x."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((*shape, 6, 6))
    matrices = root @ root.swapaxes(-1, -2) + 3 * np.eye(6)
    matrices[rng.random(shape) < 0.2] = 0
    matrices[:, :, 0] = 5 * np.eye(6)
    fixed = np.zeros((3, *(n + 1 for n in shape)), bool)
    fixed[:, :, :, 0] = True
    fixed[1, -1] = True  # along one axis only
    return matrices, fixed, rng


def test_forces_are_those_of_the_assembled_matrix():
    matrices, fixed, rng = random_body()
    body, u = HeldBody(packed(matrices), EDGES, fixed, np.float64), rng.standard_normal(fixed.shape)
    expected = assembled(matrices, EDGES) @ u.reshape(-1)
    assert body.forces(u).reshape(-1) == pytest.approx(expected, rel=1e-12, abs=1e-11)


def test_what_given_displacements_store_is_as_exact_as_what_loads_do():
    """Not in parts of what one layer of voxels would store, if it took all of the displacement: 200 times as much."""
    shape = (48, 12, 12)
    solid = np.random.default_rng(2).random((24, 6, 6)) < 0.7
    solid = solid.repeat(2, 0).repeat(2, 1).repeat(2, 2)
    fixed = np.zeros((3, *(n + 1 for n in shape)), bool)
    fixed[:, [0, -1]] = True
    given = np.zeros(fixed.shape)
    given[2, -1] = 0.1
    body = HeldBody(Moduli.of(*(value * solid for value in lame(1.0, 0.3))), EDGES, fixed, np.float64)

    def stored(**stop):
        u = body.solve(np.zeros(fixed.shape), given, **stop).displacement
        return float((u * body.forces(u)).sum())

    assert stored(residual=0.0, energy=1e-3) == pytest.approx(stored(residual=1e-10), rel=1e-3)


@pytest.mark.parametrize("general", [True, False])
def test_solutions_are_those_of_the_assembled_matrix(general):
    """Loads and given displacements together, to 1e-8."""
    matrices, fixed, rng = random_body()
    solid = matrices[..., 0, 0] > 0
    moduli = packed(matrices)
    if not general:
        mu = np.where(solid, rng.random(solid.shape) + 0.2, 0)
        moduli = Moduli(mu, None, 1.5)
        matrices = np.array([from_lame(1.5 * m, m) for m in mu.reshape(-1)]).reshape(matrices.shape)
    stiffness = assembled(matrices, EDGES)
    bears = (stiffness.diagonal() > 0).reshape(fixed.shape)
    loads = np.where(fixed | ~bears, 0, rng.standard_normal(fixed.shape))
    given = np.where(fixed, 0.1 * rng.standard_normal(fixed.shape), 0)
    found = HeldBody(moduli, EDGES, fixed, np.float64).solve(loads, given, residual=1e-12)
    free = np.flatnonzero((bears & ~fixed).reshape(-1))
    expected = given.reshape(-1).copy()
    right = loads.reshape(-1) - stiffness @ expected
    expected[free] = spsolve(stiffness[free][:, free].tocsc(), right[free])
    assert found.solved.converged
    assert found.displacement.reshape(-1)[free] == pytest.approx(expected[free], rel=1e-8, abs=1e-8)
    _, second = strains_of(found.displacement, solid, EDGES)
    energy = float((packed(matrices)[:, solid] * second).sum())
    assert energy == pytest.approx(expected @ (stiffness @ expected), rel=1e-8)


def test_the_cycle_is_symmetric_where_nodes_are_held():
    """Conjugate gradients need that; a coarse grid whose held nodes answer breaks it."""
    matrices, fixed, rng = random_body((9, 8, 11))
    body = HeldBody(packed(matrices), (1.0, 1.0, 1.0), fixed, np.float64)
    work = body.hierarchy.workspace()

    def vector():
        v = np.where(body.fixed, 0, rng.standard_normal(fixed.shape))
        return np.where(body.fixed, 0, body.forces(v)).reshape(-1)

    one, two = vector(), vector()
    first = body.hierarchy.cycle(one.copy(), work)[0].copy()
    second = body.hierarchy.cycle(two.copy(), work)[0].copy()
    assert two @ first == pytest.approx(one @ second, rel=1e-10)


def test_a_linear_field_is_exact():
    """Patch test: given at the border of a block, a linear field is found inside, with its stress everywhere."""
    slope = np.random.default_rng(3).standard_normal((3, 3))
    shape, h = (4, 3, 5), np.array(EDGES)
    z, y, x = np.meshgrid(*(np.arange(n + 1) for n in shape), indexing="ij")
    places = np.stack([x, y, z]) * h[:, None, None, None]
    field = np.tensordot(slope, places, 1)
    border = np.ones(x.shape, bool)
    border[1:-1, 1:-1, 1:-1] = False
    fixed = np.broadcast_to(border, field.shape)
    lam, mu = lame(7.0, 0.3)
    body = HeldBody(Moduli(np.full(shape, mu), None, lam / mu), EDGES, np.array(fixed), np.float64)
    found = body.solve(np.zeros(field.shape), field, residual=1e-12).displacement
    assert found == pytest.approx(field, abs=1e-10)
    mean, _ = strains_of(found, np.ones(shape, bool), EDGES)
    strain = (slope + slope.T) / 2
    voigt = [*np.diag(strain), 2 * strain[1, 2], 2 * strain[0, 2], 2 * strain[0, 1]]
    assert mean == pytest.approx(np.tile(np.array(voigt)[:, None], 60), abs=1e-10)
    out = np.empty(shape, np.float32)
    von_mises(found, np.full(shape, mu), h, out)
    stress = lam * np.trace(strain) * np.eye(3) + 2 * mu * strain
    deviator = stress - np.trace(stress) / 3 * np.eye(3)
    assert out == pytest.approx(np.sqrt(1.5 * (deviator**2).sum()), rel=1e-6)


def tip(n, slender, force):
    """Compliance of a cantilever of n x n elements across under a total force at its free end; E = 1, nu = 0."""
    shape = (n, n, slender * n)
    fixed = np.zeros((3, n + 1, n + 1, slender * n + 1), bool)
    fixed[:, :, :, 0] = True
    loads = np.zeros(fixed.shape)
    weights = np.ones(n + 1)
    weights[[0, -1]] = 0.5
    loads[force, :, :, -1] = np.outer(weights, weights) / n**2
    body = HeldBody(Moduli(np.full(shape, 0.5), None, 0.0), (1.0, 1.0, 1.0), fixed, np.float64)
    return float((loads * body.solve(loads, residual=1e-8).displacement).sum())


def test_cantilever_converges_to_timoshenko():
    """With no contraction a clamp is what the theory says: bending and shear, kappa = 5/6, to 1 %, of second order."""
    slender, errors = 6, []
    for n in (2, 4, 8):
        length = float(slender * n)
        inertia, area = n**4 / 12, n**2
        theory = length**3 / (3 * inertia) + length / (5 / 6 * area * 0.5)
        errors.append(1 - tip(n, slender, 2) / theory)
    assert errors[2] == pytest.approx(0, abs=0.01)
    assert 3 < errors[0] / errors[1] < 5
    assert 3 < errors[1] / errors[2] < 6


def test_pull_is_exact():
    assert tip(3, 4, 0) == pytest.approx(12 / 9, rel=1e-7)


def test_torsion_converges_to_saint_venant():
    """A square bar whose ends turn as given and may warp: torque 0.140577 G a^4 per twist (series of Saint-Venant)."""
    errors = []
    for n in (4, 8, 16):
        length, g = 2, 0.5
        shape = (n, n, length)
        z, y, x = np.meshgrid(*(np.arange(m + 1.0) for m in shape), indexing="ij")
        y, z = y - n / 2, z - n / 2
        fixed = np.zeros((3, *x.shape), bool)
        fixed[1:, :, :, [0, -1]] = True
        fixed[0, n // 2, n // 2, 0] = True  # along x and that alone
        given = np.zeros(fixed.shape)
        given[1, :, :, -1], given[2, :, :, -1] = -z[:, :, -1], y[:, :, -1]
        body = HeldBody(Moduli(np.full(shape, g), None, 0.0), (1.0, 1.0, 1.0), fixed, np.float64)
        u = body.solve(np.zeros(fixed.shape), given, residual=1e-9).displacement
        forces = body.forces(u)
        torque = (forces[2, :, :, -1] * y[:, :, -1] - forces[1, :, :, -1] * z[:, :, -1]).sum()
        errors.append(torque / (0.140577 * g * n**4 / length) - 1)
    assert errors[2] == pytest.approx(0, abs=0.01)
    assert 3 < errors[1] / errors[2] < 5


def test_reactions_balance_the_loads():
    matrices, fixed, rng = random_body()
    loads = np.where(fixed, 0, rng.standard_normal(fixed.shape))
    solid = assembled(matrices, EDGES).diagonal().reshape(fixed.shape) > 0
    loads = np.where(solid, loads, 0)
    body = HeldBody(packed(matrices), EDGES, fixed, np.float64)
    u = body.solve(loads, residual=1e-12).displacement
    reaction = np.where(fixed, body.forces(u) - loads, 0)
    assert reaction.sum(axis=(1, 2, 3)) == pytest.approx(-loads.sum(axis=(1, 2, 3)), abs=1e-8)


def test_constants_are_packed_and_unpacked():
    matrices, _, _ = random_body((2, 2, 2))
    assert unpacked(packed(matrices)) == pytest.approx(matrices)


def test_strains_of_a_brick_have_its_energy():
    strains, weights = brick_strains(EDGES)
    root = np.random.default_rng(5).standard_normal((6, 6))
    matrix = root @ root.T
    found = np.einsum("m,mai,ab,mbj->ij", weights, strains, matrix, strains)
    assert found == pytest.approx(element(matrix, EDGES), rel=1e-12, abs=1e-12)


def test_a_start_saves_iterations_and_changes_nothing():
    matrices, fixed, rng = random_body((8, 8, 8))
    solid = assembled(matrices, EDGES).diagonal().reshape(fixed.shape) > 0
    loads = np.where(solid & ~fixed, rng.standard_normal(fixed.shape), 0)
    body = HeldBody(packed(matrices), EDGES, fixed, np.float64)
    cold = body.solve(loads, residual=1e-10)
    warm = HeldBody(packed(1.01 * matrices), EDGES, fixed, np.float64).solve(
        loads, start=cold.displacement, residual=1e-10
    )
    assert warm.solved.iterations < cold.solved.iterations
    assert np.where(solid, 1.01 * warm.displacement, 0) == pytest.approx(
        np.where(solid, cold.displacement, 0), abs=1e-8
    )


def test_a_loaded_body_is_that_of_scikit_fem():
    """The same bricks in another program's assembly and direct solver: displacements to 1e-8."""
    from skfem import Basis, BilinearForm, ElementHex1, ElementVector, MeshHex, condense, solve
    from skfem.helpers import ddot, eye, sym_grad, trace

    rng, n = np.random.default_rng(3), (6, 4, 5)  # x, y, z
    solid = rng.random(n[::-1]) < 0.8
    solid[:, :, 0] = solid[2, 2] = True
    fixed = np.zeros((3, *(m + 1 for m in n[::-1])), bool)
    fixed[..., 0] = True
    mesh = MeshHex.init_tensor(*(np.linspace(0, m * h, m + 1) for m, h in zip(n, EDGES, strict=True)))
    x, y, z = (np.floor(mesh.p[d, mesh.t].mean(axis=0) / EDGES[d]).astype(int) for d in range(3))
    basis = Basis(mesh, ElementVector(ElementHex1()), elements=np.flatnonzero(solid[z, y, x]))

    @BilinearForm
    def energy(u, v, _):
        strain = sym_grad(u)
        return ddot(2 * 0.7 * strain + 1.1 * eye(trace(strain), 3), sym_grad(v))

    matrix = energy.assemble(basis)
    nodes = np.rint(mesh.p / np.array(EDGES)[:, None]).astype(int)
    loads = rng.standard_normal(fixed.shape)
    bears = (matrix.diagonal() > 0)[basis.nodal_dofs]  # (3, nodes)
    held = fixed[:, nodes[2], nodes[1], nodes[0]] | ~bears
    given = np.where(held, 0, loads[:, nodes[2], nodes[1], nodes[0]])
    right = np.zeros(matrix.shape[0])
    right[basis.nodal_dofs] = given
    expected = solve(*condense(matrix, right, D=basis.nodal_dofs[held]))
    ours = np.zeros(fixed.shape)
    ours[:, nodes[2], nodes[1], nodes[0]] = given
    body = HeldBody(Moduli(np.where(solid, 0.7, 0.0), None, 1.1 / 0.7), EDGES, fixed, np.float64)
    found = body.solve(ours, np.zeros(fixed.shape), residual=1e-12).displacement[:, nodes[2], nodes[1], nodes[0]]
    assert found[~held] == pytest.approx(expected[basis.nodal_dofs][~held], rel=1e-8, abs=1e-8)
