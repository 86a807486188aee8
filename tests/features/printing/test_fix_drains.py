"""``fix.drains``: shells drain after it, and what no hole opens is said."""

import json
from dataclasses import replace

import numpy as np
import pytest
from manifold3d import Manifold

from benchmarks.drains import FAMILIES, KINDS, drawing, mesh_of, outcome
from sppm_pipeline.errors import ConfigError, InputError
from sppm_pipeline.features.printing.numerics.routes import find_traps, mesh_features
from sppm_pipeline.features.printing.stages.fix_drains import FixDrains
from sppm_pipeline.method.connectivity.components import find_components
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.method.part.primitive_meshes import ball_mesh, box_mesh, cylinder_mesh, torus_mesh
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.testing.plain_context import PlainContext

SHAPES = {
    "ball": ball_mesh((8.0, 6.0, 6.0), 4.5, 3),
    "box": box_mesh((8.0, 6.0, 6.0), (9.0, 7.0, 6.0)),
    "cylinder": cylinder_mesh((8.0, 6.0, 6.0), 4.0, 8.0),
    "torus": torus_mesh((8.0, 6.0, 6.0), 4.0, 1.8, 48, 24),
}


def shell(tiling, shape, skin):
    return Part(tiling, SurfaceMesh(*SHAPES[shape], name=shape), skin)


def fixed(part, **options):
    context = PlainContext()
    return FixDrains(**options).run(context, part), context


@pytest.mark.parametrize(("shape", "skin"), [("ball", 1.0), ("box", 0.6), ("cylinder", 1.0), ("torus", 0.6)])
def test_shells_drain(wang_tiling, shape, skin):
    part = shell(wang_tiling, shape, skin)
    made, context = fixed(part)
    found = context.reported
    assert found["trapped_before_mm3"] > 10
    assert found["traps_left"] == 0
    assert not context.warnings
    assert 1 <= found["holes"] == len(made.drains) <= 6
    assert found["trapped_mm3"] < 0.1 * found["trapped_before_mm3"]
    assert (context.directory / "drains" / "drains.png").read_bytes()[:4] == b"\x89PNG"
    # the drains of the part do what the drilled grid did
    solid, grid = made.coarse_solid()
    assert find_traps(solid).sizes.sum() * grid.spacing[0] ** 3 == pytest.approx(found["trapped_mm3"])
    whole, _ = part.coarse_solid()
    assert (solid <= whole).all()
    radii = np.inf * np.ones(solid.shape)
    z, y, x = np.meshgrid(*(grid.axis(axis) for axis in (2, 1, 0)), indexing="ij")
    for *ends, radius in made.drains:
        a, b = np.array(ends[:3]), np.array(ends[3:])
        points = np.stack([x, y, z], -1) - a
        t = np.clip(points @ (b - a) / ((b - a) @ (b - a)), 0, 1)
        radii = np.minimum(radii, np.linalg.norm(points - t[..., None] * (b - a), axis=-1) - radius)
    assert np.array_equal(solid, np.where(radii < -1e-6, 0, np.where(radii > 1e-6, whole, solid)))
    # the first hole leaves low at the side, but not within its diameter of the plate
    listed = json.loads((context.directory / "drains" / "drains.json").read_text())["drains"]
    low, high = part.domain.lower[2], part.domain.upper[2]
    assert low + 1.5 < listed[0]["to_mm"][2] < low + max(0.6 * (high - low), 2 * 1.5)
    assert (context.directory / "drains" / "plugs.stl").stat().st_size == 84 + 50 * 256 * len(listed)


def test_what_is_left_is_said(wang_tiling):
    two = [ball_mesh((x, 6.0, 6.0), 3.0, 3) for x in (4.0, 12.0)]
    mesh = SurfaceMesh(
        np.concatenate([vertices for vertices, _ in two]), np.concatenate([two[0][1], two[1][1] + len(two[0][0])])
    )
    part = Part(wang_tiling, mesh, 0.6)
    made, context = fixed(part, most=1)
    assert len(made.drains) == context.reported["holes"] == 1
    assert context.reported["traps_left"] >= 1
    assert "`most` allows 1 holes" in context.warnings[0]
    with pytest.raises(ConfigError, match="narrower than the voxels"):
        fixed(part, diameter=Length(0.01))


