"""Homogenization on tetrahedra: exact cases, faces that match and that do not, convergence."""

from itertools import permutations

import numpy as np
import pytest
from scipy.sparse import bsr_matrix, coo_matrix, csr_matrix, identity, kron, vstack
from scipy.sparse.linalg import splu
from sppm_tetrahedra.numerics.mortar import collocation, face_pairs, mortar
from sppm_tetrahedra.numerics.tetrahedral import (
    Projector,
    aggregation,
    homogenize_tetrahedra,
    interpolation,
    rigid_modes,
    tied,
)
from sppm_tetrahedra.numerics.tetrahedral_blocks import Blocks, assemble
from sppm_tetrahedra.volume_mesh import matched_nodes

from sppm_pipeline.services.elastic.voigt import PAIRS, isotropic, lame, rotated

BOX = np.array([[0, 0, 0], [1, 1, 1.0]])


def cube(n, order=1):
    """Six tetrahedra in each of n^3 cubes (Kuhn), of one sense."""
    axis = np.arange(n + 1)
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    number = {tuple(p): i for i, p in enumerate(grid)}
    cells = []
    for corner in np.stack(np.meshgrid(*[np.arange(n)] * 3, indexing="ij"), -1).reshape(-1, 3):
        for way in permutations(range(3)):
            at, path = corner.copy(), [number[tuple(corner)]]
            for axis_ in way:
                at[axis_] += 1
                path.append(number[tuple(at)])
            cells.append(path)
    return quadratic(oriented(grid / n, np.array(cells)), order)


def oriented(nodes, cells):
    a, b, c, d = (nodes[cells[:, k]] for k in range(4))
    flipped = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) < 0
    cells[flipped] = cells[flipped][:, [0, 2, 1, 3]]
    return nodes, cells.astype(np.int32)


def quadratic(mesh, order):
    nodes, cells = mesh
    if order == 1:
        return nodes, cells
    edges = [(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)]
    ends = np.sort(np.concatenate([cells[:, e] for e in map(list, edges)]), axis=1)
    unique, at = np.unique(ends, axis=0, return_inverse=True)
    mids = at.reshape(6, -1).T + len(nodes)
    return np.concatenate([nodes, nodes[unique].mean(1)]), np.concatenate([cells, mids], 1).astype(np.int32)


def homogenized(nodes, cells, young, poisson=0.3, matched=True, **options):
    e = np.broadcast_to(np.asarray(young, float), len(cells))
    nu = np.broadcast_to(np.asarray(poisson, float), len(cells))
    stand_in = matched_nodes(nodes, BOX) if matched else None
    return homogenize_tetrahedra(nodes, cells, BOX, e, nu, stand_in, **options)


def middles(nodes, cells):
    return nodes[cells[:, :4]].mean(axis=1)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("matched", [True, False])
def test_a_homogeneous_cell_is_its_material(order, matched):
    nodes, cells = cube(3, order)
    moved = nodes.copy()
    inner = ((nodes > 0.01) & (nodes < 0.99)).all(axis=1)
    if order == 1:
        moved[inner] += np.random.default_rng(0).uniform(-0.05, 0.05, (int(inner.sum()), 3))
    found = homogenized(moved, cells, 2.0, matched=matched)
    assert found.stiffness == pytest.approx(isotropic(2.0, 0.3), abs=1e-9)
    assert found.solid == pytest.approx(1)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("order", [1, 2])
