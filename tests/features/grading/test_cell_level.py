"""Levels over cells of any shape: weights add up, means are those of the spline, Newton steps reach the targets."""

from __future__ import annotations

import numpy as np
import pytest

from sppm_pipeline.features.grading.curved_cells import CylinderCells, HexahedralCells
from sppm_pipeline.features.grading.numerics.cell_level import (
    CellSamples,
    ControlLattice,
    blending,
    fit_cells,
    means_over_cells,
    porosities_and_slopes,
)
from sppm_pipeline.features.grading.numerics.hexahedral_mesh import checked_mesh
from tests.features.grading.hexahedral_meshes import star

STAR = HexahedralCells(checked_mesh(*star(5, 2.0)).corners)
TUBE = CylinderCells((8, 1, 2), 2.0, 2.0, 2 * np.pi)


def lattice_over(cells, edge=0.5):
    low, high = cells.box
    shape = np.ceil((high - low) / edge).astype(int) + 2
    return ControlLattice(tuple(int(n) for n in shape), edge, low - edge)


@pytest.mark.parametrize("cells", [STAR, TUBE], ids=["star", "tube"])
def test_weights_are_a_partition_of_unity_around_the_cells(cells):
    lattice = lattice_over(cells)
    blend = blending(lattice, cells.centers, cells.frames)
    np.testing.assert_allclose(blend.sum(axis=1), 1.0, rtol=1e-12)
    assert blend.min() >= 0
    # the largest weight in a cell's middle is its own
    place = np.floor((cells.centers - lattice.origin) / lattice.edge).astype(int)
    rows = np.ravel_multi_index(tuple(place.T), lattice.shape)
    np.testing.assert_array_equal(np.asarray(blend[rows].todense()).argmax(axis=1), np.arange(cells.count))


def test_means_are_those_of_the_spline_by_brute_force(spline_values):
    cells = STAR
    lattice = lattice_over(cells)
    blend = blending(lattice, cells.centers, cells.frames)
    means = means_over_cells(lattice, blend, lambda first, stop: cells.inner(5, np.arange(first, stop)))
    values = np.random.default_rng(0).normal(size=cells.count)
    control = (blend @ values).reshape(lattice.shape)
    points, volume = cells.inner(5)
    place = (points.reshape(-1, 3) - lattice.origin) / lattice.edge
    at = np.array([spline_values(control, *(p[a : a + 1] for a in range(3))).item() for p in place])
    expected = (at.reshape(volume.shape) * volume).sum(axis=1) / volume.sum(axis=1)
    np.testing.assert_allclose(means @ values, expected, atol=1e-12)
    np.testing.assert_allclose(means @ np.ones(cells.count), 1.0)


def test_newton_steps_reach_every_cell_and_keep_to_the_bounds():
    """Values that are even between -1 and 1, of which the share above a level is known but for their noise."""
    cells = TUBE
    lattice = lattice_over(cells)
    blend = blending(lattice, cells.centers, cells.frames)
    means = means_over_cells(lattice, blend, lambda first, stop: cells.inner(4, np.arange(first, stop)))
    rng = np.random.default_rng(1)
    points, volume = cells.inner(24)
    value = rng.uniform(-1, 1, volume.shape).astype(np.float32)
    number = np.repeat(np.arange(cells.count, dtype=np.int32), volume.shape[1])
    place = ((points.reshape(-1, 3) - lattice.origin) / lattice.edge).astype(np.float32)
    samples = [CellSamples(place, number, value.ravel(), volume.ravel().astype(np.float32))]
    targets = rng.uniform(0.45, 0.55, cells.count)

    def measure(values):
        return porosities_and_slopes(samples, (blend @ values).reshape(lattice.shape), cells.count, 0.1)

    known, start = np.ones(cells.count, bool), np.zeros(cells.count)
    fit = fit_cells(measure, means, known, targets, start, (-0.9, 0.9), 2e-3, 12)
    assert np.abs(fit.errors).max() <= 2e-3
    assert not fit.at_bound.any()
    assert 1 < fit.steps < 8
    narrow = fit_cells(measure, means, known, targets, start, (-0.03, 0.03), 2e-3, 12)
    assert narrow.at_bound.any()
    assert np.abs(narrow.values).max() <= 0.03
    # cells without an equation lie between those around them
    some = np.arange(cells.count) % 4 > 0
    free = fit_cells(measure, means, some, targets, start, (-0.9, 0.9), 2e-3, 12)
    assert np.abs(free.errors[some]).max() <= 2e-3
    assert np.abs(free.values[~some]).max() <= np.abs(free.values[some]).max()