def test_a_way_that_opens_nothing_is_not_drilled(wang_tiling, monkeypatch):
    monkeypatch.setattr(FixDrains, "_drains", lambda *_: iter([(-50.0, 0.0, 0.0, -40.0, 0.0, 0.0, 1.0)]))
    made, context = fixed(shell(wang_tiling, "ball", 1.0))
    assert made.drains == ()
    assert "opens them" in context.warnings[0]
    assert not (context.directory / "drains" / "plugs.stl").exists()


def test_a_part_that_drains_is_left_alone(wang_tiling):
    part = shell(wang_tiling, "ball", 0.0)
    made, context = fixed(part, smallest=5.0)
    assert made.drains == part.drains == ()
    assert not context.warnings


def cylinder(height, radius, n=48):
    return Manifold.cylinder(height, radius, -1.0, n)


def cad_parts():
    """Parts in the region of the tiling, and the axes (point, direction, radius) of the holes that they have."""
    bracket = Manifold.cube((15, 11, 4)) + Manifold.cube((4, 11, 11))
    bracket -= cylinder(40, 0.9).translate((9, 2.5, -20)) + cylinder(40, 0.9).translate((9, 8.5, -20))
    bracket -= cylinder(40, 1.1).rotate((0, 90, 0)).translate((-20, 5.5, 8))
    plate = Manifold.cube((15, 11, 5))
    places = [(3, 3), (12, 3), (3, 8), (12, 8)]
    for x, y in places:
        plate -= cylinder(40, 0.8).translate((x, y, -20))
    tube = cylinder(11, 5.4, 64).translate((8, 6, 0)) - cylinder(40, 1.4, 64).translate((8, 6, -20))
    up, across = (0, 0, 1), (1, 0, 0)
    return {
        "bracket": (bracket, [((9, 2.5, 0), up, 0.9), ((9, 8.5, 0), up, 0.9), ((0, 5.5, 8), across, 1.1)]),
        "plate": (plate, [((x, y, 0), up, 0.8) for x, y in places]),
        "tube": (tube, [((8, 6, 0), up, 1.4)]),
    }


def sharp_edges(vertices, faces):
    normals = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    sides = {}
    for number, face in enumerate(faces):
        for a, b in zip(face, np.roll(face, -1), strict=True):
            sides.setdefault(frozenset((int(a), int(b))), []).append(normals[number])
    return [vertices[list(edge)] for edge, (one, other) in sides.items() if one @ other < np.cos(np.radians(40))]


def off_segment(points, a, b):
    t = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
    return np.linalg.norm(points - a - t[:, None] * (b - a), axis=1)


@pytest.mark.parametrize("which", ["bracket", "plate", "tube"])
def test_holes_edges_and_plate_are_spared(wang_tiling, which):
    """Once, drains opened the build plate over their full circle, began in bolt holes, and cut pieces off."""
    body, bores = cad_parts()[which]
    mesh = body.to_mesh64()
    vertices, faces = np.array(mesh.vert_properties[:, :3]), np.array(mesh.tri_verts, np.int32)
    part = Part(wang_tiling, SurfaceMesh(vertices, faces), 0.6)
    made, context = fixed(part, diameter=Length(0.8))
    assert made.drains
    assert context.reported["traps_left"] == 0
    edges = sharp_edges(vertices, faces)
    for *ends, radius in made.drains:
        a, b = np.array(ends[:3]), np.array(ends[3:])
        axis = a + np.linspace(0, 1, 21)[:, None] * (b - a)
        assert min(off_segment(axis[-1:], *edge).min() for edge in edges) >= radius + 0.8 - 1e-9
        for origin, along, bore in bores:
            way = axis - np.array(origin)
            way -= np.outer(way @ np.array(along), along)
            assert np.linalg.norm(way, axis=1).min() >= bore + radius + 0.8 - 0.05  # a bore is a polygon
        assert axis[:, 2].min() - radius * np.sqrt(1 - ((b - a) / np.linalg.norm(b - a))[2] ** 2) >= 0.8 - 1e-9
    # nothing was cut off
    before, after = (find_components(one.coarse_solid()[0], (False,) * 3, 6).sizes for one in (part, made))
    assert after.sum() - after.max() <= before.sum() - before.max()


