"""What `estimate` says of fields of structures, against fields that were made."""

import numpy as np
import pytest
from sppm_structures.elastic_texture import ElasticTexture
from sppm_structures.organic import Organic
from sppm_structures.spinodoid import Spinodoid
from sppm_structures.stochastic_gyroid import StochasticGyroid
from sppm_structures.struts import Struts
from sppm_structures.tpms import Tpms
from sppm_structures.voronoi_foam import Voronoi

import sppm_pipeline as sppm
from sppm_pipeline import Length, Size
from sppm_pipeline.engine.plan.estimate import table
from sppm_pipeline.nouns import Geometry
from sppm_pipeline.nouns.palette import Palette
from sppm_pipeline.numerics import cell_centers

N = 32
ONE = Palette()
MADE = [
    Tpms(surface="lidinoid"),
    Tpms(surface="schwarz_p", form="sheet"),
    Tpms(surface="gyroid", form="sheet", repeat=2, thickness=Length(0.06)),
    Struts(lattice="octet"),
    Struts(lattice="kelvin", repeat=2, radius=Length(0.04)),
    ElasticTexture(preset="star_faces"),
    Voronoi(),
    Voronoi(form="closed", seeds=3, thickness=Length(0.06)),
    Voronoi(layout="part", cells=(2, 1, 1)),
    Spinodoid(density=0.3),
    StochasticGyroid(repeat=2),
    Organic(cells=(1, 1, 1), spacing=Length(0.3)),
]


def estimated(stage):
    """The size of a field, whatever ports its stage has."""
    ports = {"field.voronoi_foam": {"pores": None, "cover": None}, "field.organic": {"cover": None}}
    return stage.estimate(ONE, **ports.get(stage.name, {}))


@pytest.mark.parametrize("stage", MADE, ids=lambda stage: stage.name)
def test_solid_and_surface_are_about_those_of_the_field(stage):
    """Within a tenth of the volume, and a third of the area."""
    options = {name: value for name, value in vars(stage).items() if value != getattr(type(stage), name)}
    family, name = stage.name.split(".")
    seed = {"seed": 2} if stage.is_random else {}
    field = getattr(getattr(sppm, family), name)(**options, **seed)
    solid = field.sample(cell_centers(N, field.cells), 1) < 0
    crossed = sum(np.count_nonzero(np.diff(solid.view(np.int8), axis=axis)) for axis in range(3))
    made = estimated(stage).body
    assert made.box == tuple(map(float, field.cells))
    assert 1 - made.porosity == pytest.approx(solid.mean(), abs=0.1)
    assert made.surface * made.volume == pytest.approx(crossed / 1.5 / N**2, rel=0.35)


def test_fields_that_cost_more_are_estimated_to():
    """Nanoseconds of a sample that were measured, in the order of the estimates."""
    work = [
        estimated(stage).body.kernels
        for stage in (Spinodoid(), Tpms(form="sheet"), Voronoi(form="closed"), Voronoi(), Struts(repeat=3))
    ]  # 8, 42, 145, 268 and 720 ns
    assert work == sorted(work)
    assert 30 < work[-1] / work[0] < 120


def test_a_foam_in_a_part_has_the_cells_that_cover_it():
    part = Size(geometry=Geometry(edge_mm=1.0, box=(12.0, 7.0, 4.0), volume=200.0))
    foam = Voronoi(layout="part", edge=Length(4.0, "mm"))
    made = foam.estimate(ONE, None, part)
    assert made.body.box == (3, 2, 1)
    assert made.units() == {"cells": 6, "pores": 6 * 64, "resident": 6 * (35 + 64)}
    assert Voronoi(edge=Length(4.0, "mm")).estimate(ONE, None, part).cells == 1  # repeats; the part is not filled by it
    with pytest.raises(LookupError, match="size of a cell"):
        Voronoi(layout="part").estimate(ONE, None, part)


def test_all_fields_have_rates():
    assert {stage.name for stage in MADE} <= set(table())
