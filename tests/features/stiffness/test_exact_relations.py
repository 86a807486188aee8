"""Relations that hold whatever the microstructure: rotations, bounds, Hill's and Keller's theorems, oblique layers."""

from itertools import permutations, product

import numpy as np
import pytest

from sppm_pipeline.features.flow.numerics.conduction import conductivity
from sppm_pipeline.features.stiffness.numerics.elasticity import stiffness
from sppm_pipeline.method.nouns.stiffness import StiffnessReport
from sppm_pipeline.services.elastic.bounds import bounds, hashin_shtrikman
from sppm_pipeline.services.elastic.isotropy import averages
from sppm_pipeline.services.elastic.voigt import engineering_constants, isotropic, lame, rotated

TIGHT = {"precision": np.float64, "tolerance": 0.0, "residual": 1e-10}

CUBE = [np.eye(3)[list(order)] * signs for order in permutations(range(3)) for signs in product((-1, 1), repeat=3)]
"""The 48 rotations and reflections of a cube."""


def moved(image, turn):
    """The image, indexed x, y, z, after a rotation or reflection of its cube."""
    order = [int(np.flatnonzero(row)[0]) for row in turn]
    return np.flip(image.transpose(order), [axis for axis, row in enumerate(turn) if row.sum() < 0])


def on_voxels(image, *values):
    """Values of the phases of an image indexed x, y, z, as arrays (nz, ny, nx)."""
    return [np.asarray(value)[np.asarray(image, int).T] for value in values]


def composite(image, young, poisson, **options):
    return stiffness(*on_voxels(image, *lame(np.array(young), np.array(poisson))), **(TIGHT | options)).stiffness


def random_image(shape, share=0.5, seed=0):
    return np.random.default_rng(seed).random(shape) < share


def finer(image, factor):
    for axis in range(3):
        image = image.repeat(factor, axis)
    return image


@pytest.fixture(scope="module")
def one_sided():
    """A cell without any symmetry, and its properties."""
    image = random_image((5, 5, 5), 0.6, 9)
    k = conductivity(*on_voxels(image, (0.05, 1.0)), **TIGHT).conductivity
    return image, composite(image, (0.05, 1.0), (0.4, 0.25)), k


@pytest.mark.parametrize("number", range(1, 48))
def test_a_turned_cell_has_turned_properties(one_sided, number):
    image, first, k = one_sided
    turn = CUBE[number]
    cell = moved(image, turn)
    found = composite(cell, (0.05, 1.0), (0.4, 0.25))
    assert found == pytest.approx(rotated(first, turn), abs=1e-9)
    flow = conductivity(*on_voxels(cell, (0.05, 1.0)), **TIGHT).conductivity
    assert flow == pytest.approx(turn @ k @ turn.T, abs=1e-9)


def test_properties_are_symmetric_and_positive(one_sided):
    _, c, k = one_sided
    assert np.abs(c - c.T).max() <= 1e-13
    assert np.abs(k - k.T).max() <= 1e-13
    assert np.linalg.eigvalsh(c)[0] > 0
    assert np.linalg.eigvalsh(k)[0] > 0
    # no symmetry: otherwise the test of rotations would see less
    assert min(abs(c[0, 0] - c[1, 1]), abs(c[1, 1] - c[2, 2]), abs(c[0, 3]), abs(c[3, 4])) > 1e-4


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("young", [(1.0, 30.0), (8.0, 1.0)])
def test_random_mixtures_keep_to_the_bounds_of_hashin_and_shtrikman(seed, young):
    """Blocks of three voxels an edge: of single ones, the error of the grid exceeds the bounds."""
    poisson = (0.35, 0.2)
    image = finer(random_image((5, 5, 5), 0.3 + 0.1 * seed, seed), 3)
    share = float(image.mean())
    phases = [(1 - share, young[0], poisson[0]), (share, young[1], poisson[1])]
    found = composite(image, young, poisson, residual=1e-6)
    limits = bounds(found, phases)
    assert limits.within
    assert limits.bulk_holds
    assert limits.shear_holds
    mean, (bulk, shear) = averages(found), hashin_shtrikman(phases)
    # strictly inside, both averages of a nearly isotropic mixture, not Hill's mean alone
    assert bulk.lower < mean.bulk_reuss <= mean.bulk_voigt < bulk.upper
    assert shear.lower < mean.shear_reuss <= mean.shear_voigt < shear.upper