def test_a_laminate_is_exact(axis, order):
    """Backus: the normal strain jumps with the layers, which these cells follow."""
    nodes, cells = cube(4, order)
    stiff = middles(nodes, cells)[:, axis] < 0.5
    found = homogenized(nodes, cells, np.where(stiff, 1.0, 0.1), np.where(stiff, 0.3, 0.2)).stiffness
    phases = [isotropic(1.0, 0.3), isotropic(0.1, 0.2)]
    normal = 1 / np.mean([1 / c[0, 0] for c in phases])
    assert found[axis, axis] == pytest.approx(normal, rel=1e-7)
    others = [a for a in range(3) if a != axis]
    shear_through = 1 / np.mean([1 / c[3, 3] for c in phases])
    for a in others:
        assert found[3 + a, 3 + a] == pytest.approx(shear_through, rel=1e-7)
        ratio = np.mean([c[0, 1] / c[0, 0] for c in phases])
        assert found[axis, a] == pytest.approx(normal * ratio, rel=1e-7)
        along = np.mean([c[0, 0] - c[0, 1] ** 2 / c[0, 0] for c in phases]) + normal * ratio**2
        assert found[a, a] == pytest.approx(along, rel=1e-7)
    assert found[3 + axis, 3 + axis] == pytest.approx(np.mean([c[3, 3] for c in phases]), rel=1e-7)


def block_in_a_corner(n, order=1, share=0.5):
    """A stiff block around the corner of the cell: it crosses every face."""
    nodes, cells = cube(n, order)
    apart = np.abs(np.mod(middles(nodes, cells) + 0.5, 1) - 0.5)
    return nodes, cells, np.where((apart < share / 2).all(axis=1), 10.0, 1.0)


def test_moving_the_cell_changes_nothing():
    """The same block in the middle: only where the seam lies differs."""
    nodes, cells, young = block_in_a_corner(4, 2)
    middle = np.where((np.abs(middles(nodes, cells) - 0.5) < 0.25).all(axis=1), 10.0, 1.0)
    first, second = homogenized(nodes, cells, young), homogenized(nodes, cells, middle)
    assert first.stiffness == pytest.approx(second.stiffness, rel=1e-6)


def skewed(nodes, strength):
    """Nodes moved along the box's faces, and by different amounts on opposite ones; edges of the box stay."""
    x, y, z = nodes.T
    bump = np.sin(2 * np.pi * nodes)
    moved = nodes.copy()
    moved[:, 1] += strength * x**2 * bump[:, 1] * np.sin(np.pi * z)
    moved[:, 2] += strength * y**2 * bump[:, 2] * np.sin(np.pi * x)
    moved[:, 0] += strength * z**2 * bump[:, 0] * np.sin(np.pi * y)
    return moved


@pytest.mark.parametrize("order", [1, 2])
def test_faces_that_do_not_match_pass_the_patch_test_by_the_mortar(order):
    nodes, cells = cube(4)
    nodes, cells = quadratic((skewed(nodes, 0.04), cells), order)
    assert not np.isin(matched_nodes(nodes, BOX)[nodes[:, 0] > 0.999], np.flatnonzero(nodes[:, 0] < 0.001)).all()
    found = homogenized(nodes, cells, 2.0, matched=False)
    assert found.constraints > 0
    assert found.stiffness == pytest.approx(isotropic(2.0, 0.3), abs=1e-8)
    # collocation can't carry a constant pull across the faces, so it is a little too soft
    loose = homogenized(nodes, cells, 2.0, matched=False, faces="collocation").stiffness
    assert 0.99 < loose[0, 0] / isotropic(2.0, 0.3)[0, 0] < 1 - 1e-6


def test_the_mortar_on_matching_faces_is_matching_nodes():
    nodes, cells, young = block_in_a_corner(4, 1)
    matched = homogenized(nodes, cells, young)
    joined = homogenized(nodes, cells, young, matched=False)
    assert joined.stiffness == pytest.approx(matched.stiffness, rel=1e-6)


def test_springs_tie_what_is_joined_and_nothing_else():
    constraints = csr_matrix(np.array([[1.0, -0.5, -0.5, 0.0, 0.0], [0.0, 0.0, 0.0, 3.0, -3.0]]))
    made = tied(identity(15, format="csr").tobsr((3, 3)), constraints)
    fulfilled = np.kron([1.0, 3.0, -1.0, 2.0, 2.0], [1.0, -2.0, 0.5])
    assert made @ fulfilled == pytest.approx(fulfilled)
    apart = np.kron([0.0, 0.0, 0.0, 1.0, -1.0], [0.0, 1.0, 0.0])
    assert made @ apart == pytest.approx(2 * apart)
    assert (made - made.T).nnz == 0 or abs(made - made.T).max() < 1e-15


