"""Solid of parts without what is too thin: rounded edges, thickened struts, and the same on any grid and slab."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from sppm_pipeline.features.surface.stages.extract_marching_cubes import MarchingCubes
from sppm_pipeline.method.fields.scalar_field import ScalarField
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.part import border as of_border
from sppm_pipeline.method.part.border import PER_DIAMETER, ROOM, Border
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.method.part.primitive_meshes import ball_mesh, box_mesh
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.local_thickness import local_thickness
from sppm_pipeline.services.mesh.adjacency import adjacency
from sppm_pipeline.services.mesh.measures import volume
from sppm_pipeline.testing.plain_context import PlainContext

THINNEST = 0.6
RADIUS = THINNEST / 2 * (1 + ROOM)
NODE = THINNEST / PER_DIAMETER
BOX = SurfaceMesh(*box_mesh((3.0, 2.5, 2.5), (6.0, 5.0, 5.0)), name="box")


@dataclass(frozen=True, eq=False)
class Slab(ScalarField):
    """A plate of a thickness around a plane through (3, 2.5, 2.5); a cell measures 1 mm."""

    thickness: float
    normal: tuple[float, float, float] = (0.0, 0.0, 1.0)

    @property
    def cells(self):
        return (6, 5, 5)

    @property
    def periodic(self):
        return False

    @property
    def edge_mm(self):
        return 1.0

    def sample_layers(self, grid, start, stop, threads=1):
        x, y, z = np.meshgrid(*(grid.layers(start, stop).axis(axis) for axis in range(3)), indexing="ij")
        a, b, c = np.array(self.normal) / np.linalg.norm(self.normal)
        off = a * (x - 3) + b * (y - 2.5) + c * (z - 2.5)
        return (abs(off) - self.thickness / 2).astype(np.float32)


def plane(h=0.03):
    """Nodes of a plane of constant y in the middle of the box, and where they are."""
    grid = Grid((-0.1, 2.5, -0.1), (h, h, h), (round(6.2 / h), 1, round(5.2 / h)))
    x, _, z = np.meshgrid(*(grid.axis(axis) for axis in range(3)), indexing="ij")
    return grid, x, z


def test_a_plate_that_a_plane_cuts_ends_in_the_round_of_the_ball():
    grid, x, z = plane()
    field = Part(Slab(1.7), BOX, border=Border(THINNEST)).sample(grid)
    # the middles of balls that fit into the plate and the box
    dx = np.maximum(abs(x - 3) - (3 - RADIUS), 0)
    dz = np.maximum(abs(z - 2.5) - (0.85 - RADIUS), 0)
    exact = np.hypot(dx, dz) - RADIUS
    near = (abs(exact) < NODE) & (np.hypot(dx, dz) > 0)
    assert near.sum() > 1000
    assert abs(field - exact)[near].max() < 0.52 * NODE  # where balls meet the corner of their middles
    assert abs(field - exact)[near].mean() < 0.08 * NODE


def test_faces_of_a_full_box_stay_flat_and_its_edges_get_round():
    grid, x, z = plane()
    field = Part(Slab(50.0), BOX, border=Border(THINNEST)).sample(grid)
    dx, dz = np.maximum(abs(x - 3) - (3 - RADIUS), 0), np.maximum(abs(z - 2.5) - (2.5 - RADIUS), 0)
    exact = np.hypot(dx, dz) - RADIUS
    near = (abs(exact) < NODE) & (np.hypot(dx, dz) > 0)
    flat = near & ((abs(x - 3) < 3 - RADIUS - NODE) | (abs(z - 2.5) < 2.5 - RADIUS - NODE))
    assert abs(field - exact)[flat].max() < 0.04 * NODE
    assert abs(field - exact)[near].max() < 0.52 * NODE


@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (1.0, 2.0, 3.0), (0.0, 1.0, 1.0)])
def test_thin_plates_come_out_as_thick_as_the_ball_and_thinner_ones_go(normal):
    h = 0.05
    grid = Grid((1.5, 1.5, 1.0), (h, h, h), (60, 40, 60))
    x, y, z = np.meshgrid(*(grid.axis(axis) for axis in range(3)), indexing="ij")
    off = abs(np.tensordot(np.array(normal) / np.linalg.norm(normal), [x - 3, y - 2.5, z - 2.5], 1))
    thin = Part(Slab(0.8 * 2 * RADIUS, normal), BOX, border=Border(THINNEST)).solid(grid).astype(bool)
    assert thin[off < RADIUS - 0.02 * NODE].all()
    assert not thin[off > RADIUS + NODE].any()
    gone = Part(Slab(0.5 * THINNEST, normal), BOX, border=Border(THINNEST))
    assert not gone.solid(grid).any()


def test_nothing_lies_outside_of_the_domain_and_nothing_is_thin(wang_tiling, ball):
    thinnest, h = 0.6, 0.1 / 4
    part = Part(wang_tiling, ball, border=Border(thinnest))
    grid = Grid((1.25 - 5.2 / 4, 1.25 - 5.2 / 4, 1.25 - 1.6 / 4), (h, h, h), (104, 104, 32))
    solid = part.solid_zyx(grid, 0, 32)
    assert not (solid & (1 - part.inside_zyx(grid, 0, 32))).any()
    sizes = local_thickness(solid, (False,) * 3)[3:-3]
    assert np.mean(sizes[sizes > 0] < thinnest / 0.1) < 0.01
    cut = local_thickness(replace(part, border=None).solid_zyx(grid, 0, 32), (False,) * 3)[3:-3]
    assert np.mean(cut[cut > 0] < thinnest / 0.1) > 0.05


def test_a_place_has_one_value_on_any_grid_slab_and_number_of_threads(wang_tiling, ball, monkeypatch):
    part = Part(wang_tiling, ball, border=Border(0.6))
    grid = Grid((0.1, 0.1, 0.1), (1 / 20,) * 3, (40, 42, 44))
    whole = part.sample_zyx(grid, 0, 44)
    assert np.array_equal(whole < 0, part.solid_zyx(grid, 0, 44) == 1)
    monkeypatch.setattr(of_border, "KEPT_NODES", 0)
    for threads in (1, 2):
        again = replace(part)
        for start, stop in ((30, 44), (0, 7), (7, 8), (8, 30)):
            assert np.array_equal(again.sample_zyx(grid, start, stop, threads), whole[start:stop])
    monkeypatch.setattr(of_border, "BLOCK_SAMPLES", 1)
    assert np.array_equal(replace(part).sample_zyx(grid, 0, 44), whole)
    half = Grid(grid.origin, (1 / 10,) * 3, (20, 21, 22))
    assert np.allclose(part.sample_zyx(half, 0, 22), whole[::2, ::2, ::2], atol=1e-6)


def test_an_open_part_has_a_border_as_well(wang_tiling):
    vertices, faces = ball_mesh((5.0, 5.0, 5.0), 4.0, 3)
    grid = Grid((0.1, 0.1, 0.5), (1 / 20,) * 3, (44, 44, 8))
    closed, opened = (
        Part(wang_tiling, SurfaceMesh(vertices, some), border=Border(0.6)).solid(grid) for some in (faces, faces[1:])
    )
    assert np.mean(closed != opened) < 0.002


def test_its_mesh_is_closed_and_that_of_the_layers(wang_tiling, ball):
    part = Part(wang_tiling, ball, border=Border(0.6), islands="keep")
    context = PlainContext()
    mesh = MarchingCubes(resolution=24).run(context, part)
    assert (adjacency(mesh.faces).opposite >= 0).all()
    h = 1 / 48
    grid = Grid((0.0, 0.0, 0.0), (h,) * 3, (120, 120, 120))
    solid = part.solid(grid).sum() * (4 * h) ** 3
    assert abs(volume(mesh.vertices, mesh.faces) - solid) < 0.005 * solid


def test_skin_and_drains_are_done_before_it(wang_tiling, ball):
    drain = (5.0, 5.0, 5.0, 5.0, 5.0, 12.0, 0.8)
    part = Part(wang_tiling, ball, 1.2, drains=(drain,), border=Border(0.6))
    grid = Grid((0.0, 0.0, 0.0), (1 / 24,) * 3, (60, 60, 60))
    solid = part.solid(grid)
    world = part.in_mm(grid)
    x, y, z = np.meshgrid(*(world.axis(axis) for axis in range(3)), indexing="ij")
    from_middle = np.sqrt((x - 5) ** 2 + (y - 5) ** 2 + (z - 5) ** 2)
    axis = np.hypot(x - 5, y - 5)
    shell = (from_middle > 4.3) & (from_middle < 4.8) & ((axis > 2) | (z < 5))
    assert solid[shell].all()
    assert not solid[(axis < 0.7) & (z > 5)].any()
    _, counts = part.counted_bits(grid, 0, 60)
    assert 0 < counts["skin"] < counts["domain"]