def test_what_is_to_be_kept_clear_is(wang_tiling):
    part = shell(wang_tiling, "box", 0.6)
    free, _ = fixed(part, diameter=Length(0.8), toward=(0.0, 0.0, 1.0))
    assert all(drain[5] > part.domain.upper[2] - 0.1 for drain in free.drains)  # they open on top
    vertices, faces = box_mesh((8.0, 6.0, 9.5), (20.0, 20.0, 1.0))  # just above
    context = PlainContext()
    stage = FixDrains(diameter=Length(0.8), toward=(0.0, 0.0, 1.0), keep_out_within=Length(0.8))
    made = stage.run(context, part, SurfaceMesh(vertices, faces))
    assert made.drains
    assert all(drain[5] + drain[6] + 0.8 <= 9.0 for drain in made.drains)
    with pytest.raises(ConfigError, match="none is wired"):
        stage.run(context, part, part.domain)
    # the same by a name of faces: none near the top, whose triangles have a group
    faces = part.domain.faces
    top = np.flatnonzero((part.domain.vertices[faces, 2] > part.domain.upper[2] - 1e-6).all(1))
    groups = tuple((f"#{n} plane name=lid", int(n), int(n) + 1) for n in top)
    named = replace(part, domain=replace(part.domain, groups=groups))
    made, _ = fixed(named, diameter=Length(0.8), toward=(0.0, 0.0, 1.0), keep_out_faces=("name lid",))
    assert made.drains
    assert all(drain[5] + drain[6] + 0.8 <= part.domain.upper[2] + 1e-6 for drain in made.drains)
    with pytest.raises(InputError, match="no group 'holes'"):
        fixed(named, keep_out_faces=("holes",))
    with pytest.raises(ConfigError, match="no direction"):
        FixDrains(toward=(0.0, 0.0, 0.0)).check_options()


def test_a_part_that_is_all_edges_says_so(wang_tiling):
    made, context = fixed(shell(wang_tiling, "box", 0.6), clear=Length(4, "mm"))
    assert made.drains == ()
    assert "lower `clear`" in context.warnings[0]


@pytest.mark.parametrize("family", FAMILIES)
def test_every_hole_of_a_drawing_is_found(family):
    """Bores in slivers that Booleans leave, that cross each other, or that have a cone at their mouth, were not."""
    for seed in range(3):
        made = drawing(family, seed)
        mesh = mesh_of(made.body)
        found = mesh_features(mesh.vertices, mesh.faces).holes

        def area_on(hole, triangles):
            along = (hole.b - hole.a) / np.linalg.norm(hole.b - hole.a)
            way = triangles.mean(1) - hole.a
            at = way @ along
            near = np.abs(np.linalg.norm(way - np.outer(at, along), axis=1) - hole.radii[0]) < 0.05
            near &= (at > -0.1) & (at < np.linalg.norm(hole.b - hole.a) + 0.1)
            sides = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
            return np.linalg.norm(sides[near], axis=1).sum() / 2

        triangles = mesh.vertices[mesh.faces]
        bores = [hole for hole in made.holes if hole.radii[0] == hole.radii[1]]
        assert bores
        for hole in bores:
            assert area_on(hole, found) > 0.95 * area_on(hole, triangles) > 0
        outside = triangles[(triangles[..., 2] < mesh.lower[2] + 1e-6).all(1)]  # the underside is none
        assert not (found[..., 2] < mesh.lower[2] + 1e-6).all(1).any() or not len(outside)


@pytest.mark.parametrize(("family", "seed"), [("lug", 3), ("tee", 1), ("shaft", 0), ("plate", 2)])
def test_drains_of_drawings(family, seed):
    """Parts of benchmarks/drains.py; drains of the first and the third once began in the wall of a hole."""
    found = outcome(drawing(family, seed), KINDS[seed % 3])
    assert found.drains
    assert min(found.hole, found.edge, found.plate) > 0.99
    assert found.after < found.before
    assert bool(found.left) == found.said == (KINDS[seed % 3] == "pores apart")
