"""Fields of plugins: what a formula returns is looked at when the stage has made its field, not layers later."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from sppm_pipeline.features.stiffness.stages.homogenize_voxel import HomogenizeVoxel
from sppm_pipeline.method.fields.formula import FormulaField
from sppm_pipeline.method.fields.scalar_field import ScalarField
from sppm_pipeline.method.nouns.voxels import Voxels
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.testing.plain_context import PlainContext


@dataclass(frozen=True, eq=False, kw_only=True)
class Given(FormulaField):
    """A field of any function."""

    f: object

    def evaluate(self, x, y, z):
        return self.f(x, y, z)


WRONG = {
    "axes in another order": (
        lambda x, y, z: (x + y + z).T,
        r"shape \(x, y, z\) = \(2, 4, 3\).* got float64 \(3, 4, 2\)",
    ),
    "truth values": (lambda x, y, z: x + y + z < 1, "bool"),
    "nothing": (lambda x, y, z: None, "object"),
    "a hole": (lambda x, y, z: np.where(x + y + z > 0.5, np.nan, x), "finite numbers, got nan"),
}


@pytest.mark.parametrize("how", WRONG)
def test_a_formula_that_returns_something_else_is_found_before_it_is_used(how):
    f, said = WRONG[how]
    with pytest.raises(ValueError, match=said):
        Given(f=f).check()


def test_a_formula_may_return_as_little_as_it_depends_on():
    for f in (
        lambda x, y, z: x + y * z,
        lambda x, y, z: np.cos(z),
        lambda x, y, z: 0.5,
        lambda x, y, z: np.where(x, 1, -1),
    ):
        Given(f=f).check()
    with pytest.raises(ValueError, match="`edge_mm` of a field is a length above 0"):
        Given(f=lambda x, y, z: x, edge=-1.0).check()
    with pytest.raises(ValueError, match="3 whole numbers above 0"):
        Given(f=lambda x, y, z: x, region=(0, 1, 1)).check()


@dataclass(frozen=True, eq=False)
class Tilted(ScalarField):
    """A plane, in whatever order NumPy likes."""

    cells: ClassVar = (1, 1, 1)
    periodic: ClassVar = True

    def sample_layers(self, grid, start, stop, threads=1):
        x, y, z = np.meshgrid(*(grid.axis(axis) for axis in range(3)), indexing="ij")
        return (x + 2 * y + 4 * z - 3)[:, :, start:stop].astype(np.float32)


def test_volumes_are_indexed_x_y_z_whatever_their_order_in_memory():
    grid = Grid((0.1, 0.2, 0.3), (0.3, 0.2, 0.1), (3, 4, 5))
    formula = Given(f=lambda x, y, z: x + 2 * y + 4 * z - 3, region=(1, 2, 1))
    for field in (Tilted(), formula):
        field.check()
        values, solid = field.sample(grid), field.solid(grid)
        assert values.flags.f_contiguous
        assert solid.flags.f_contiguous
        for i, j, k in np.ndindex(grid.shape):
            x, y, z = (grid.axis(axis)[index] for axis, index in enumerate((i, j, k)))
            assert values[i, j, k] == pytest.approx(x + 2 * y + 4 * z - 3, abs=1e-6)
        assert np.array_equal(solid, values < 0)
        layers = field.sample_zyx(grid, 1, 4)
        assert layers.flags.c_contiguous
        assert np.array_equal(layers, values.T[1:4])
    image = Voxels.from_array(solid, periodic=True)
    assert np.array_equal(HomogenizeVoxel().cell_of(PlainContext(), image).phase, solid)
    cell = HomogenizeVoxel(resolution=4, fractions="binary").cell_of(PlainContext(), Tilted())
    assert np.array_equal(cell.phase, Tilted().solid(4))
    exact = HomogenizeVoxel(resolution=4).cell_of(PlainContext(), Tilted()).fraction
    assert np.array_equal(exact == 1, Tilted().sample(4) < -0.8)  # a voxel reaches 7/8 up and down the plane