@pytest.mark.parametrize("order", [1, 2])
def test_joined_faces_take_hardly_more_iterations_than_matching_ones(order):
    """A preconditioner that takes them for free ones takes eight times as many."""
    nodes, cells = quadratic(cube(4), order)
    young = 1 + 0.8 * np.cos(2 * np.pi * middles(nodes, cells)).prod(axis=1)
    matched = homogenized(nodes, cells, young)
    joined = homogenized(nodes, cells, young, matched=False)
    assert max(joined.iterations) < 2.5 * max(matched.iterations)


@pytest.mark.parametrize("faces", ["mortar", "collocation"])
def test_faces_that_do_not_match_come_close_to_those_that_do(faces):
    """The same smooth stiffness on a mesh and on its skewed copy: apart by no more than the meshes' own errors."""
    nodes, cells = cube(6)
    other = skewed(nodes, 0.03)

    def young(mesh):
        return 1 + 0.8 * np.cos(2 * np.pi * middles(mesh, cells)).prod(axis=1)

    fine_nodes, fine_cells = cube(10)
    fine_young = 1 + 0.8 * np.cos(2 * np.pi * middles(fine_nodes, fine_cells)).prod(axis=1)
    limit = homogenized(fine_nodes, fine_cells, fine_young).stiffness
    matched = homogenized(nodes, cells, young(nodes)).stiffness
    joined = homogenized(other, cells, young(other), matched=False, faces=faces).stiffness
    assert np.abs(joined - matched).max() < 3 * np.abs(matched - limit).max() + 2e-3


def test_quadratic_elements_converge_faster():
    """A smooth modulus: errors against a fine quadratic mesh."""

    def stiffness(n, order):
        nodes, cells = cube(n, order)
        x = middles(nodes, cells)
        young = 1 + 0.9 * np.cos(2 * np.pi * x).prod(axis=1)
        # the modulus is constant in a cell: the same for both orders, so that only the displacements differ
        return homogenized(nodes, cells, young).stiffness[0, 0]

    straight, bent = stiffness(4, 1), stiffness(4, 2)
    assert bent < straight  # more freedom never makes it stiffer


def test_voids_and_loose_parts():
    """A plate across z resists along itself only; a loose block adds nothing."""
    nodes, cells = cube(4)
    x = middles(nodes, cells)
    plate = x[:, 2] < 0.5
    found = homogenized(nodes, cells[plate], 1.0).stiffness
    assert np.abs(found[2]).max() < 1e-9
    assert np.abs(found[3:5]).max() < 1e-9
    assert found[0, 0] == pytest.approx(0.5 / (1 - 0.3**2), rel=1e-6)
    loose = ((x > 0.25) & (x < 0.75)).all(axis=1)
    found = homogenized(nodes, cells[loose], 1.0)
    assert np.abs(found.stiffness).max() < 1e-9
    assert max(found.residuals) <= 1e-8


def test_two_runs_give_the_same_bytes_and_leave_the_global_generator_alone():
    nodes, cells, young = block_in_a_corner(4, 1)
    before = np.random.get_state()[1].tobytes()  # noqa: NPY002
    first, second = homogenized(nodes, cells, young), homogenized(nodes, cells, young)
    assert first.stiffness.tobytes() == second.stiffness.tobytes()
    assert np.random.get_state()[1].tobytes() == before  # noqa: NPY002


def test_a_cell_inside_out_is_refused():
    nodes, cells = cube(2)
    with pytest.raises(ValueError, match="inside out"):
        homogenized(nodes, cells[:, [1, 0, 2, 3]], 1.0)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("join", [mortar, collocation])
