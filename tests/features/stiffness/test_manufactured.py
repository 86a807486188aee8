"""Manufactured solutions: smooth fields are chosen, their loads follow, and solvers have to find the fields again."""

from itertools import permutations

import numpy as np
import pytest
from sppm_tetrahedra.numerics.tetrahedral import aggregation, conjugate_gradients, rigid_modes
from sppm_tetrahedra.numerics.tetrahedral_blocks import Blocks, assemble

from sppm_pipeline.features.flow.numerics.conduction import conduction_hierarchy
from sppm_pipeline.services.elastic.elastic_level import ElasticLevel, Moduli, grids_of
from sppm_pipeline.services.multigrid.solver import Stop, solve

SIZES = (8, 16, 32)
STOP = Stop(1e-10, 0.0, 100)


def periodic(n, half=False):
    """Coordinates x, y, z of the nodes, or of the centers of the voxels, (nz, ny, nx) each, times 2 pi."""
    axis = 2 * np.pi * (np.arange(n) + (0.5 if half else 0)) / n
    z, y, x = np.meshgrid(axis, axis, axis, indexing="ij")
    return x, y, z


def gradient(values):
    """Exact derivatives along x, y, z of a trigonometric polynomial of low degree, on a unit cell."""
    n = values.shape[0]
    wave = 2j * np.pi * np.fft.fftfreq(n, 1 / n)
    spectrum = np.fft.fftn(values)
    factors = (wave[None, None, :], wave[None, :, None], wave[:, None, None])
    return [np.fft.ifftn(spectrum * factor).real for factor in factors]


def coefficient(x, y, z):
    return 2 + np.sin(x) * np.cos(y) + 0.5 * np.cos(z)


def displacement(x, y, z):
    return [np.sin(x) * np.cos(y), np.sin(y + z) + 0.3 * np.cos(x), np.cos(z) * np.sin(x)]


def body_force(mu, ratio, exact):
    """The forces that balance the stresses of a displacement; lambda is `ratio` times mu."""
    slopes = [gradient(part) for part in exact]
    dilatation = sum(slopes[i][i] for i in range(3))
    force = []
    for i in range(3):
        stress = [mu * (slopes[i][j] + slopes[j][i]) + (ratio * mu * dilatation if i == j else 0) for j in range(3)]
        force.append(-sum(gradient(stress[j])[j] for j in range(3)))
    return force


def observed_order(errors):
    return np.log2(errors[:-1] / np.array(errors[1:]))


def nodal_error(hierarchy, load, expected):
    """Largest error of a component at a node; constants are free."""
    u, p = np.empty((2, load.size))
    assert solve(hierarchy, load, u, p, hierarchy.workspace(), STOP, 1.0, 1.0).converged
    found = u.reshape(len(expected), -1)
    exact = np.array([part.reshape(-1) for part in expected])
    difference = (found - found.mean(1, keepdims=True)) - (exact - exact.mean(1, keepdims=True))
    return float(np.abs(difference).max())


def test_potentials_converge_with_second_order():
    errors = []
    for n in SIZES:
        nodes = periodic(n)
        fine = coefficient(*nodes)
        exact = displacement(*nodes)[0]
        source = -sum(gradient(fine * slope)[axis] for axis, slope in enumerate(gradient(exact)))
        hierarchy = conduction_hierarchy(coefficient(*periodic(n, half=True)), (1 / n,) * 3, np.float64, safe=False)
        errors.append(nodal_error(hierarchy, source.reshape(-1) / n**3, [exact]))
    assert (observed_order(errors) > 1.8).all()
    assert errors[-1] < 0.02


@pytest.mark.parametrize("poisson", [-0.4, 0.0, 0.3])
def test_displacements_converge_with_second_order(poisson):
    ratio = 2 * poisson / (1 - 2 * poisson)
    errors = []
    for n in SIZES:
        nodes = periodic(n)
        mu = coefficient(*nodes)
        exact = displacement(*nodes)
        force = body_force(mu, ratio, exact)
        middle = coefficient(*periodic(n, half=True))
        hierarchy = grids_of(ElasticLevel(Moduli.of(ratio * middle, middle), (1 / n,) * 3, np.float64))
        errors.append(nodal_error(hierarchy, np.array(force).reshape(-1) / n**3, exact))
    assert (observed_order(errors) > 1.8).all()
    assert errors[-1] < 0.02


def kuhn(n):
    """Six tetrahedra in each of n^3 cubes: nodes, cells, and the number that periodic copies of a node share."""
    z, y, x = np.indices((n + 1,) * 3).reshape(3, -1)
    nodes = np.stack([x, y, z], axis=1)
    low = nodes[(nodes < n).all(axis=1)]
    cells = []
    for way in permutations(range(3)):
        path = [low]
        for axis in way:
            path.append(path[-1] + np.eye(3, dtype=int)[axis])
        if np.linalg.det(np.eye(3)[list(way)]) < 0:
            path[1], path[2] = path[2], path[1]
        cells.append(np.stack([(p[:, 2] * (n + 1) + p[:, 1]) * (n + 1) + p[:, 0] for p in path], axis=1))
    x, y, z = (nodes % n).T
    return nodes / n, np.concatenate(cells).astype(np.int32), (z * n + y) * n + x


def test_displacements_on_tetrahedra_converge_with_second_order():
    ratio, errors = 1.5, []
    for n in (6, 12):
        at = periodic(n)
        exact = displacement(*at)
        force = body_force(coefficient(*at), ratio, exact)
        nodes, cells, unknowns = kuhn(n)
        mu = coefficient(*(2 * np.pi * nodes[cells].mean(axis=1)).T)
        built = assemble(nodes, cells, unknowns, ratio * mu, mu)
        places = np.stack(at, axis=-1).reshape(-1, 3)
        load = np.stack(force, axis=-1).reshape(-1) / n**3
        cycle = aggregation(built.matrix, rigid_modes(places))
        loads = np.outer(load, [1, 0, -1, 2, 1e3, 1])
        found = conjugate_gradients(Blocks(built.matrix), loads, cycle, None, 1e-9, 200)
        assert max(found.residuals) <= 1e-9
        assert found.iterations[1] == 0 < found.iterations[0]
        expected = np.stack(exact, axis=-1).reshape(-1, 3)
        assert found.values == pytest.approx(np.outer(found.values[:, 0], [1, 0, -1, 2, 1e3, 1]), abs=1e-6)
        difference = found.values[:, 0].reshape(-1, 3) - expected
        errors.append(float(np.abs(difference - difference.mean(axis=0)).max()))
    assert (observed_order(errors) > 1.6).all()
    assert errors[-1] < 0.15
