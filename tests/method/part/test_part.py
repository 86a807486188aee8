"""Parts: the intersection with a mesh, the skin, and meshes that do not close."""

import numpy as np
import pytest

from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.part import domain_sampler, primitive_meshes
from sppm_pipeline.method.part.domain_sampler import VOTED_LAYERS
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.method.part.ray_crossings import prepare_scan
from sppm_pipeline.method.part.scanline import scan_layers
from sppm_pipeline.services.bit_rows import unpack
from sppm_pipeline.services.grid import Grid, cell_centers


def inside_ball(part, grid, radius=5.0):
    world = part.in_mm(grid)
    x, y, z = np.meshgrid(*(world.axis(axis) for axis in range(3)), indexing="ij")
    return (x - 5) ** 2 + (y - 5) ** 2 + (z - 5) ** 2 < radius**2


GRID = cell_centers(12, (4, 3, 3))


def test_a_part_is_the_field_and_the_domain(wang_tiling, ball):
    part = Part(wang_tiling, ball)
    solid, expected = part.solid(GRID), wang_tiling.solid(GRID).astype(bool) & inside_ball(part, GRID)
    assert (solid != expected).sum() < 0.03 * expected.sum()  # the ball is a polyhedron
    assert np.array_equal(solid, part.sample(GRID) < 0)
    assert not part.periodic
    assert part.cells == wang_tiling.cells


def test_the_distance_is_in_cell_edges(wang_tiling, ball):
    part = Part(wang_tiling, ball)
    _, outer = part.apart_zyx(GRID)
    world = part.in_mm(GRID)
    z, y, x = np.meshgrid(world.axis(2), world.axis(1), world.axis(0), indexing="ij")
    truth = (np.sqrt((x - 5) ** 2 + (y - 5) ** 2 + (z - 5) ** 2) - 5) / 4
    near = abs(outer) < 0.99 * world.spacing[0] / 4
    assert near.sum() > 1000
    assert abs(outer - truth)[near].max() < 0.02


@pytest.mark.parametrize("skin", [0.4, 1.0])
def test_the_skin_is_solid_and_as_thick_as_asked(wang_tiling, ball, skin):
    part, plain = Part(wang_tiling, ball, skin), Part(wang_tiling, ball)
    grid = cell_centers(24, (3, 3, 3))
    solid, inside = part.solid(grid).astype(bool), inside_ball(part, grid, 4.97)
    h = 4 / 24
    shell = inside & ~inside_ball(part, grid, 5 - skin + h)
    core = inside_ball(part, grid, 5 - skin - h)
    assert solid[shell].all()
    assert np.array_equal(solid[core], plain.solid(grid)[core].astype(bool))
    assert not solid[~inside_ball(part, grid, 5.001)].any()
    sampled = part.sample(grid) < 0
    assert sampled[shell].all()
    assert np.array_equal(sampled[core], solid[core])


@pytest.mark.parametrize("skin", [0.0, 0.7])
@pytest.mark.parametrize("opened", [False, True])
def test_slabs_and_threads_change_no_bit(wang_tiling, ball, skin, opened):
    domain = SurfaceMesh(ball.vertices, ball.faces[3:]) if opened else ball
    part = Part(wang_tiling, domain, skin)
    assert domain.bounds_solid != opened
    grid = Grid((0.02, 0.1, 0.05), (0.07, 0.08, 0.03), (40, 30, VOTED_LAYERS + 30))
    whole = part.solid(grid)
    assert whole.any()
    assert part.solid(grid, threads=2).tobytes() == whole.tobytes()
    assert np.array_equal(unpack(part.solid_bits(grid, 5, 91, 2), 40).T, whole[:, :, 5:91])
    for step in (1, 7, 70):
        parts = [(k, min(k + step, grid.shape[2])) for k in range(0, grid.shape[2], step)]
        again = Part(wang_tiling, domain, skin)
        assert np.concatenate([again.solid_layers(grid, *p) for p in parts], 2).tobytes() == whole.tobytes()
    again = Part(wang_tiling, domain, skin)
    backwards = [again.solid_layers(grid, k, k + 1) for k in (50, 3, 90)]
    assert np.array_equal(np.concatenate(backwards, 2), whole[:, :, [50, 3, 90]])


