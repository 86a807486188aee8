"""``field.organic``: the graph, the sum of kernels, borders, tuning."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree
from sppm_structures.organic import Organic, near_pairs

from sppm_pipeline.errors import ConfigError, ResourceError
from sppm_pipeline.features.surface.stages.extract_marching_cubes import MarchingCubes
from sppm_pipeline.method.kernels.kernels import Kernels
from sppm_pipeline.method.stages.check_connectivity import CheckConnectivity
from sppm_pipeline.method.stages.read_primitive import ReadPrimitive
from sppm_pipeline.method.stages.tune_porosity import TunePorosity
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.testing.contracts import StageContract
from sppm_pipeline.testing.exact_sum import exact_sum
from sppm_pipeline.testing.plain_context import PlainContext, recipe_of


def made(cover=None, seed=1, **options):
    return Organic(**options).run(PlainContext(seed), cover)


class TestContract(StageContract):
    def stages(self):
        return [Organic(cells=(1, 1, 1)), Organic(cells=(2, 1, 1), spacing=Length(1.0, "mm"), edge=Length(3.0))]


@settings(deadline=None, derandomize=True, max_examples=25)
@given(st.integers(0, 2**32), st.integers(2, 60))
def test_pairs_are_those_of_the_definition_and_hold_the_shortest_tree(seed, count):
    points = np.random.default_rng(seed).random((count, 3))
    d = np.linalg.norm(points[:, None] - points[None], axis=2)
    expected = {
        (i, j) for i in range(count) for j in range(i + 1, count) if not (np.maximum(d[i], d[j]) < d[i, j]).any()
    }
    assert set(map(tuple, near_pairs(points, 9.0).tolist())) == expected
    tree = minimum_spanning_tree(d).tocoo()
    assert {tuple(sorted(pair)) for pair in zip(tree.row.tolist(), tree.col.tolist(), strict=True)} <= expected


def test_pores_keep_their_distance_and_are_connected():
    field = made(cells=(2, 1, 1), spacing=Length(0.3))
    d = np.linalg.norm(field.pores[:, None] - field.pores[None], axis=2)
    assert (d + np.eye(len(d))).min() >= 0.3
    a, b = field.tunnels.T
    graph = coo_matrix((np.ones(len(a)), (a, b)), shape=d.shape)
    assert connected_components(graph, directed=False)[0] == 1
    assert d[a, b].max() < 2 * 0.3


def test_values_are_the_sum_of_all_kernels():
    field = made(cells=(2, 1, 1))
    grid = Grid((-0.02, 0.1, 0.3), (0.13, 0.11, 0.09), (16, 8, 7))
    points = np.stack(np.meshgrid(*(grid.axis(a) for a in range(3)), indexing="ij"), -1).reshape(-1, 3)
    n, (starts, ends) = len(field.pores), (field.pores[field.tunnels[:, end]] for end in range(2))
    kernels = Kernels(field.pores, np.full(n, field.omega), starts, ends, np.full(len(starts), field.mu))
    expected = exact_sum(kernels, points) - field.level
    assert field.sample(grid).reshape(-1) == pytest.approx(expected, abs=5e-4)


def test_layers_and_threads_give_the_same_bytes():
    field, grid = made(cells=(2, 2, 1)), Grid((0.013, 0.2, 0.07), (1 / 37,) * 3, (90, 70, 40))
    whole = field.sample(grid)
    assert (field.sample(grid, 2) == whole).all()
    assert (field.sample_layers(grid, 11, 29) == whole[:, :, 11:29]).all()


def test_density_is_reached_and_solid_and_void_run_through():
    tuned = TunePorosity(target=0.6).run(PlainContext(), recipe_of(Organic(cells=(1, 1, 1), edge=Length(5.0))))
    n = 101
    grid = Grid((0.31 / n, 0.72 / n, 0.17 / n), (1 / n,) * 3, (n,) * 3)
    assert float((tuned.sample(grid) >= 0).mean()) == pytest.approx(0.6, abs=0.002)
    CheckConnectivity(bicontinuous=True).run(PlainContext(), tuned)
    assert MarchingCubes(resolution=40).run(PlainContext(), tuned).bounds_solid


def test_a_part_is_covered():
    ball = ReadPrimitive(shape="ball", size=(Length(10.0),) * 3).run(PlainContext())
    field = made(cover=ball, edge=Length(4.0), spacing=Length(1.0, "mm"))
    assert field.cells == (3, 3, 3)
    assert field.origin_mm == pytest.approx(ball.lower - 1)
    assert field.pores.min() < 0
    assert field.pores.max() > 3


def test_sizes_that_make_no_sense():
    with pytest.raises(ConfigError, match="no part to cover"):
        made()
    with pytest.raises(ConfigError, match="don't fit"):
        made(cells=(1, 1, 1), pore_radius=Length(2.0))
    with pytest.raises(ResourceError, match="limit"):
        made(cells=(400, 400, 400))