def test_equal_shear_moduli_make_every_mixture_isotropic():
    """Hill 1963: the bulk modulus is then known, whatever the geometry; voxels approach it from above."""
    mu, k = 1.0, np.array([0.5, 6.0])
    image = random_image((4, 4, 4), 0.5, 2)
    share = np.array([1 - image.mean(), image.mean()])
    bulk = 1 / float(share @ (1 / (k + 4 * mu / 3))) - 4 * mu / 3
    exact = np.diag([2 * mu] * 3 + [mu] * 3) + (bulk - 2 * mu / 3) * np.pad(np.ones((3, 3)), (0, 3))
    excess = []
    for factor in (1, 2, 4):
        lam, shear = on_voxels(finer(image, factor), k - 2 * mu / 3, (mu, mu))
        found = stiffness(lam, shear, **TIGHT).stiffness
        excess.append(found - exact)
        assert np.linalg.eigvalsh(excess[-1])[0] > -1e-9
    sizes = [np.linalg.norm(part) for part in excess]
    assert sizes[0] > 1.5 * sizes[1] > 2.2 * sizes[2] > 0
    assert sizes[2] < 0.03 * np.linalg.norm(exact)


def test_exchanged_phases_of_a_plane_pattern_conduct_reciprocally():
    """Keller 1964: k_x of a plane pattern times k_y with the phases exchanged is the product of the phases'."""
    image = random_image((6, 6, 1), 0.5, 5)
    errors = []
    for factor in (1, 2, 4, 8):
        fine = image.repeat(factor, 0).repeat(factor, 1)
        one, other = (conductivity(*on_voxels(fine, pair), **TIGHT).conductivity for pair in ((1.0, 5.0), (5.0, 1.0)))
        errors.append(one[0, 0] * other[1, 1] / 5 - 1)
    assert errors[0] > errors[1] > errors[2] > errors[3] > 0
    assert errors[3] < 0.02


def layers(lam, mu, share):
    """Exact stiffness of two layers normal to x (Backus 1962)."""
    m = lam + 2 * mu
    normal, ratio = 1 / (share @ (1 / m)), share @ (lam / m)
    c = np.zeros((6, 6))
    c[0, 0] = normal
    c[0, 1] = c[0, 2] = c[1, 0] = c[2, 0] = normal * ratio
    c[1, 1] = c[2, 2] = share @ (4 * mu * (lam + mu) / m) + normal * ratio**2
    c[1, 2] = c[2, 1] = share @ (2 * mu * lam / m) + normal * ratio**2
    c[3, 3], c[4, 4], c[5, 5] = share @ mu, *([1 / (share @ (1 / mu))] * 2)
    return c


DIAGONAL = np.array([[1, 1, 0], [-1, 1, 0], [0, 0, np.sqrt(2)]]) / np.sqrt(2)
"""Turns x to the diagonal between x and -y, z stays."""


