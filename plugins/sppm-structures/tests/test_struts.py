"""``field.struts``: graphs, exact distances, blending, files, tuning."""

import json

import numpy as np
import pytest
from sppm_structures.graphs import LATTICES, images, strut_graph
from sppm_structures.struts import Struts, read_graph

from sppm_pipeline.errors import ConfigError, InputError
from sppm_pipeline.features.surface.stages.extract_marching_cubes import MarchingCubes
from sppm_pipeline.method.stages.check_connectivity import CheckConnectivity
from sppm_pipeline.method.stages.tile_periodic import PeriodicTiling
from sppm_pipeline.method.stages.tune_porosity import TunePorosity
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.grid import Grid, cell_nodes
from sppm_pipeline.testing.contracts import StageContract
from sppm_pipeline.testing.plain_context import PlainContext, recipe_of


def made(**options):
    return Struts(**options).run(PlainContext())


def porosity(field, n=64):
    """On a grid that no strut lies along."""
    return float((field.sample(Grid((0.31 / n, 0.72 / n, 0.17 / n), (1 / n,) * 3, (n,) * 3)) >= 0).mean())


class TestContract(StageContract):
    def stages(self):
        return [Struts(), Struts(lattice="kelvin", repeat=2, edge=Length(3.0), blend=Length(0.0))]


# struts of a cell, and their total length in cell sizes
COUNTS = {
    "simple_cubic": (3, 3.0),
    "bcc": (8, 4 * 3**0.5),
    "fcc": (12, 6 * 2**0.5),
    "octet": (24, 12 * 2**0.5),
    "kelvin": (24, 6 * 2**0.5),
    "diamond": (16, 4 * 3**0.5),
    "re_entrant": (24, 6 * 5**0.5),
}


@pytest.mark.parametrize("lattice", LATTICES)
def test_struts_of_a_cell(lattice):
    graph = LATTICES[lattice]()
    count, length = COUNTS[lattice]
    assert len(graph.starts) == count
    assert np.linalg.norm(graph.ends - graph.starts, axis=1).sum() == pytest.approx(length)
    assert (graph.starts >= 0).all()
    assert (graph.starts < 1).all()


@pytest.mark.parametrize("lattice", LATTICES)
def test_sharp_fields_are_distances_to_all_images(lattice):
    """Against every strut of 5 x 5 x 5 cells, point by point."""
    field, graph = made(lattice=lattice, blend=Length(0.0), radius=Length(0.07)), LATTICES[lattice]()
    grid = Grid((0.01, 0.3, 0.2), (0.173, 0.119, 0.211), (5, 6, 4))
    points = np.stack(np.meshgrid(*(grid.axis(a) for a in range(3)), indexing="ij"), -1).reshape(-1, 3)
    best = np.full(len(points), np.inf)
    for shift in np.stack(np.meshgrid(*[np.arange(-2, 3)] * 3), -1).reshape(-1, 3):
        for a, b in zip(graph.starts + shift, graph.ends + shift, strict=True):
            t = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
            best = np.minimum(best, np.linalg.norm(points - a - t[:, None] * (b - a), axis=1))
    assert field.sample(grid).reshape(-1) == pytest.approx(best - 0.07, abs=1e-6)


@pytest.mark.parametrize("lattice", LATTICES)
@pytest.mark.parametrize("blend", [0.0, 0.03])
def test_opposite_faces_are_equal_to_the_last_bit(lattice, blend):
    values = made(lattice=lattice, blend=Length(blend)).sample(cell_nodes(19))
    for axis in range(3):
        assert (np.take(values, 0, axis) == np.take(values, -1, axis)).all()


