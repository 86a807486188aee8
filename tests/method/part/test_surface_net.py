"""The net of struts along a surface: evenly spread, in one piece, inside; and the part that has it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.surface.stages.extract_marching_cubes import MarchingCubes
from sppm_pipeline.method.part.border import Border
from sppm_pipeline.method.part.capsules import depths_in_capsules, fill_capsules
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.method.part.primitive_meshes import ball_mesh, box_mesh
from sppm_pipeline.method.part.surface_net import _places, surface_net
from sppm_pipeline.method.stages.fill_implicit import ImplicitFill
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.local_thickness import local_thickness
from sppm_pipeline.services.mesh.adjacency import adjacency
from sppm_pipeline.services.mesh.measures import volume
from sppm_pipeline.testing.plain_context import PlainContext

HALF = np.array([10.0, 5.0, 4.0])


def net(mesh, spacing=1.5, radius=0.2, seed=1):
    vertices, faces = mesh
    return surface_net(vertices[faces], spacing, radius, np.random.default_rng(seed))


def pieces(made):
    size = (len(made.points),) * 2
    return connected_components(coo_array((np.ones(len(made.edges)), made.edges.T), size), directed=False)[0]


@pytest.mark.parametrize("seed", range(3))
def test_points_are_spread_evenly_and_the_net_is_in_one_piece(seed):
    box, ball = net(box_mesh((0, 0, 0), 2 * HALF), seed=seed), net(ball_mesh((0, 0, 0), 6.0, 4), seed=seed)
    for made in (box, ball):
        tree = cKDTree(made.points)
        assert tree.query(made.points, k=2)[0][:, 1].min() >= 1.5
        assert pieces(made) == 1
        degree = np.bincount(made.edges.ravel(), minlength=len(made.points))
        assert degree.min() >= 2
        assert 2.8 < degree.mean() < 3.4
        # no place is far from all points, or there would be room for another one; none is joined across the part
        way = np.linalg.norm(np.diff(made.points[made.edges], axis=1)[:, 0], axis=1)
        assert way.max() < 2 * 1.5
    vertices, faces = box_mesh((0, 0, 0), 2 * HALF)
    far = cKDTree(box.points).query(_places(vertices[faces], 1.0, np.random.default_rng(9))[0])[0]
    assert far.max() < 1.1 * 1.5
    # struts touch the surface from inside: exactly on a plane, to the height of a facet on a ball
    depth = (HALF - abs(box.capsules[:, :3])).min(1)
    assert depth.min() > 0.19
    assert np.mean(depth > 0.2 - 1e-9) > 0.99
    assert np.median(depth) == pytest.approx(0.2, abs=1e-9)
    assert abs(np.linalg.norm(ball.capsules[:, :3], axis=1) - 5.8).max() < 0.02
    again = net(box_mesh((0, 0, 0), 2 * HALF), seed=seed)
    assert np.array_equal(again.capsules, box.capsules)


def test_the_two_sides_of_a_thin_plate_have_a_net_each():
    made = net(box_mesh((0, 0, 0), (20.0, 20.0, 0.3)), radius=0.1)
    upper = made.points[:, 2] > 0
    assert 100 < upper.sum() < len(upper) - 100
    across = made.edges[upper[made.edges[:, 0]] != upper[made.edges[:, 1]]]
    rim = abs(made.points[:, :2]).max(1) > 8
    assert rim[across].all()


def test_surfaces_without_room_for_it_are_refused():
    with pytest.raises(DesignError, match="no room"):
        net(box_mesh((0, 0, 0), (1, 1, 1)), 50.0)
    with pytest.raises(DesignError, match=r"too many of them"):
        net(box_mesh((0, 0, 0), (100, 100, 100)), 0.1)


def test_many_capsules_are_those_one_by_one():
    rng = np.random.default_rng(0)
    capsules = np.column_stack([rng.random((30, 6)), rng.uniform(0.02, 0.2, 30)])
    capsules[0, 3:6] = capsules[0, :3]
    grid = Grid((-0.1, 0.0, 0.1), (0.05, 0.04, 0.06), (24, 22, 20))
    slow, fast = (np.full((20, 22, 24), 0.9, np.float32) for _ in range(2))
    for window, depth in depths_in_capsules(grid, capsules, 0.1):
        np.minimum(slow[window], depth / np.float32(-4), out=slow[window])
    for start, stop in ((0, 7), (7, 8), (8, 20)):
        fill_capsules(grid.layers(start, stop), capsules, 0.1, np.float32(4), fast[start:stop])
    assert np.array_equal(slow < 0.9, fast < 0.9)
    assert np.allclose(slow, fast, atol=1e-6)
    assert (fast < 0).any()


def test_a_part_with_it_has_no_thin_solid_and_all_of_the_net(wang_tiling, ball):
    context = PlainContext()
    stage = ImplicitFill(
        border="frame", thinnest=Length(0.6), frame=Length(0.9), frame_spacing=Length(2.0), islands="keep"
    )
    stage.check_options()
    part = stage.run(context, wang_tiling, ball)
    assert context.reported["frame_struts"] * 6 == len(part.fills)
    h = 0.1 / 4
    grid = Grid((1.25 - 5.2 / 4, 1.25 - 5.2 / 4, 1.25 - 1.6 / 4), (h, h, h), (104, 104, 32))
    solid = part.solid_zyx(grid, 0, 32)
    assert not (solid & (1 - part.inside_zyx(grid, 0, 32))).any()
    sizes = local_thickness(solid, (False,) * 3)[3:-3]
    assert np.mean(sizes[sizes > 0] < 0.6 / 0.1) < 0.01
    # more solid than without the net, and all of that is along the surface
    plain = Part(wang_tiling, ball, 0.0, "keep", border=Border(0.6)).solid_zyx(grid, 0, 32)
    world = part.in_mm(grid)
    z, y, x = np.meshgrid(*(world.axis(axis) for axis in (2, 1, 0)), indexing="ij")
    deep = np.sqrt((x - 5) ** 2 + (y - 5) ** 2 + (z - 5) ** 2) < 5 - 0.9 - 0.6
    assert np.mean((solid != plain)[deep]) < 1e-3
    assert solid.sum() > 1.1 * plain.sum()
    # the middle of every strut is solid
    at = (part.fills[:, :3] - part.origin_mm) / part.physical_edge()
    for x, y, z in at[:: len(at) // 40]:
        assert part.sample(Grid((x, y, z), (h,) * 3, (1, 1, 1)))[0, 0, 0] < 0
    mesh = MarchingCubes(resolution=20).run(PlainContext(), part)
    assert (adjacency(mesh.faces).opposite >= 0).all()
    fine = Grid((0.0, 0.0, 0.0), (1 / 40,) * 3, (100, 100, 100))
    assert volume(mesh.vertices, mesh.faces) == pytest.approx(part.solid(fine).sum() * 0.1**3, rel=6e-3)
    assert np.array_equal(replace(part).solid_zyx(grid, 5, 9), solid[5:9])


def test_options_of_the_frame():
    for options in ({"frame": Length(1)}, {"frame_spacing": Length(1), "border": "round"}):
        with pytest.raises(ConfigError, match="a net that there is not"):
            ImplicitFill(**options).check_options()
    with pytest.raises(ConfigError, match="thinner than `thinnest`"):
        ImplicitFill(border="frame", frame=Length(0.2)).check_options()