def test_constraints_hold_for_functions_that_the_faces_can_represent(order, join):
    """Rows of mortar and collocation vanish on what is periodic and linear in the plane of the face."""
    nodes, cells = cube(3)
    nodes, cells = quadratic((skewed(nodes, 0.04), cells), order)
    pair = face_pairs(nodes, cells, BOX, 1e-6)[0]
    assert len(pair.low) == len(pair.high) == 2 * 3 * 3
    rows = join(nodes, pair)
    assert rows.shape[0] == len(np.unique(pair.high))
    for function in (np.ones(len(nodes)), nodes[:, 1], nodes[:, 2]):
        assert np.abs(rows @ function).max() < 1e-10
    assert np.abs(rows @ nodes[:, 0]).max() > 0.1


ROOT = 2**-0.5
DIAGONALS = {
    (1, -1, 0): np.array([[ROOT, ROOT, 0], [-ROOT, ROOT, 0], [0, 0, 1]]),
    (0, 1, -1): np.array([[0, 0, 1], [ROOT, ROOT, 0], [-ROOT, ROOT, 0]]),
    (-1, 0, 1): np.array([[-ROOT, ROOT, 0], [0, 0, 1], [ROOT, ROOT, 0]]),
}
"""Normals of planes that Kuhn's tetrahedra do not cross, and rotations (but for the sign) that take x there."""


@pytest.mark.parametrize("normal", DIAGONALS)
@pytest.mark.parametrize("order", [1, 2])
def test_a_laminate_at_45_degrees_is_exact(normal, order):
    """Three layers with different Poisson's ratios; the displacement is straight in each of them (Backus 1962)."""
    nodes, cells = cube(3, order)
    layer = np.floor(3 * np.mod(middles(nodes, cells) @ normal, 1)).astype(int)
    young, poisson = np.array([1.0, 0.05, 0.4]), np.array([0.3, 0.45, -0.2])
    lam, mu = lame(young, poisson)
    m = lam + 2 * mu
    across, ratio = 1 / np.mean(1 / m), np.mean(lam / m)
    exact = np.zeros((6, 6))
    exact[0, :3] = exact[:3, 0] = across * np.array([1, ratio, ratio])
    exact[1:3, 1:3] = np.mean(2 * mu * lam / m) + ratio**2 * across
    exact[[1, 2], [1, 2]] += np.mean(2 * mu)
    exact[range(3, 6), range(3, 6)] = [np.mean(mu), *([1 / np.mean(1 / mu)] * 2)]
    found = homogenized(nodes, cells, young[layer], poisson[layer]).stiffness
    assert found == pytest.approx(rotated(exact, DIAGONALS[normal]), abs=1e-7)
    assert np.abs(found[:3, 3:]).max() > 0.01  # pulling along an axis shears: no frame was mixed up


@pytest.mark.parametrize("order", [(1, 2, 0), (1, 0, 2), (2, 1, 0)])
@pytest.mark.parametrize("sign", [(1, 1, 1), (1, -1, 1), (-1, -1, -1)])
def test_a_turned_mesh_has_the_turned_stiffness(order, sign):
    nodes, cells = cube(2)
    young = np.random.default_rng(1).uniform(0.1, 1, len(cells))
    first = homogenized(nodes, cells, young).stiffness
    turn = np.eye(3)[list(order)] * sign
    turned = (nodes - 0.5) @ turn.T + 0.5
    if np.linalg.det(turn) < 0:
        cells = cells[:, [0, 2, 1, 3]]
    assert homogenized(turned, cells, young).stiffness == pytest.approx(rotated(first, turn), abs=1e-8)
    assert first == pytest.approx(first.T, abs=1e-14)
    assert np.linalg.eigvalsh(first)[0] > 0