def test_a_mesh_with_a_hole_is_filled_by_vote(wang_tiling):
    """A box without a piece of its x side: rays along x alone would lose all rows behind the hole."""
    vertices, faces = primitive_meshes.box_mesh((5.03, 5.02, 5.01), (8.0, 7.0, 6.0))
    sides = vertices[faces].max(1)[:, 0] - vertices[faces].min(1)[:, 0] == 0
    assert sides.sum() == 4
    hole = np.delete(faces, np.flatnonzero(sides)[0], axis=0)
    whole, opened = Part(wang_tiling, SurfaceMesh(vertices, faces)), Part(wang_tiling, SurfaceMesh(vertices, hole))
    along_x = scan_layers(prepare_scan(vertices, hole, whole.in_mm(GRID)), 0, GRID.shape[2]).mask
    expected = whole.solid(GRID)
    assert (along_x.T & expected).sum() < 0.8 * expected.sum()
    assert np.array_equal(opened.solid(GRID), expected)
    assert np.array_equal(opened.sample(GRID) < 0, expected)


def test_a_skin_does_not_move_the_surface_of_the_core(wang_tiling, ball):
    """Deep inside, the field is that of the microstructure, whatever its size."""
    grid = Grid((0.2,) * 3, (1 / 16,) * 3, (34, 34, 34))
    part = Part(wang_tiling, ball, 1.0)
    inner, outer = part.apart_zyx(grid)
    plain = wang_tiling.sample(grid).T
    deep = outer <= -0.999 * (1 / 4 + 1 / 16)
    assert deep.sum() > 1000
    assert np.array_equal(inner[deep], plain[deep])
    skin = (outer < 0) & (outer > -0.99 / 4)
    assert (inner[skin] < 0).all()
    fields = part.fields_zyx(grid)
    assert np.array_equal(fields[0], plain)
    assert np.array_equal(fields[2], outer)
    assert Part(wang_tiling, ball).fields_zyx(grid)[1] is None


def test_layers_are_those_of_the_whole(wang_tiling, ball, monkeypatch):
    grid = Grid((0.2, 0.1, 0.3), (1 / 12,) * 3, (25, 26, 27))
    for skin in (0.0, 0.9):
        whole = Part(wang_tiling, ball, skin).sample(grid)
        part = Part(wang_tiling, ball, skin)
        cut = [part.sample_layers(grid, a, b) for a, b in ((0, 3), (3, 4), (4, 19), (19, 27))]
        assert np.array_equal(np.concatenate(cut, axis=2), whole)


@pytest.mark.parametrize("inside", ["winding", "vote"])
def test_distances_of_an_open_part_do_not_depend_on_slabs(wang_tiling, ball, inside, monkeypatch):
    """Also where the inside ends in a hole, so that the skin goes across it."""
    domain = SurfaceMesh(ball.vertices, ball.faces[(ball.vertices[ball.faces].max(1)[:, 2] < 9.3)])
    assert len(domain.faces) < len(ball.faces)
    grid = cell_centers(12, (4, 3, 3))
    whole = Part(wang_tiling, domain, 0.7, inside=inside).apart_zyx(grid)[1]
    lid = whole[:, 15, 15]
    assert (lid < 0).any()
    assert np.abs(np.diff(lid)).max() < 2 * 1.01 / 12
    monkeypatch.setattr(domain_sampler, "DISTANCE_SAMPLES", 1)
    thin = Part(wang_tiling, domain, 0.7, inside=inside).apart_zyx(grid)[1]
    assert np.array_equal(thin < 0, whole < 0)
    assert np.abs(thin - whole).max() < 0.01
