"""Fields that are bent: the sign is that of the field at the place from which a point came."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest

from sppm_pipeline.features.grading.curved_cells import CylinderCells, HexahedralCells
from sppm_pipeline.features.grading.numerics.hexahedral_mesh import checked_mesh
from sppm_pipeline.features.grading.warped_field import has_cubic_symmetry, warped_field
from sppm_pipeline.method.fields.formula import FormulaField
from sppm_pipeline.method.fields.scalar_field import RepeatedField
from sppm_pipeline.services.grid import Grid
from tests.features.grading.hexahedral_meshes import star


@dataclass(frozen=True, eq=False, kw_only=True)
class Waves(FormulaField):
    """A network as Schwarz P, or a thin wall whose distance grows without bound where the slope vanishes."""

    wall: bool = False
    tilt: float = 0.0

    def evaluate(self, x, y, z):
        turn = 2 * np.pi
        f = np.cos(turn * x) + (1 + self.tilt) * np.cos(turn * y) + np.cos(turn * z)
        if not self.wall:
            return f
        slope = np.sqrt(np.sin(turn * x) ** 2 + np.sin(turn * y) ** 2 + np.sin(turn * z) ** 2)
        return np.abs(f) / np.maximum(turn * slope, 1e-3) - 0.06


def grid_over(field, n):
    return Grid((0.013,) * 3, (1 / n,) * 3, tuple(n * c for c in field.cells))


def places_of(field, grid):
    axes = [field.origin[a] + field.edge * grid.axis(a) for a in range(3)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)


@pytest.mark.parametrize("wall", [False, True])
def test_flips_against_the_formula_itself(wall):
    base = Waves(edge=2.0, wall=wall)
    tube = CylinderCells((10, 2, 2), 2.0, 2.0, 2 * math.pi)
    field = warped_field(RepeatedField(base, (10, 2, 2), 2.0), tube, 64)
    field.check()
    grid = grid_over(field, 20)
    points = places_of(field, grid)
    inside = tube.places(points).cell >= 0
    u = tube.unmapped(points[inside])
    expected = base.evaluate(*(u[:, a] for a in range(3))) < 0
    found = field.sample(grid).reshape(-1)[inside] < 0
    assert 0.1 < expected.mean() < 0.9
    assert (found != expected).mean() < 1e-4
    # void beyond half a cell, but not at the surface itself
    r = np.hypot(points[:, 0], points[:, 1])
    values = field.sample(grid).reshape(-1)
    assert (values[(r < 0.99) | (r > 7.01)] > 0).all()
    beside = (r > 6.02) & (r < 6.5)
    assert 0.05 < (values[beside] < 0).mean() < 0.95
    np.testing.assert_array_equal(field.sample(grid, threads=2), field.sample(grid))
    np.testing.assert_array_equal(field.sample_layers(grid, 7, 9), field.sample(grid)[:, :, 7:9])


def test_a_cell_alike_from_all_sides_fills_a_mesh_without_seams():
    """Five cells around an edge: values meet at the faces between them; a gyroid's would not."""
    base = Waves(edge=2.0)
    assert has_cubic_symmetry(base)
    assert not has_cubic_symmetry(Waves(edge=2.0, tilt=0.2))
    cells = HexahedralCells(checked_mesh(*star(5, 2.0)).corners)
    field = warped_field(base, cells, 32)
    t = np.linspace(0.05, 0.95, 7)
    u, v = (a.ravel() for a in np.meshgrid(t, t, indexing="ij"))
    for side in (1e-7, 1 - 1e-7):
        within = np.stack([np.full_like(u, side), u, v], 1)
        points = cells.points(np.zeros(len(u), int), within)
        turned = cells.points(np.zeros(len(u), int), within + np.array([np.sign(side - 0.5) * 2e-7, 0, 0]))
        np.testing.assert_allclose(field._at(points), field._at(turned), atol=1e-4)
    least, most = field.stretch
    assert least < 1 < most