@pytest.mark.parametrize("axis", range(3))
def test_layers_at_45_degrees_are_approached(axis):
    """Layers normal to a diagonal of two axes: steps of voxels come near the exact stiffness and conductivity."""
    young, poisson, share = np.array([1.0, 0.2]), np.array([0.3, 0.1]), np.array([0.5, 0.5])
    cycle = np.roll(np.eye(3), axis, axis=0)
    turn = cycle @ DIAGONAL @ cycle.T @ cycle
    exact = rotated(layers(*lame(young, poisson), share), turn)
    k = np.array([1.0, 0.1])
    flow = turn @ np.diag([1 / (share @ (1 / k)), share @ k, share @ k]) @ turn.T
    errors, leaks = [], []
    for n in (8, 16, 32):
        x, y = np.indices((n, n))
        image = ((x - y) % n >= n // 2)[:, :, None].transpose(np.roll([0, 1, 2], axis))
        errors.append(np.linalg.norm(composite(image, young, poisson) - exact) / np.linalg.norm(exact))
        found = conductivity(*on_voxels(image, k), **TIGHT).conductivity
        leaks.append(np.linalg.norm(found - flow) / np.linalg.norm(flow))
    assert errors[0] > 1.6 * errors[1] > 2.5 * errors[2]
    assert leaks[0] > 1.6 * leaks[1] > 2.5 * leaks[2]
    assert errors[2] < 0.03
    assert leaks[2] < 0.05


@pytest.mark.parametrize("axis", range(3))
def test_poissons_ratios_of_a_laminate_are_not_interchangeable(axis):
    """Layers of one Poisson's ratio: pulled along the layers they contract by it, pulled across by less."""
    ratio, young, share = 0.3, np.array([1.0, 0.1]), np.array([0.25, 0.75])
    image = np.broadcast_to((np.arange(4) > 0).reshape(np.roll([4, 1, 1], axis)), np.roll([4, 2, 2], axis))
    c = composite(image, young, (ratio, ratio))
    across = float(1 / np.linalg.inv(layers(*lame(young, np.array([ratio, ratio])), share))[0, 0])
    along = float(share @ young)
    first, second = (axis + 1) % 3, (axis + 2) % 3
    found = engineering_constants(c)
    assert found["E"][[axis, first, second]] == pytest.approx([across, along, along], rel=1e-8)
    nu = found["nu"]
    assert nu[first, axis] == pytest.approx(ratio, rel=1e-8)
    assert nu[first, second] == pytest.approx(ratio, rel=1e-8)
    assert nu[axis, first] == pytest.approx(ratio * across / along, rel=1e-8)
    assert nu[axis, first] < 0.5 * nu[first, axis]
    # by the definition: the strains of a pull
    strains = np.linalg.solve(c, np.eye(6)[axis])
    assert nu[axis, second] == pytest.approx(-strains[second] / strains[axis], rel=1e-8)
    report = StiffnessReport(c, ((0.25, 1.0, ratio), (0.75, 0.1, ratio)), "laminate").summary()
    name = "xyz"[first] + "xyz"[axis]
    assert report["nu"][name] == pytest.approx(ratio, rel=1e-8)
    assert report["nu"][name[::-1]] == pytest.approx(ratio * across / along, rel=1e-8)


def test_an_isotropic_cell_stays_isotropic_in_any_frame():
    c = composite(np.zeros((3, 4, 5)), (2.0,), (0.25,))
    assert c == pytest.approx(isotropic(2.0, 0.25), abs=1e-12)


def heated(image, young, poisson, expansion, **options):
    lam, mu, alpha = on_voxels(image, *lame(np.array(young), np.array(poisson)), expansion)
    return stiffness(lam, mu, expansion=alpha, **options)


def test_one_material_expands_as_it_does_whatever_its_shape():
    # a slab of random shape that carries no load along z: nothing is known of the strains along it
    image = random_image((6, 5, 4), 0.7, 2)
    image[:, :, 0] = False
    image[:, :, 1] = True
    found = heated(image, (0.0, 2.0), (0.3, 0.3), (0.0, 1.7e-5), edges=(1.0, 0.8, 1.2), tolerance=1e-8).expansion
    assert found[[0, 1, 5]] == pytest.approx([1.7e-5, 1.7e-5, 0], rel=1e-4, abs=2e-9)
    assert np.isnan(found[[2, 3, 4]]).all()
    found = heated(random_image((6, 5, 4), 0.7, 2), (0.0, 2.0), (0.3, 0.3), (0.0, 1.7e-5)).expansion
    assert found == pytest.approx([1.7e-5] * 3 + [0] * 3, rel=1e-6, abs=1e-11)
    assert np.isnan(heated(0 * image, (0.0, 1.0), (0.3, 0.3), (0.0, 1.0)).expansion).all()


def test_levin():
    """Two isotropic phases expand as their effective stiffness says (Levin 1967; Rosen and Hashin 1970)."""
    young, poisson, alpha = (1.0, 30.0), (0.4, 0.2), np.array((2.0, -3.0))
    lam, mu = lame(np.array(young), np.array(poisson))
    bulk = lam + 2 * mu / 3
    found = heated(random_image((6, 5, 7), 0.5, 3), young, poisson, alpha, edges=(1.0, 0.8, 1.3))
    slope = (bulk[1] * alpha[1] - bulk[0] * alpha[0]) / (bulk[1] - bulk[0])
    compliance = np.linalg.inv(found.stiffness)
    expected = 3 * bulk[0] * (alpha[0] - slope) * compliance[:, :3].sum(axis=1) + slope * np.array([1, 1, 1, 0, 0, 0])
    assert found.expansion == pytest.approx(expected, rel=1e-4, abs=1e-3)
    trace = alpha[0] + np.diff(alpha)[0] * (compliance[:3, :3].sum() - 1 / bulk[0]) / (1 / bulk[1] - 1 / bulk[0])
    assert found.expansion[:3].sum() == pytest.approx(3 * trace, rel=1e-4)


def test_the_expansion_of_a_laminate():
    """Layers across z: along them the strains are equal and stresses average, across them it is the other way round."""
    image = np.zeros((2, 3, 8), bool)
    image[:, :, :3] = True
    shares, alpha = np.array([5 / 8, 3 / 8]), np.array([1.0, 4.0])
    lam, mu = lame(np.array((1.0, 5.0)), np.array((0.35, 0.2)))
    plane = 2 * mu * (3 * lam + 2 * mu) / (lam + 2 * mu)
    along = (shares * plane * alpha).sum() / (shares * plane).sum()
    across = (shares * ((3 * lam + 2 * mu) * alpha - 2 * lam * along) / (lam + 2 * mu)).sum()
    found = heated(image, (1.0, 5.0), (0.35, 0.2), alpha).expansion
    assert found == pytest.approx([along, along, across, 0, 0, 0], rel=1e-4, abs=1e-4)
