"""Parts whose surface cuts no pore: what is left out, and that the walls hold."""

import numpy as np
import pytest

import sppm_pipeline as sppm
from sppm_pipeline import Length
from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.part.primitive_meshes import ball_mesh
from sppm_pipeline.method.part.whole_pores import SHARE, with_whole_pores
from sppm_pipeline.method.stages.fill_implicit import ImplicitFill
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.testing.plain_context import PlainContext

RADIUS, WALL = 6.0, 0.4
CELL = [
    {"stage": "sample.dart_throwing", "total": 40, "share": 0.5},
    {"stage": "connect.mbdst", "degree": [2, 5], "mode": "greedy"},
    {"stage": "field.gaussian", "pore_radius": 0.13, "tunnel_radius": 0.04},
]


@pytest.fixture(scope="module")
def large_ball():
    return SurfaceMesh(*ball_mesh((1.0, 2.0, 3.0), RADIUS, 4), name="ball")


@pytest.fixture(scope="module")
def scattered(large_ball):
    return sppm.tile.scattered(large_ball, recipe=CELL, cell="4 mm", porosity=0.6, seed=5)


def test_pores_and_tunnels_that_stay_are_those_of_a_ball_a_wall_inside(scattered, large_ball):
    closed, stays = with_whole_pores(scattered, large_ball.vertices[large_ball.faces], WALL)
    micro, old = closed.tileset.micro, scattered.tileset.micro
    micro.check()
    closed.check()
    kernels = old.pieces.kernels
    assert np.ptp(kernels.omega) == 0 == np.ptp(kernels.mu)
    pore = 4 * np.sqrt(np.log(1 / (SHARE * old.level)) / kernels.omega[0])
    tunnel = 4 * np.log(1 / (SHARE * old.level)) / kernels.mu[0]
    blocks = old.graph.pores.blocks.sites - scattered.arrays.halo
    middle = np.array([1.0, 2.0, 3.0])

    def places(graph):
        corner = np.array(scattered.origin) + 4 * blocks[graph.pores.piece]
        start, end = graph.segments(slice(None))
        first = corner[graph.edges[:, 0]]
        return corner + 4 * graph.pores.centers, first + 4 * start, first + 4 * end

    before, *_ = places(old.graph)
    far = np.linalg.norm(before - middle, axis=1)
    sure = abs(far + pore + WALL - RADIUS) > 0.03  # triangles lie inside of the ball
    assert np.array_equal(stays[sure], (far + pore + WALL < RADIUS)[sure])
    after, *ends = places(micro.graph)
    assert np.array_equal(after, before[stays])
    # no tunnel leads to a pore that has gone, and none comes nearer than its radius and the wall
    assert 0 < len(micro.graph.edges) <= stays[old.graph.edges].all(1).sum()
    assert max(np.linalg.norm(end - middle, axis=1).max() for end in ends) + tunnel + WALL < RADIUS + 0.03
    # kernels are those of the graph, in its order
    own = micro.pieces.kernels
    assert np.array_equal(own.centers, micro.graph.pores.centers)
    start, _ = micro.graph.segments(micro.tunnel_order)
    assert np.array_equal(own.starts, start)
    assert micro.pieces.first_pore[-1] == len(own.omega)
    assert micro.pieces.first_tunnel[-1] == len(own.mu)


@pytest.mark.parametrize("seed", [1, 2])
def test_void_of_a_closed_part_reaches_the_surface_nowhere(large_ball, seed):
    tiling = sppm.tile.scattered(large_ball, recipe=CELL, cell="4 mm", porosity=0.6, seed=seed)
    context = PlainContext()
    part = ImplicitFill(border="closed", thinnest=Length(WALL)).run(context, tiling, large_ball)
    edge, count, h = 4.0, 104, 0.12
    origin = tuple(((np.array([1.0, 2.0, 3.0]) - h * (count - 1) / 2) - tiling.origin) / edge)
    solid = part.solid(Grid(origin, (h / edge,) * 3, (count,) * 3))
    axis = h * (np.arange(count) - (count - 1) / 2)
    far = np.sqrt(sum(np.meshgrid(axis**2, axis**2, axis**2, indexing="ij")))
    assert solid[(far < RADIUS - 0.05) & (far > RADIUS - 0.75 * WALL)].all()
    assert 0.1 < 1 - solid[far < RADIUS - 0.05].mean() < 0.6
    assert context.reported["whole_pores"] > 20
    assert context.reported["sealed_mm3"] > 50


def test_what_has_no_pores_to_leave_out_is_refused(wang_tiling, scattered, large_ball):
    triangles = large_ball.vertices[large_ball.faces]
    with pytest.raises(ConfigError, match="repeats, or has none"):
        with_whole_pores(wang_tiling, triangles, WALL)
    with pytest.raises(DesignError, match="no pore with a wall of 5 mm"):
        with_whole_pores(scattered, triangles, 5.0)
