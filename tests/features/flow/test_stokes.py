"""Permeability: a direct solver, exact channels, spheres of Zick and Homsy, symmetry, rotation, bounds."""

import itertools

import numpy as np
import pytest
from scipy.sparse import bmat, coo_matrix, diags
from scipy.sparse.linalg import spsolve

from sppm_pipeline.features.flow.numerics.faces import faces_of_field, faces_of_voxels, percolating
from sppm_pipeline.features.flow.numerics.stokes import middle_plane, stokes_flow
from tests.features.flow.conftest import sampled


def direct(faces):
    """Permeability by a sparse direct solver of the assembled saddle point, edges in any unit."""
    shape = faces.active[0].shape
    numbers = np.arange(faces.active[0].size).reshape(shape)
    blocks, couplings, forces = [], [], []
    for d, active in enumerate(faces.active):
        rows, columns, values = [numbers.ravel()], [numbers.ravel()], [faces.walls[d].ravel().astype(float)]
        for axis, step in itertools.product(range(3), (1, -1)):
            there = np.roll(active, step, 2 - axis) & active
            w = 1 / faces.edges[axis] ** 2
            rows += [numbers[there], numbers[there]]
            columns += [numbers[there], np.roll(numbers, step, 2 - axis)[there]]
            values += [np.full(there.sum(), w), np.full(there.sum(), -w)]
        size = (numbers.size,) * 2
        places = np.concatenate(rows), np.concatenate(columns)
        blocks.append(coo_matrix((np.concatenate(values), places), size).tocsr())
        before, weight = np.roll(numbers, 1, 2 - d), faces.weights[d].astype(float)
        places = np.concatenate([numbers[active]] * 2), np.concatenate([numbers[active], before[active]])
        signs = np.concatenate([weight[active], -weight[active]]) / faces.edges[d]
        couplings.append(coo_matrix((signs, places), size).tocsr())
        forces.append(weight.ravel())
    gradient = bmat([[c] for c in couplings])
    # unknowns that are none, and one pressure of each piece, here one, are held
    active = np.concatenate([a.ravel() for a in faces.active]).astype(float)
    voxels = faces.voxels().ravel().astype(float)
    held = 1 - voxels
    held[np.flatnonzero(voxels)[0]] = 1
    matrix = bmat([[bmat([[blocks[0], None, None], [None, blocks[1], None], [None, None, blocks[2]]])
                    + diags(1 - active), gradient], [gradient.T, diags(held)]]).tocsc()  # fmt: skip
    k = np.zeros((3, 3))
    for d in range(3):
        b = np.zeros(4 * numbers.size)
        b[d * numbers.size : (d + 1) * numbers.size] = forces[d]
        x = spsolve(matrix, b)
        k[d] = (np.concatenate(forces) * x[: 3 * numbers.size]).reshape(3, -1).mean(axis=1)
    return k


@pytest.mark.parametrize("edges", [(1.0, 1.0, 1.0), (1.0, 0.8, 1.3)])
def test_the_direct_solver_agrees(edges):
    rng = np.random.default_rng(5)
    void = np.ones((8, 8, 6), bool)
    for z, y, x in rng.integers(0, 6, (9, 3)):
        void[z : z + 2, y : y + 3, x : x + 2] = False
    way = percolating(faces_of_voxels(void, edges))
    assert way.wraps == (True, True, True)
    found = stokes_flow(way.faces, void.mean(), tolerance=0, residual=1e-11, precision=np.float64)
    assert found.permeability == pytest.approx(direct(way.faces), rel=1e-6, abs=1e-9)
    assert abs(found.permeability[0, 1]) > 1e-4
    assert [case.energy for case in found.solved] == pytest.approx(np.diag(found.permeability), rel=1e-6)


def channel(width, shift, square=False):
    """A slit across y, or a square duct along x, of a width in voxels of a cell of 16."""

    def field(x, y, z):
        y, z = abs((y - shift / 16) % 1 - 0.5), abs((z - shift / 16) % 1 - 0.5)
        return width / 32 - (np.maximum(y, z) if square else y + 0 * z) + 0 * x

    return field


def test_channels(flow):
    for width, shift in ((8, 0), (4.8, 0), (5.9, 0.3), (8.5, 0.3)):
        found = flow(channel(width, shift), 16)
        exact = width**3 / 12 / 16
        assert np.diag(found.permeability) == pytest.approx([exact, 0, exact], rel=0.001 if width == 8 else 0.006)
        assert found.solved[1].iterations == 0
        # the paths are straight; <u^2> / <u>^2 is 6/5 for a parabola
        assert found.hydraulic_tortuosity[0] == pytest.approx(1, rel=1e-3)
        assert found.viscous_tortuosity[0] == pytest.approx(1.2, rel=0.06)
        assert found.viscous_tortuosity[1] == np.inf
    void = np.zeros((2, 10, 3), bool)
    void[:, 1:7] = True
    flat = stokes_flow(faces_of_voxels(void, (1.0, 0.5, 1.3)), 0.6, (True, False, True))
    assert np.diag(flat.permeability) == pytest.approx([3**3 / 12 / 5, 0, 3**3 / 12 / 5], rel=0.002)
    # the error of a duct is of second order
    errors = [
        flow(channel(width, shift, True), 16).permeability[0, 0] / (0.035144 * width**4 / 256) - 1
        for width, shift in ((6, 0), (8, 0), (12, 0), (8.5, 0.3))
    ]
    assert np.abs(errors) == pytest.approx(0, abs=0.012)
    assert abs(errors[1]) < 0.01
    assert errors[2] == pytest.approx(errors[0] / 4, abs=0.003)
    duct = flow(channel(12, 0, True), 16)
    # for straight channels the torsion field is the flow
    assert duct.thermal_permeability == pytest.approx(duct.permeability[0, 0], rel=0.02)
    # the middle plane shows the flow along x to the right: fastest in its middle, rows are y
    picture = duct.slices[0]
    assert picture.shape == (16, 16)
    assert np.isnan(picture[0]).all()
    assert picture[7:9] == pytest.approx(np.nanmax(picture), rel=0.01)


