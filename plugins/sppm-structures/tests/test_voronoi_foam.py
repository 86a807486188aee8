"""``field.voronoi_foam``: exact distances against all seeds, periodicity, parts without repetition, tuning."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import Voronoi as Diagram
from sppm_structures.seeds import HashedSeeds, images_near
from sppm_structures.voronoi_foam import Voronoi
from sppm_structures.voronoi_kernels import voronoi_edges

from sppm_pipeline.errors import ConfigError, InputError
from sppm_pipeline.features.surface.stages.extract_marching_cubes import MarchingCubes
from sppm_pipeline.method.nouns.pores import PoreSet
from sppm_pipeline.method.stages.check_connectivity import CheckConnectivity
from sppm_pipeline.method.stages.read_primitive import ReadPrimitive
from sppm_pipeline.method.stages.tile_periodic import PeriodicTiling
from sppm_pipeline.method.stages.tune_porosity import TunePorosity
from sppm_pipeline.nouns.length import Cell, Length
from sppm_pipeline.services.grid import Grid, cell_nodes
from sppm_pipeline.testing.contracts import StageContract
from sppm_pipeline.testing.plain_context import PlainContext, recipe_of


def made(pores=None, cover=None, seed=1, **options):
    stage = Voronoi(**options)
    stage.check_options()
    return stage.run(PlainContext(seed), pores, cover)


def pores_at(points):
    return PoreSet(cell=Cell(), centers=np.array(points, float), piece=np.zeros(len(points), np.int32))


def at(field, points):
    return np.array([field.sample(Grid(tuple(p), (1.0,) * 3, (1, 1, 1)))[0, 0, 0] for p in points])


def far_around(field, brick=(0, 0, 0)):
    """Seeds of a brick and of more than it needs, from its low corner."""
    return field.seeds_near(brick, 2.2 * field.furthest + 0.3)[0]


def distances_from_edges(points, seeds):
    """From the edges that Qhull finds, one by one."""
    a, b = qhull_edges(seeds)
    near = (np.abs((a + b) / 2 - 0.5).max(axis=1) < 1.6) & (np.linalg.norm(b - a, axis=1) > 1e-12)
    best = np.full(len(points), np.inf)
    for start, along in zip(a[near], (b - a)[near], strict=True):
        t = np.clip((points - start) @ along / (along @ along), 0, 1)
        best = np.minimum(best, np.linalg.norm(points - start - t[:, None] * along, axis=1))
    return best


def qhull_edges(seeds):
    diagram = Diagram(seeds)
    pairs = set()
    for ridge in diagram.ridge_vertices:
        if -1 not in ridge:
            pairs |= {tuple(sorted(pair)) for pair in zip(ridge, ridge[1:] + ridge[:1], strict=True)}
    a, b = np.array(sorted(pairs)).T
    return diagram.vertices[a], diagram.vertices[b]


def distances_from_walls(points, seeds):
    found = []
    for point in points:
        distance = np.linalg.norm(seeds - point, axis=1)
        own = distance.argmin()
        other = np.arange(len(seeds)) != own
        apart = np.linalg.norm(seeds[other] - seeds[own], axis=1)
        found.append(((distance[other] ** 2 - distance[own] ** 2) / (2 * apart)).min())
    return np.array(found)


class TestContract(StageContract):
    def stages(self):
        return [Voronoi(), Voronoi(form="closed", seeding="darts"), Voronoi(layout="part", cells=(2, 1, 1), fine=0.2)]


SOURCES = [{"seeds": 3}, {"seeds": 2, "fine": 0.4}, {"seeds": 3, "seeding": "darts"}, {"seeds": 1}]


@pytest.mark.parametrize("options", SOURCES)
def test_struts_follow_the_edges_of_all_voronoi_cells(options):
    field = made(**options, blend=Length(0.0), radius=Length(0.02))
    points = np.random.default_rng(0).random((60, 3))
    assert at(field, points) + 0.02 == pytest.approx(distances_from_edges(points, far_around(field)), abs=1e-6)


@pytest.mark.parametrize("options", SOURCES)
def test_walls_lie_between_all_voronoi_cells(options):
    field = made(**options, form="closed", thickness=Length(0.04))
    points = np.random.default_rng(0).random((60, 3))
    assert at(field, points) + 0.02 == pytest.approx(distances_from_walls(points, far_around(field)), abs=1e-6)


@pytest.mark.parametrize("form", ["open", "closed"])
def test_parts_are_exact_too_and_do_not_repeat(form):
    field = made(form=form, layout="part", cells=(3, 2, 4), seeds=3, blend=Length(0.0))
    inside = np.random.default_rng(1).random((20, 3))
    truth = distances_from_edges if form == "open" else distances_from_walls
    seen = []
    for brick in [(0, 0, 0), (2, 1, 3), (1, 0, 2)]:
        seen.append(at(field, inside + np.array(brick)))
        assert seen[-1] + field.half == pytest.approx(truth(inside, far_around(field, brick)), abs=1e-6)
    assert not np.allclose(seen[0], seen[1], atol=1e-3)
    assert field.cells == (3, 2, 4)
    assert not field.periodic


@settings(deadline=None, derandomize=True, max_examples=10)
@given(st.integers(0, 2**32), st.integers(1, 9))
def test_edges_of_any_pores_are_those_of_qhull(seed, count):
    """Length of all edges in the cell, each once."""
    seeds = np.random.default_rng(seed).random((count, 3))
    edges = voronoi_edges(images_near(seeds, 1.8)[0], count, 0.5, 1.8)
    a, b = qhull_edges(images_near(seeds, 2.5)[0])
    inside = (((a + b) / 2 >= 0) & ((a + b) / 2 < 1)).all(axis=1)
    total = np.linalg.norm(a - b, axis=1)[inside].sum()
    assert np.linalg.norm(edges[:, 3:] - edges[:, :3], axis=1).sum() == pytest.approx(total, rel=1e-6)


def test_pores_of_a_body_centerd_lattice_give_kelvin_cells():
    """24 edges of length sqrt(2)/4 for each pair of truncated octahedra, though many corners are shared."""
    field = made(pores_at([[0.1, 0.2, 0.3], [0.6, 0.7, 0.8]]))
    edges = field.edges_of((0, 0, 0))
    assert len(edges) == 24
    assert np.linalg.norm(edges[:, 3:] - edges[:, :3], axis=1) == pytest.approx(2**0.5 / 4)


def test_pores_of_a_face_centerd_lattice_give_rhombic_dodecahedra():
    """24 edges of length sqrt(3)/4, each of three cells; eight edges end in some corners."""
    points = np.array([[0, 0, 0], [0, 0.5, 0.5], [0.5, 0, 0.5], [0.5, 0.5, 0]])
    edges = made(pores_at(points)).edges_of((0, 0, 0))
    assert len(edges) == 4 * 24 / 3
    assert np.linalg.norm(edges[:, 3:] - edges[:, :3], axis=1) == pytest.approx(3**0.5 / 4)


def test_a_simple_cubic_lattice_gives_a_cube():
    """Four cells share each edge, and it still is one."""
    field = made(pores_at([[0.5, 0.5, 0.5]]), blend=Length(0.0))
    assert len(field.edges_of((0, 0, 0))) == 3
    walls = made(pores_at([[0.5, 0.5, 0.5]]), form="closed", thickness=Length(0.1))
    assert at(walls, [[0.5, 0.5, 0.5], [0.2, 0.5, 0.6]]) == pytest.approx([0.45, 0.15])


@pytest.mark.parametrize("options", [*SOURCES, {"form": "closed"}])
def test_opposite_faces_are_equal_to_the_last_bit(options):
    values = made(**options).sample(cell_nodes(19))
    for axis in range(3):
        assert (np.take(values, 0, axis) == np.take(values, -1, axis)).all()


@pytest.mark.parametrize("options", [{}, {"form": "closed"}, {"layout": "part", "cells": (3, 3, 3)}])
def test_layers_threads_and_cuts_give_the_same_bytes(options):
    grid = Grid((0.013, 0.2, 0.07), (1 / 37,) * 3, (50, 44, 36))
    whole = made(**options).sample(grid)
    assert (made(**options).sample(grid, 3) == whole).all()
    assert (made(**options).sample_layers(grid, 11, 29) == whole[:, :, 11:29]).all()
    exact = Grid((0.125, 0.25, 0.5), (1 / 32,) * 3, (64, 48, 40))
    part = Grid((0.125 + 20 / 32, 0.25 + 10 / 32, 0.5 + 5 / 32), (1 / 32,) * 3, (30, 20, 10))
    assert (made(**options).sample(exact)[20:50, 10:30, 5:15] == made(**options).sample(part)).all()


def test_only_what_matters_is_evaluated():
    field, grid = made(layout="part", cells=(3, 3, 3), seeds=2), cell_nodes(10, (3, 3, 3))
    whole = field.solid(grid)
    wanted = np.zeros((31, 31, 2), np.int32)
    wanted[12:15, 5:9] = (3, 24)
    wanted[5, 25] = (22, 30)
    some = replace(field, kept=type(field.kept)())
    solid = some.solid_layers(grid, 0, 31, wanted=wanted)
    for k, j in np.argwhere(wanted[..., 0] < wanted[..., 1]):
        inside = slice(*wanted[k, j])
        assert (solid[inside, j, k] == whole[inside, j, k]).all()
    made_for = [brick for (what, brick) in some.kept.known() if what == "prepared"]
    assert sorted(made_for) == [(0, 0, 1), (1, 0, 1), (2, 0, 1), (2, 2, 0)]


def test_a_part_has_no_seam_between_cells():
    field = made(layout="part", cells=(2, 2, 2))
    eps = 1e-7
    across = np.random.default_rng(2).random((40, 3))
    across[:, 0] = 1.0
    step = np.array([eps, 0, 0])
    assert at(field, across - step) == pytest.approx(at(field, across), abs=1e-6)


def test_far_places_cost_no_more_and_keep_their_precision():
    field = made(layout="part", cells=(4096, 4096, 4096), seeds=3, blend=Length(0.0))
    brick = (4000, 17, 3999)
    inside = np.random.default_rng(1).integers(0, 1024, (10, 3)) / 1024
    assert at(field, inside + np.array(brick)) + field.half == pytest.approx(
        distances_from_edges(inside, far_around(field, brick)), abs=1e-6
    )


@pytest.mark.parametrize(
    ("options", "porosity", "voids"),
    [({}, 0.8, 1), ({"seeding": "darts"}, 0.8, 1), ({"form": "closed", "seeds": 2, "jitter": 0.5}, 0.6, 8)],
)
def test_density_is_reached_and_the_phases_hang_together(options, porosity, voids):
    tuned = TunePorosity(target=porosity).run(PlainContext(), recipe_of(Voronoi(**options, edge=Length(5.0))))
    n = 123
    grid = Grid((0.31 / n, 0.72 / n, 0.17 / n), (1 / n,) * 3, (n,) * 3)
    assert float((tuned.sample(grid) >= 0).mean()) == pytest.approx(porosity, abs=0.001)
    size = "thickness" if "form" in options else "radius"
    assert tuned.summary()[f"{size}_mm"] == pytest.approx(5 * tuned.summary()[size])
    context = PlainContext()
    CheckConnectivity(bicontinuous="form" not in options).run(context, tuned)
    assert context.reported["void_components"] == voids
    assert context.reported["solid_wraps"] == [True] * 3


def test_meshes_are_closed():
    tiling = PeriodicTiling(cells=(1, 2, 1)).run(PlainContext(), made(edge=Length(4.0)), None)
    assert MarchingCubes(resolution=32).run(PlainContext(), tiling).bounds_solid
    assert MarchingCubes(resolution=32).run(PlainContext(), made(layout="part", cells=(1, 2, 1))).bounds_solid


def test_a_part_is_covered():
    ball = ReadPrimitive(shape="ball", size=(Length(10.0),) * 3).run(PlainContext())
    field = made(cover=ball, layout="part", edge=Length(4.0, "mm"))
    assert field.cells == (3, 3, 3)
    assert field.origin_mm == pytest.approx(ball.lower - 1)


def test_seeds_keep_to_their_places():
    seeds, own = HashedSeeds(5, 3, 0.5, 0.0).near((7, -2, 0), 0.4, False)
    assert own == 27
    assert len(seeds) == 7**3
    offset = 3 * seeds[:own] - np.argwhere(np.ones((3, 3, 3)))
    assert offset.min() > 0.25
    assert offset.max() < 0.75
    # the same seeds, seen from the next cell
    seen, _ = HashedSeeds(5, 3, 0.5, 0.0).near((6, -2, 0), 1.0, False)
    moved = {tuple(np.round(p - [1, 0, 0], 9)) for p in seen}
    assert {tuple(np.round(p, 9)) for p in seeds[:own]} <= moved
    fine, _ = HashedSeeds(5, 4, 0.5, 0.5).near((0, 0, 0), 0.0, False)
    assert (len(fine) - 64) % 7 == 0
    assert 64 + 7 * 16 < len(fine) < 64 + 7 * 48


def test_tuning_changes_the_radius_only():
    field = made()
    grid = Grid((0.1, 0.1, 0.1), (0.05,) * 3, (12, 12, 12))
    assert replace(field, half=0.05).sample(grid) == pytest.approx(field.cut_at(0.02).sample(grid), abs=1e-7)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"thickness": Length(0.1)}, "radius"),
        ({"form": "closed", "radius": Length(0.1)}, "thickness"),
        ({"cells": (2, 2, 2)}, "layout: part"),
        ({"layout": "part", "seeding": "darts"}, "jittered"),
        ({"layout": "part"}, "no part to cover"),
        ({"seeding": "darts", "fine": 0.5}, "fine"),
        ({"radius": Length(0.6)}, "less than 0.5"),
        ({"radius": Length(0.6, "mm")}, "physical unit"),
    ],
)
def test_contradictions(options, said):
    with pytest.raises(ConfigError, match=said):
        made(**options)


def test_pores_that_are_no_seeds():
    with pytest.raises(ConfigError, match="one cell"):
        made(pores_at([[0.5, 0.5, 0.5]]), layout="part", cells=(2, 2, 2))
    with pytest.raises(InputError, match="1 to"):
        made(pores_at(np.empty((0, 3))))
    assert made(pores_at([[0.2, 0.5, 0.5], [1.2, 0.5, 0.5], [0.2, 0.5, -0.5]])).summary()["seeds"] == 1
