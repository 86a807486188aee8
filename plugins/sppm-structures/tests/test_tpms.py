"""``field.tpms``: symmetry, known areas, thickness, tuning, periodicity."""

import numpy as np
import pytest
from sppm_structures.nodal import SURFACES
from sppm_structures.tpms import Tpms

from sppm_pipeline.errors import ConfigError
from sppm_pipeline.features.printing.stages.check_sizes import CheckSizes
from sppm_pipeline.features.surface.stages.extract_marching_cubes import MarchingCubes
from sppm_pipeline.method.stages.tile_periodic import PeriodicTiling
from sppm_pipeline.method.stages.tune_porosity import TunePorosity
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.grid import Grid, cell_centers, cell_nodes
from sppm_pipeline.testing.contracts import StageContract
from sppm_pipeline.testing.plain_context import PlainContext, recipe_of


def made(**options):
    return Tpms(**options).run(PlainContext())


def porosity(field, n=48):
    return float((field.sample(cell_centers(n)) >= 0).mean())


class TestContract(StageContract):
    def stages(self):
        return [Tpms(), Tpms(surface="lidinoid", form="sheet", edge=Length(3.0))]


@pytest.mark.parametrize("surface", SURFACES)
@pytest.mark.parametrize("form", ["network", "sheet"])
def test_opposite_faces_are_equal_to_the_last_bit(surface, form):
    values = made(surface=surface, form=form).sample(cell_nodes(17))
    for axis in range(3):
        assert (np.take(values, 0, axis) == np.take(values, -1, axis)).all()


@pytest.mark.parametrize("surface", SURFACES)
def test_the_slope_is_that_of_finite_differences(surface):
    nodal, h = SURFACES[surface], 1e-5
    x, y, z = np.linspace(0.1, 6, 7)[:, None, None], np.linspace(0.2, 5, 6)[:, None], np.linspace(0.3, 6.1, 5)
    steps = [(h, 0, 0), (0, h, 0), (0, 0, h)]
    squared = sum(
        ((nodal.value(x + a, y + b, z + c) - nodal.value(x - a, y - b, z - c)) / (2 * h)) ** 2 for a, b, c in steps
    )
    assert nodal.slope(x, y, z) == pytest.approx(np.sqrt(squared), abs=1e-7)


@pytest.mark.parametrize("surface", ["schwarz_p", "gyroid", "diamond", "neovius", "fischer_koch_s"])
def test_balanced_surfaces_halve_the_cell(surface):
    """f changes its sign under a shift or an inversion, so both sides are alike."""
    field = made(surface=surface)
    assert porosity(field, 50) == pytest.approx(0.5, abs=0.002)
    assert porosity(made(surface=surface, side="high"), 50) == pytest.approx(0.5, abs=0.002)


# areas of the true minimal surfaces in a cubic cell of edge 1; the nodal ones are within 3 % of them
@pytest.mark.parametrize(
    ("surface", "area"), [("schwarz_p", 2.3451), ("gyroid", 3.0915), ("diamond", 3.8377), ("iwp", 3.4641)]
)
def test_areas_are_those_of_the_minimal_surfaces(surface, area):
    context = PlainContext()
    CheckSizes(resolution=48).run(context, made(surface=surface))
    assert context.reported["specific_surface"] == pytest.approx(area, rel=0.03)


@pytest.mark.parametrize("surface", ["schwarz_p", "gyroid", "diamond"])
def test_thin_walls_are_as_thick_as_asked(surface):
    """Volume over area; to first order in the thickness."""
    context = PlainContext()
    CheckSizes(resolution=48).run(context, made(surface=surface))
    thin = 1 - porosity(made(surface=surface, form="sheet", thickness=Length(0.04)), 96)
    assert thin / context.reported["specific_surface"] == pytest.approx(0.04, rel=0.03)


@pytest.mark.parametrize("options", [{}, {"side": "high"}, {"form": "sheet"}, {"form": "sheet", "half_width": 0.3}])
@pytest.mark.parametrize("surface", ["gyroid", "lidinoid", "split_p"])
def test_any_density_is_reached(surface, options):
    tuned = TunePorosity(target=0.7).run(PlainContext(), recipe_of(Tpms(surface=surface, **options)))
    assert porosity(tuned, 83) == pytest.approx(0.7, abs=0.0015)  # on a grid of its own
    assert tuned.summary()["surface"] == surface


def test_repeats_and_sizes():
    twice = made(repeat=2, edge=Length(4, "mm"), form="sheet", thickness=Length(0.2, "mm"))
    assert twice.edge_mm == 4
    assert twice.summary()["thickness_mm"] == pytest.approx(0.2)
    values = twice.sample(cell_nodes(16))
    assert np.allclose(values[:8], values[8:16], atol=1e-6)
    with pytest.raises(ConfigError, match="physical unit"):
        made(form="sheet", thickness=Length(0.2, "mm"))


def test_layers_and_threads_give_the_same_bytes():
    field, grid = made(surface="lidinoid"), Grid((0.013, 0.2, 0.07), (1 / 37,) * 3, (80, 70, 60))
    whole = field.sample(grid)
    assert (field.sample(grid, 2) == whole).all()
    assert (field.sample_layers(grid, 11, 29) == whole[:, :, 11:29]).all()


def test_contradictions():
    with pytest.raises(ConfigError, match="exclude"):
        Tpms(form="sheet", thickness=Length(0.1), half_width=0.2).check_options()
    with pytest.raises(ConfigError, match="no thickness"):
        Tpms(thickness=Length(0.1)).check_options()


def test_a_block_of_cells_becomes_a_closed_mesh():
    tiling = PeriodicTiling(cells=(2, 1, 1)).run(PlainContext(), made(edge=Length(5, "mm")), None)
    mesh = MarchingCubes(resolution=16).run(PlainContext(), tiling)
    assert mesh.bounds_solid
    assert mesh.upper == pytest.approx([10, 5, 5])