@pytest.mark.parametrize(("share", "drag"), [(0.125, 4.292), (0.45, 28.1)])
def test_spheres_of_zick_and_homsy(flow, spheres, share, drag):
    field, radius = spheres([(0.5, 0.5, 0.5)], share)
    found = flow(field, 32)
    k = np.diag(found.permeability) / 32**2
    assert 1 / (6 * np.pi * radius * k) == pytest.approx([drag] * 3, rel=0.008)
    assert found.permeability == pytest.approx(
        found.permeability[0, 0] * np.eye(3), abs=2e-3 * found.permeability[0, 0]
    )
    assert max(case.iterations for case in found.solved) <= 35
    assert k[0] < found.thermal_permeability / 32**2


@pytest.mark.parametrize(("centers", "share", "shape"), [
    ([(0, 0, 0), (0.5, 0.5, 0.5)], 0.027, 1 - 1.7918 * 0.3 + 0.027 - 0.3292 * 0.027**2),
])  # fmt: skip
def test_dilute_spheres_of_hasimoto(flow, spheres, centers, share, shape):
    field, radius = spheres(centers, share)
    k = flow(field, 32).permeability[0, 0] / 32**2
    assert 1 / (6 * np.pi * radius * len(centers) * k) == pytest.approx(1 / shape, rel=0.01)


def tunnels(seed, count, least, most):
    """Winding tunnels along the axes, of random places and radii."""
    rng = np.random.default_rng(seed)
    axes, places, radii = rng.integers(0, 3, count), rng.random((count, 3)), rng.uniform(least, most, count)

    def field(*point):
        inside = -1.0
        for axis, place, radius in zip(axes, places, radii, strict=True):
            bend = 0.05 * np.sin(2 * np.pi * point[axis])
            beside = [(point[k] - place[k] - bend + 0.5) % 1 - 0.5 for k in range(3) if k != axis]
            inside = np.maximum(inside, radius - np.hypot(*beside))
        return inside

    return field


@pytest.mark.parametrize("seed", [2, 3])
def test_tunnels_of_one_to_three_voxels(flow, seed):
    # half again as many iterations with coarse grids of the pressure that unite what walls keep apart
    field = tunnels(seed, 18, 0.03, 0.07)
    found = flow(field, 24, tolerance=1e-4)
    assert max(case.iterations for case in found.solved) <= 30
    exact = flow(field, 24, tolerance=1e-7)
    assert np.diag(found.permeability) == pytest.approx(np.diag(exact.permeability), rel=1e-4)


def test_a_gyroid(flow, gyroid):
    options = {"tolerance": 1e-4}
    found, fine = flow(gyroid, 16, **options), flow(gyroid, 24, **options)
    k = found.permeability
    assert k == pytest.approx(k.T)
    assert np.linalg.eigvalsh(k)[0] > 0
    assert np.linalg.eigvalsh(k)[2] < found.thermal_permeability
    assert abs(k[1, 2]) > 0.01 * k[0, 0]  # so that the symmetry says something
    assert k / 16**2 == pytest.approx(fine.permeability / 24**2, rel=0.04, abs=2e-5)
    assert all(value > 1 for value in found.hydraulic_tortuosity)
    assert all(value > found.thermal_tortuosity > 1 for value in found.viscous_tortuosity)
    assert abs(found.solved[0].iterations - fine.solved[0].iterations) <= 6
    # x becomes z, y becomes x, z becomes y
    turned = flow(lambda x, y, z: gyroid(z, x, y), 16, **options).permeability
    assert np.roll(turned, (1, 1), (0, 1)) == pytest.approx(k, rel=1e-3, abs=1e-4 * k[0, 0])
    two = flow(gyroid, 16, threads=2, **options)
    assert (two.permeability == k).all()


def test_error_estimates_hold(gyroid):
    faces = percolating(faces_of_field(sampled(gyroid), (16, 16, 16), 1 / 16)).faces
    exact = np.diag(stokes_flow(faces, 0.5, tolerance=1e-9, precision=np.float64).permeability)
    for tolerance in (1e-2, 1e-3, 1e-4):
        found = np.diag(stokes_flow(faces, 0.5, tolerance=tolerance, precision=np.float64).permeability)
        assert (abs(found / exact - 1) < tolerance).all()
    # more than single precision has to give
    finest = stokes_flow(faces, 0.5, tolerance=1e-8)
    assert finest.precision == "float64"
    assert np.diag(finest.permeability) == pytest.approx(exact, rel=1e-8)
    few = stokes_flow(faces, 0.5, tolerance=1e-4, iterations=5, precision=np.float64)
    assert not any(case.converged for case in few.solved)


def test_planes_have_the_axis_to_the_right_and_the_next_one_upward():
    z, y, x = np.indices((5, 4, 3))
    values = 100 * z + 10 * y + x
    rows = [np.arange(n)[:, None] for n in (3, 4, 5)]
    columns = [np.arange(n) for n in (3, 4, 5)]
    assert (middle_plane(values, 0) == 200 + 10 * rows[1] + columns[0]).all()
    assert (middle_plane(values, 1) == 1 + 100 * rows[2] + 10 * columns[1]).all()
    assert (middle_plane(values, 2) == 20 + rows[0] + 100 * columns[2]).all()