def oracle(nodes, cells, lam, mu):
    """The same problem assembled by scikit-fem: matrix, loads of the unit strains, mean; unknowns node by node."""
    from skfem import Basis, BilinearForm, ElementTetP0, ElementTetP1, ElementTetP2, ElementVector, MeshTet
    from skfem.helpers import ddot, eye, sym_grad, trace

    straight = cells.shape[1] == 4
    corners, used = np.unique(cells[:, :4], return_inverse=True)
    mesh = MeshTet(nodes[corners].T, used.reshape(-1, 4).T)
    basis = Basis(mesh, ElementVector(ElementTetP1() if straight else ElementTetP2()), intorder=2)
    constants = Basis(mesh, ElementTetP0(), intorder=2)

    @BilinearForm
    def energy(u, v, w):
        strain = sym_grad(u)
        return ddot(w["lam"] * eye(trace(strain), 3) + 2 * w["mu"] * strain, sym_grad(v))

    fields = {"lam": constants.interpolate(lam), "mu": constants.interpolate(mu)}
    matrix = energy.assemble(basis, **fields)
    # numbers of its unknowns by where they lie
    place = np.rint(1e6 * basis.doflocs.T).astype(int)
    number = {tuple(p): i for i, p in enumerate(np.rint(1e6 * nodes).astype(int))}
    node = np.array([number[tuple(p)] for p in place])
    component = np.empty(len(node), int)
    for axis in range(3):
        split = basis.split_indices()[axis] if not straight else basis.nodal_dofs[axis]
        component[split] = axis
    return matrix.tocoo(), 3 * node + component


@pytest.mark.parametrize("order", [1, 2])
def test_scikit_fem_agrees(order):
    """Entry by entry before periodicity; then the effective stiffness by a direct solver."""
    pytest.importorskip("skfem")
    nodes, cells = cube(3)
    inner = ((nodes > 0.01) & (nodes < 0.99)).all(axis=1)
    rng = np.random.default_rng(2)
    nodes[inner] += rng.uniform(-0.06, 0.06, (int(inner.sum()), 3))
    nodes, cells = quadratic((nodes, cells), order)
    young, poisson = rng.uniform(0.05, 1, len(cells)), rng.uniform(-0.2, 0.45, len(cells))
    lam, mu = lame(young, poisson)
    matrix, unknown = oracle(nodes, cells, lam, mu)
    size = 3 * len(nodes)
    theirs = coo_matrix((matrix.data, (unknown[matrix.row], unknown[matrix.col])), shape=(size, size)).tocsr()
    ours = assemble(nodes, cells, np.arange(len(nodes)), lam, mu)
    assert abs(theirs - ours.matrix.tocsr()).max() < 1e-12
    # displacements of the unit strains: what the matrix makes of them are the loads, and their energy is the mean
    strains = np.zeros((6, len(nodes), 3))
    for case, (i, j) in enumerate(PAIRS):
        strains[case, :, i] += nodes[:, j] / (1 if i == j else 2)
        strains[case, :, j] += 0 if i == j else nodes[:, i] / 2
    strains = strains.reshape(6, size)
    assert ours.loads == pytest.approx((theirs @ strains.T).T, abs=1e-12)
    assert ours.mean == pytest.approx(strains @ (theirs @ strains.T), abs=1e-12)
    stand_in = matched_nodes(nodes, BOX)
    kept, number = np.unique(stand_in, return_inverse=True)
    columns = (3 * number[:, None] + np.arange(3)).reshape(-1)
    join = coo_matrix((np.ones(size), (np.arange(size), columns)), shape=(size, 3 * len(kept))).tocsr()
    reduced, loads = (join.T @ theirs @ join).tocsc(), join.T @ (theirs @ strains.T)
    fluctuation = np.zeros_like(loads)
    fluctuation[3:] = splu(reduced[3:, 3:]).solve(-loads[3:])
    expected = strains @ (theirs @ strains.T) + loads.T @ fluctuation
    assert homogenized(nodes, cells, young, poisson).stiffness == pytest.approx(expected, abs=1e-8)