def test_blending_is_the_smooth_minimum_of_all_struts():
    blend, field = 0.03, made(lattice="bcc", blend=Length(0.03))
    spread = images(LATTICES["bcc"](), 1.5)
    points = np.random.default_rng(0).random((40, 3))
    for point in points:
        distances = []
        for a, b in zip(spread.starts, spread.ends, strict=True):
            t = np.clip((point - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
            distances.append(np.linalg.norm(point - a - t * (b - a)) - 0.05)
        away = np.array(distances) - min(distances)
        expected = min(distances) - blend * np.log((np.clip(1 - away / (4 * blend), 0, 1) ** 4).sum())
        value = field.sample(Grid(tuple(point), (1.0,) * 3, (1, 1, 1)))[0, 0, 0]
        assert value == pytest.approx(expected, abs=1e-6)


def test_thin_struts_have_the_volume_of_cylinders():
    radius = 0.1
    dense = 1 - porosity(made(lattice="simple_cubic", radius=Length(radius), blend=Length(0.0)), 100)
    assert dense == pytest.approx(3 * np.pi * radius**2 - 8 * 2**0.5 * radius**3, rel=0.01)


@pytest.mark.parametrize("lattice", LATTICES)
def test_density_is_reached_and_solid_and_void_stay_connected(lattice):
    tuned = TunePorosity(target=0.7).run(PlainContext(), recipe_of(Struts(lattice=lattice, edge=Length(5.0))))
    assert porosity(tuned, 123) == pytest.approx(0.7, abs=0.0015)
    assert 0.02 < tuned.summary()["radius"] < 0.3
    assert tuned.summary()["radius_mm"] == pytest.approx(5 * tuned.summary()["radius"])
    context = PlainContext()
    CheckConnectivity(bicontinuous=True).run(context, tuned)


def test_a_block_of_cells_becomes_a_closed_mesh():
    tiling = PeriodicTiling(cells=(1, 2, 1)).run(PlainContext(), made(edge=Length(4.0), radius=Length(0.4, "mm")), None)
    mesh = MarchingCubes(resolution=24).run(PlainContext(), tiling)
    assert mesh.bounds_solid


def test_layers_and_threads_give_the_same_bytes():
    field, grid = made(lattice="diamond", repeat=3), Grid((0.013, 0.2, 0.07), (1 / 37,) * 3, (90, 70, 60))
    whole = field.sample(grid)
    assert (field.sample(grid, 2) == whole).all()
    assert (field.sample_layers(grid, 11, 29) == whole[:, :, 11:29]).all()


def test_copies_count_once():
    graph = strut_graph([[0, 0, 0], [1, 1, 1], [0, 0, 0.0]], [[0, 0, 1], [1, 1, 2], [0, 0, -1.0]])
    assert len(graph.starts) == 1


@pytest.fixture
def write(tmp_path):
    def write(name, text):
        (tmp_path / name).write_text(text if isinstance(text, str) else json.dumps(text))
        return tmp_path / name

    return write


def test_a_graph_of_ones_own(write):
    nodes = [[0.5, 0.5, 0.5], [0, 0, 0]]
    path = write("a.json", {"nodes": nodes, "edges": [[0, 1]], "radii": [1.0, 2.0]})
    field = made(path=path, blend=Length(0.0), radius=Length(0.1))
    at_ends = field.sample(Grid((0, 0, 0), (0.5, 0.5, 0.5), (2, 2, 2)))
    assert at_ends[0, 0, 0] == pytest.approx(-0.2)
    assert at_ends[1, 1, 1] == pytest.approx(-0.1)
    rows = read_graph(write("a.csv", "x1,y1,z1,x2,y2,z2\n# a comment\n0,0,0,.5,.5,.5\n\n0,0,0,1,0,0\n"))
    assert len(rows.starts) == 2


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.json", "{", "no graph"),
        ("a.json", "[1]", "no graph"),
        ("a.json", {"nodes": [[0, 0]], "edges": []}, "no graph"),
        ("a.json", {"nodes": [[0, 0, 0]], "edges": [[0, 1]]}, "node 1"),
        ("a.json", {"nodes": [[0, 0, 0]], "edges": [[0, -1]]}, "node -1"),
        ("a.json", {"nodes": [[0, 0, 0]], "edges": []}, "at least one"),
        ("a.json", {"nodes": [[0, 0, 0], [0, 0, 0]], "edges": [[0, 1]]}, "long"),
        ("a.json", {"nodes": [[0, 0, 0], [9, 0, 0]], "edges": [[0, 1]]}, "long"),
        ("a.json", '{"nodes": [[0, 0, 0], [NaN, 0, 0]], "edges": [[0, 1]]}', "finite"),
        ("a.json", {"nodes": [[0, 0, 0], [1, 0, 0]], "edges": [[0, 1]], "radii": [1, -1]}, "radius"),
        ("a.json", "[" * 100_000, "no graph"),
        ("a.csv", "0,0,0,1,0\n", "a.csv:1"),
        ("a.csv", "0,0,0,1,0,0\n0,0,0,x,0,0\n", "a.csv:2"),
        ("a.csv", "", "at least one"),
        ("a.txt", "", "json or"),
    ],
)
def test_files_that_are_no_graph(write, name, text, said):
    with pytest.raises(InputError, match=said):
        made(path=write(name, text))


def test_sizes_that_make_no_sense(tmp_path):
    with pytest.raises(ConfigError, match="half the cell size"):
        made(radius=Length(0.6))
    with pytest.raises(ConfigError, match="physical unit"):
        made(radius=Length(0.6, "mm"))
    with pytest.raises(InputError, match="cannot read"):
        made(path=tmp_path / "none.json")
