"""Meshes of fields in parts whose volumes are known: sharp rims and edges, flat faces, the right volume."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from sppm_pipeline.features.surface.field_surface import FieldSurface
from sppm_pipeline.features.surface.numerics.meshcheck.self_intersections import self_intersections
from sppm_pipeline.features.surface.numerics.placing import DOMAIN, FIELD
from sppm_pipeline.method.fields.scalar_field import ScalarField
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.part.part import Part, node_grid
from sppm_pipeline.method.part.primitive_meshes import ball_mesh, box_mesh
from sppm_pipeline.services.grid import Grid, cell_nodes
from sppm_pipeline.services.mesh.box_tree import box_tree
from sppm_pipeline.services.mesh.measures import edge_counts, measure_surface, volume


class Formula(ScalarField):
    """A field of the place (x, y, z) in a box of 10 cells of 1 mm."""

    def __init__(self, formula):
        self.formula = formula

    cells = (10, 10, 10)
    periodic = False
    edge_mm = 1.0

    def summary(self):
        return {}

    def sample_layers(self, grid, start, stop, threads=1):
        x, y, z = grid.axis(0), grid.axis(1), grid.axis(2)[start:stop]
        values = np.empty((len(z), len(y), len(x)), np.float32)
        values[:] = self.formula(x, y[:, None], z[:, None, None])
        return values.T


SOLID = Formula(lambda x, y, z: -1.0)
HOLE = Formula(lambda x, y, z: 1.0 - np.hypot(x - 5, y - 5))
BOX = box_mesh((5, 5, 5), (4, 4, 4))
TURN = np.linalg.qr(np.array([[1.0, 0.4, 0.2], [-0.3, 1.0, 0.5], [0.1, -0.6, 1.0]]))[0]


def placed(how):
    vertices, faces = BOX
    moved = {
        "on nodes": vertices,
        "beside nodes": vertices + np.array([0.037, -0.021, 0.011]),
        "turned": 5 + (vertices - 5) @ TURN * np.sign(np.linalg.det(TURN)),
    }
    return moved[how], faces


def mesh(field, domain, n, skin=0.0):
    part = Part(field, SurfaceMesh(*domain, name="domain"), skin, "keep")
    vertices, faces, _, kinds = FieldSurface(part, node_grid(part, n), "keep").mesh_with_kinds()
    assert edge_counts(faces).bounds_solid
    assert measure_surface(vertices, faces).degenerate == 0
    assert len(kinds) == len(faces)
    return vertices, faces, kinds


@pytest.mark.parametrize("how", ["on nodes", "beside nodes", "turned"])
def test_a_box_is_a_box(how):
    corners, triangles = placed(how)
    vertices, faces, kinds = mesh(SOLID, (corners, triangles), 5)
    assert volume(vertices, faces) == pytest.approx(64, rel=1e-3)
    assert (kinds == DOMAIN).all()
    t = corners[triangles]
    normal = np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    outside = ((vertices[:, None] - t[None, :, 0]) * normal).sum(2).max(1)  # a box is convex
    # a corner that ends between the nodes is lost, which happens to turned boxes only
    lost = how == "turned"
    assert np.quantile(np.abs(outside), 0.97 if lost else 1.0) < 0.2 / 128
    assert np.abs(outside).max() < 0.2
    assert np.linalg.norm(corners[:, None] - vertices, axis=2).min(1).max() < (0.2 if lost else 0.2 / 128)
    assert self_intersections(box_tree(vertices[faces])).pairs == 0


def test_the_rim_of_a_hole_is_a_circle():
    for n in (5, 10):
        vertices, faces, kinds = mesh(HOLE, placed("beside nodes"), n)
        exact = 64 - np.pi * 4
        assert volume(vertices, faces) == pytest.approx(exact, rel=2e-3 * (5 / n) ** 2)
        wall, lid = (np.unique(faces[kinds == kind]) for kind in (FIELD, DOMAIN))
        rim = vertices[np.intersect1d(wall, lid)]
        assert len(rim) > 2 * 6 * n
        h = 1 / n
        assert np.abs(np.hypot(*(rim[:, :2] - 5).T) - 1).max() < 0.02 * h
        assert np.abs(np.abs(rim[:, 2] - 5.011) - 2).max() < 0.002 * h
        assert self_intersections(box_tree(vertices[faces])).pairs == 0


def test_small_balls_are_not_too_small():
    """At 3.1 samples a radius most vertices may be moved by less than the surface rises: others move farther."""
    rng, radius, found = np.random.default_rng(1), 0.62, []
    for center in 5 + rng.random((6, 3)):
        ball = Formula(lambda x, y, z, c=center: np.sqrt((x - c[0]) ** 2 + (y - c[1]) ** 2 + (z - c[2]) ** 2) - radius)
        found.append(volume(*FieldSurface(ball, node_grid(ball, 5), "keep").mesh()[:2]))
    assert np.mean(found) == pytest.approx(4 / 3 * np.pi * radius**3, rel=2.5e-3)


def test_nothing_crosses_where_a_cube_holds_several_polygons():
    noise = gaussian_filter(np.random.default_rng(3).standard_normal((51, 51, 51)), 0.6)
    rough = Formula(lambda x, y, z: noise[tuple(np.round(5 * a).astype(int) for a in np.broadcast_arrays(z, y, x))])
    vertices, faces, kinds = mesh(rough, placed("turned"), 5)
    assert {FIELD, DOMAIN} == set(kinds)
    assert self_intersections(box_tree(vertices[faces])).pairs == 0


def test_a_ball_that_hardly_touches_a_face():
    """Nearly tangent surfaces: a cap of .07 of a ball of radius 2 is all that opens."""
    void = Formula(lambda x, y, z: 2.0 - np.sqrt((x - 5) ** 2 + (y - 5) ** 2 + (z - 8.93) ** 2))
    vertices, faces, kinds = mesh(void, BOX, 8)
    cap = np.pi * 0.07**2 * (6 - 0.07) / 3
    assert 64 - volume(vertices, faces) == pytest.approx(cap + 64 * 2e-4, abs=0.012)
    rim = vertices[np.intersect1d(np.unique(faces[kinds == FIELD]), np.unique(faces[kinds == DOMAIN]))]
    away = np.hypot(*(rim[:, :2] - 5).T)
    assert np.abs(away - np.sqrt(4 - 1.93**2)).max() < 0.02 / 8


def test_a_skin_alone_is_a_hollow_box():
    void = Formula(lambda x, y, z: 1.0)
    vertices, faces, _ = mesh(void, placed("beside nodes"), 10, skin=0.5)
    assert volume(vertices, faces) == pytest.approx(64 - 27, rel=5e-3)


def test_a_part_lies_in_its_domain():
    domain = ball_mesh((5, 5, 5), 3, 5)
    vertices, faces, _ = mesh(SOLID, domain, 4)
    assert np.linalg.norm(vertices - 5, axis=1).max() < 3 + 0.25 / 128
    assert volume(vertices, faces) == pytest.approx(volume(*domain), rel=5e-3)


def test_a_cell_holds_what_its_voxels_hold(cell):
    """At 32 samples an edge, porosity .7: half a percent; interpolated linearly, four percent are lost."""
    values = cell.sample(48)
    thin = cell.cut_at(float(np.quantile(values, 0.3)))
    solid = thin.solid(160).mean()
    vertices, faces, _ = FieldSurface(thin, cell_nodes(32), "keep").mesh()
    assert volume(vertices, faces) == pytest.approx(solid, rel=5e-3)


@pytest.mark.parametrize("skin", [0.0, 0.3])
@pytest.mark.parametrize("domain", ["ball", "turned box"])
def test_nothing_crosses_where_thin_walls_end(domain, skin):
    """Walls of about a voxel: cubes that the surface passes several times, rims at every angle."""

    def walls(x, y, z):
        x, y, z = 2.4 * x, 2.4 * y, 2.4 * z
        return np.abs(np.sin(x) * np.cos(y) + np.sin(y) * np.cos(z) + np.sin(z) * np.cos(x)) - 0.25

    body = ball_mesh((5.03, 4.98, 5.01), 2.2, 4) if domain == "ball" else placed("turned")
    for n in (6, 8):
        vertices, faces, _ = mesh(Formula(walls), body, n, skin)
        assert self_intersections(box_tree(vertices[faces])).pairs == 0


def test_nothing_crosses_in_noise():
    """All cases of marching cubes beside a rim, faces that the surface crosses twice among them."""
    noise = Formula(
        lambda x, y, z: np.sin(991 * x + 37 * y * z) + np.sin(883 * y + 41 * z) + np.sin(787 * z + 53 * x * x)
    )
    for skin in (0.0, 0.3):
        vertices, faces, _ = mesh(noise, placed("turned"), 5, skin)
        assert len(faces) > 10_000
        assert self_intersections(box_tree(vertices[faces])).pairs == 0


def shells(*several):
    offsets = np.cumsum([0, *(len(vertices) for vertices, _ in several)])
    faces = [faces + offset for (_, faces), offset in zip(several, offsets, strict=False)]
    return np.concatenate([vertices for vertices, _ in several]), np.concatenate(faces).astype(np.int32)


OVERLAPPING = {
    "cubes in one plane": shells(box_mesh((4, 5, 5), (4, 4, 4)), box_mesh((6, 6, 5), (4, 4, 4))),
    "cubes": shells(box_mesh((4, 4, 4), (4, 4, 4)), box_mesh((6.1, 5.3, 4.7), (4, 4, 4))),
    "cubes face to face": shells(box_mesh((3, 5, 5), (4, 4, 4)), box_mesh((7, 5, 5), (4, 4, 4))),
    "balls": shells(ball_mesh((4, 5, 5), 2.2, 4), ball_mesh((6, 5.2, 5.1), 2.2, 4)),
    "one within the other": shells(ball_mesh((5, 5, 5), 3.0, 4), ball_mesh((5, 5, 5.5), 1.7, 3)),
    "twice the same": shells(ball_mesh((5, 5, 5), 3.0, 4), ball_mesh((5, 5, 5), 3.0, 4)),
}
SHEETS = Formula(lambda x, y, z: np.sin(2.1 * x) + np.sin(1.9 * y) + np.sin(2.3 * z) - 1.2)


@pytest.mark.parametrize("how", OVERLAPPING)
@pytest.mark.parametrize("skin", [0.0, 0.4])
def test_the_mesh_of_overlapping_shells_is_as_large_as_their_layers(how, skin):
    """Triangles within another shell once cut the field, and islands took what was cut off: half, of cubes."""
    part = Part(SHEETS, SurfaceMesh(*OVERLAPPING[how]), skin, "remove")
    vertices, faces, findings = FieldSurface(part, node_grid(part, 10)).mesh()
    h, n = 1 / 20, 200  # faces of the cubes lie between voxels
    solid = part.solid_zyx(Grid((h / 2,) * 3, (h,) * 3, (n, n, n)), 0, n)
    assert edge_counts(faces).bounds_solid
    assert findings["removed_share"] < 2e-3
    # the skin of layers is as thick as whole voxels allow
    assert volume(vertices, faces) == pytest.approx(solid.sum() * h**3, rel=2e-2 if skin else 5e-3)
