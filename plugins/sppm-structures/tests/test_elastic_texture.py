"""``field.elastic_texture``: the 15 kinds of nodes, symmetry, connectivity, sizes, tuning."""

from itertools import permutations, product

import numpy as np
import pytest
from sppm_structures.elastic_texture import ElasticTexture
from sppm_structures.graphs import LATTICES
from sppm_structures.textures import KINDS, TEXTURES, read_pattern, texture_graph

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.surface.stages.extract_marching_cubes import MarchingCubes
from sppm_pipeline.method.stages.check_connectivity import CheckConnectivity
from sppm_pipeline.method.stages.tile_periodic import PeriodicTiling
from sppm_pipeline.method.stages.tune_porosity import TunePorosity
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.grid import Grid, cell_centers, cell_nodes
from sppm_pipeline.testing.contracts import StageContract
from sppm_pipeline.testing.plain_context import PlainContext, recipe_of


def made(**options):
    stage = ElasticTexture(**options)
    stage.check_options()
    return stage.run(PlainContext())


class TestContract(StageContract):
    def stages(self):
        own = ElasticTexture(pattern="cf-ev f-cf", weights="cf=1:2", radii="ev=1.5", edge=Length(3.0))
        return [*(ElasticTexture(preset=name) for name in TEXTURES), own]


def test_kinds_of_nodes():
    assert len(KINDS) == 15
    assert read_pattern("ve-fc, cfev-v") == (("ev", "cf"), ("cfev", "v"))


# lattices that are textures: center, face, edge, corner
@pytest.mark.parametrize(
    ("pattern", "lattice"),
    [("e-v", "simple_cubic"), ("c-v", "bcc"), ("f-v", "fcc"), ("cf-e", "re_entrant")],
)
def test_known_lattices(pattern, lattice):
    ours, known = made(pattern=pattern, blend=Length(0.0)), LATTICES[lattice]()
    spread = np.linalg.norm(known.ends - known.starts, axis=1).sum()
    assert np.linalg.norm(ours.ends - ours.starts, axis=1).sum() == pytest.approx(spread)
    middles = {tuple(row) for row in np.round((known.starts + known.ends) / 2 % 1, 6)}
    if lattice != "simple_cubic":  # whose struts are cut in two
        assert {tuple(row) for row in np.round((ours.starts + ours.ends) / 2 % 1, 6)} == middles


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_node_has_all_its_mirror_images(kind):
    """As many as 48 over those symmetries that leave it where it is."""
    pattern = "e-v" if kind in "ev" else f"{kind}-v e-v"
    graph = made(pattern=pattern)
    nodes = {tuple(p) for p in np.round(np.concatenate([graph.starts, graph.ends]) % 1 % 1, 6)}
    moved = {
        tuple(np.round((0.5 + np.array(p)[list(order)] * signs) % 1, 6))
        for p in [np.array(node) - 0.5 for node in nodes]
        for order in permutations(range(3))
        for signs in product((1, -1), repeat=3)
    }
    assert {tuple(v % 1.0 for v in p) for p in moved} == {tuple(v % 1.0 for v in p) for p in nodes}


@pytest.mark.parametrize("preset", TEXTURES)
def test_fields_have_the_symmetry_of_the_cube(preset):
    values = made(preset=preset).sample(cell_centers(14))
    for order in permutations(range(3)):
        assert values.transpose(order) == pytest.approx(values, abs=1e-6)
    for axis in range(3):
        assert np.flip(values, axis) == pytest.approx(values, abs=1e-6)


@pytest.mark.parametrize("preset", TEXTURES)
def test_opposite_faces_are_equal_to_the_last_bit(preset):
    values = made(preset=preset).sample(cell_nodes(19))
    for axis in range(3):
        assert (np.take(values, 0, axis) == np.take(values, -1, axis)).all()


def test_nodes_have_their_places_and_radii():
    field = made(pattern="c-cv cv-v", weights="cv=1:3", radii="cv=1.5", blend=Length(0.0), radius=Length(0.04))
    values = field.sample(Grid((0.125, 0.125, 0.125), (0.375,) * 3, (2, 2, 2)))
    assert values[0, 0, 0] == pytest.approx(-0.06)
    assert values[1, 1, 1] == pytest.approx(-0.04)
    turned = made(pattern="c-cv cv-v", weights="vc=3:1", radii="vc=1.5", blend=Length(0.0), radius=Length(0.04))
    assert (turned.starts == field.starts).all()
    assert (turned.radii == field.radii).all()


@pytest.mark.parametrize("preset", TEXTURES)
def test_density_is_reached_and_solid_and_void_run_through(preset):
    tuned = TunePorosity(target=0.7).run(PlainContext(), recipe_of(ElasticTexture(preset=preset, edge=Length(5.0))))
    n = 101
    grid = Grid((0.31 / n, 0.72 / n, 0.17 / n), (1 / n,) * 3, (n,) * 3)
    assert float((tuned.sample(grid) >= 0).mean()) == pytest.approx(0.7, abs=0.0015)
    CheckConnectivity(bicontinuous=True).run(PlainContext(), tuned)
    tiling = PeriodicTiling(cells=(2, 1, 1)).run(PlainContext(), tuned, None)
    assert MarchingCubes(resolution=24).run(PlainContext(), tiling).bounds_solid


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"pattern": "c"}, "no edge"),
        ({"pattern": "c-c"}, "no edge"),
        ({"pattern": "c-x"}, "no edge"),
        ({"pattern": ""}, "at least one"),
        ({"pattern": "c-v v-c"}, "twice"),
        ({"pattern": "c-v", "weights": "cv=1:2"}, "no node"),
        ({"pattern": "c-cv cv-v", "weights": "cv=1"}, "2 positive"),
        ({"pattern": "c-cv cv-v", "weights": "cv=1:-2"}, "2 positive"),
        ({"pattern": "c-v", "radii": "c=nan"}, "1 positive"),
        ({"radii": "c=2"}, "preset"),
        ({"radius": Length(0.3)}, "less than"),
        ({"radius": Length(0.1), "repeat": 4}, "less than"),
    ],
)
def test_patterns_that_are_none(options, said):
    with pytest.raises(ConfigError, match=said):
        made(**options)


@pytest.mark.parametrize("pattern", ["c-cf", "e-v c-f", "c-cv e-v"])
def test_struts_that_do_not_hang_together(pattern):
    with pytest.raises(DesignError, match="not all connected"):
        made(pattern=pattern)


def test_a_graph_is_made_once():
    texture = TEXTURES["braced_frame"]
    assert len(texture_graph(texture).starts) == 8 + 6