def test_translations_are_not_divided_by_what_rounding_makes_of_their_stiffness():
    """Large meshes resist translations by some 1e-14 of their stiffness; the preconditioner must not invert that."""
    nodes, cells = cube(4)
    kept, numbers = np.unique(matched_nodes(nodes, BOX), return_inverse=True)
    ones = np.ones(len(cells))
    matrix = assemble(nodes, cells, numbers, *lame(ones, 0.3 * ones)).matrix
    stiffest = abs(matrix).max()
    rounded = bsr_matrix(matrix + 1e-13 * stiffest * identity(matrix.shape[0]), blocksize=(3, 3))
    forces = np.outer(np.tile([1.0, 0, 0], len(kept)), np.ones(6))
    moved = aggregation(rounded, rigid_modes(nodes[kept]))(forces)
    assert abs(moved).max() * stiffest < 1e4


@pytest.fixture(scope="module")
def assembled():
    """A periodic quadratic mesh with random moduli: unknowns of its cells, moduli, stiffness."""
    nodes, cells = cube(3, 2)
    numbers = np.unique(matched_nodes(nodes, BOX), return_inverse=True)[1]
    moduli = lame(np.random.default_rng(3).uniform(0.1, 1, len(cells)), np.full(len(cells), 0.3))
    return nodes, cells, numbers, moduli, assemble(nodes, cells, numbers, *moduli).matrix


def test_linear_elements_lie_in_the_quadratic_ones(assembled):
    """What quadratic elements make of linear displacements is what the linear elements of the mesh make of them."""
    nodes, cells, numbers, moduli, quadratic_matrix = assembled
    shares = interpolation(numbers[cells], int(numbers.max()) + 1)
    corners = np.unique(numbers[cells[:, :4]])
    number_of = np.zeros(len(nodes), np.int64)
    number_of[corners] = np.arange(len(corners))
    linear = assemble(nodes, cells[:, :4], number_of[numbers], *moduli).matrix
    inject = kron(shares, identity(3))
    assert abs(inject.T @ quadratic_matrix @ inject - linear).max() < 1e-13
    assert np.asarray(shares.sum(axis=1)).ravel() == pytest.approx(1, abs=0)


def test_six_vectors_at_a_time_are_one_after_the_other(assembled):
    matrix = assembled[-1]
    blocks, rng = Blocks(matrix), np.random.default_rng(4)
    x, right = rng.standard_normal((2, matrix.shape[0], 6))
    assert blocks.product(x) == pytest.approx(matrix @ x, abs=1e-12)
    dense, rows = matrix.toarray(), np.arange(matrix.shape[0]).reshape(-1, 3)

    def swept(start, order):
        slow = start.copy()
        for row in order:
            slow[row] += np.linalg.solve(dense[np.ix_(row, row)], right[row] - dense[row] @ slow)
        return slow

    first, left = blocks.relaxed(right)
    assert first == pytest.approx(swept(np.zeros_like(x), rows), abs=1e-10)
    assert left == pytest.approx(right - matrix @ first, abs=1e-10)
    expected, given = swept(x, rows[::-1]), right.copy()
    blocks.relax_back(right, x)
    assert x == pytest.approx(expected, abs=1e-10)
    assert np.array_equal(right, given)


def test_what_is_projected_fulfills_constraints_that_repeat_each_other_and_nothing_more_is_taken():
    nodes, cells = cube(3, 2)
    joined = vstack([mortar(nodes, pair) for pair in face_pairs(nodes, cells, BOX, 1e-6)]).toarray()
    assert np.linalg.matrix_rank(joined) < len(joined)  # where faces meet
    values = np.random.default_rng(5).standard_normal((3 * len(nodes), 6))
    by_node = values.reshape(len(nodes), 18)
    projected = Projector(csr_matrix(joined))(values).reshape(by_node.shape)
    assert np.abs(joined @ projected).max() < 1e-13
    assert projected == pytest.approx(by_node - np.linalg.pinv(joined) @ (joined @ by_node), abs=1e-12)


def test_iterations_on_quadratic_elements_do_not_grow_with_the_mesh():
    found = [homogenized(*block_in_a_corner(n, 2)) for n in (4, 8)]
    assert max(max(each.iterations) for each in found) <= 30
    assert max(max(each.residuals) for each in found) <= 1e-8
