"""Primitive meshes against the formulas of the bodies they are inscribed in."""

import math

import numpy as np
import pytest

from sppm_pipeline.method.part import primitive_meshes as meshes
from sppm_pipeline.method.part.ray_crossings import prepare_scan
from sppm_pipeline.method.part.scanline import scan_layers
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.mesh.measures import measure_surface, surface_area, volume

GRID = Grid((-1.52, -1.49, -1.47), (0.061, 0.059, 0.063), (50, 51, 47))
CENTER = (0.02, -0.03, 0.05)


def knot(turns, radius, swing, points):
    """A closed curve, `turns` times around the z axis and around the ring of a torus."""
    t = np.arange(points) * (2 * np.pi / points)
    r = radius + swing * np.cos(turns[1] * t)
    return np.stack([r * np.cos(turns[0] * t), r * np.sin(turns[0] * t), swing * np.sin(turns[1] * t)], axis=1)


def in_knot(x, y, z):
    """Distance of at most 0.2 from the knot, taken as a polygon."""
    curve = knot((2, 3), 0.9, 0.35, 200)
    points = np.stack([x, y, z], axis=-1)
    least = np.full(x.shape, np.inf)
    for p, q in zip(curve, np.roll(curve, -1, axis=0), strict=True):
        e = q - p
        t = np.clip(((points - p) @ e) / (e @ e), 0, 1)
        least = np.minimum(least, np.linalg.norm(points - p - t[..., None] * e, axis=-1))
    return least <= 0.2


CASES = {
    "box": (
        lambda x, y, z: (abs(x) <= 0.75) & (abs(y) <= 1.0) & (abs(z) <= 0.55),
        meshes.box_mesh(CENTER, (1.5, 2.0, 1.1)),
        3.3,
    ),
    "ball": (
        lambda x, y, z: x**2 + y**2 + z**2 <= 1.44,
        meshes.ball_mesh(CENTER, 1.2, 5),
        4 / 3 * math.pi * 1.2**3,
    ),
    "cylinder": (
        lambda x, y, z: (x**2 + y**2 <= 0.64) & (abs(z) <= 0.85),
        meshes.cylinder_mesh(CENTER, 0.8, 1.7, 256),
        math.pi * 0.64 * 1.7,
    ),
    "torus": (
        lambda x, y, z: (np.hypot(x, y) - 0.9) ** 2 + z**2 <= 0.35**2,
        meshes.torus_mesh(CENTER, 0.9, 0.35, 256, 96),
        2 * math.pi**2 * 0.9 * 0.35**2,
    ),
    "knot": (in_knot, meshes.torus_knot_mesh(CENTER, (2, 3), 0.9, 0.35, 0.2, 512, 64), None),
}


@pytest.mark.parametrize("name", CASES)
def test_the_mesh_holds_what_the_formula_says(name):
    formula, mesh, size = CASES[name]
    x, y, z = (GRID.axis(a) - CENTER[a] for a in range(3))
    zz, yy, xx = np.meshgrid(z, y, x, indexing="ij")
    inside = formula(xx, yy, zz)
    by_mesh = scan_layers(prepare_scan(*mesh, GRID), 0, 47).mask
    assert (inside ^ by_mesh.astype(bool)).sum() <= 0.006 * inside.sum()
    if size is not None:
        assert volume(*mesh) == pytest.approx(size, rel=2e-3)


@pytest.mark.parametrize(
    ("mesh", "genus"),
    [
        (meshes.box_mesh(CENTER, (1, 2, 3)), 0),
        (meshes.ball_mesh(CENTER, 1.0, 0), 0),
        (meshes.ball_mesh(CENTER, 1.0, 3), 0),
        (meshes.cylinder_mesh(CENTER, 1.0, 2.0, 3), 0),
        (meshes.torus_mesh(CENTER, 1.0, 0.3, 3, 3), 1),
        (meshes.torus_knot_mesh(CENTER), 1),
        (meshes.torus_knot_mesh(CENTER, (3, 5), 1.0, 0.4, 0.1, 700, 12), 1),
    ],
)
def test_meshes_are_closed_and_wound_outwards(mesh, genus):
    found = measure_surface(*mesh)
    assert found.edges.closed
    assert (found.components, found.genus, found.degenerate) == (1, genus, 0)
    assert found.volume > 0
    assert mesh[0].dtype == np.float64
    assert mesh[1].dtype == np.int32


def test_a_knotted_tube_has_the_volume_and_area_of_its_curve():
    """Pappus: a tube around a curve has area 2 pi r L and volume pi r^2 L, however the curve bends."""
    curve = knot((2, 3), 1.0, 0.4, 4000)
    length = np.linalg.norm(curve - np.roll(curve, 1, axis=0), axis=1).sum()
    mesh = meshes.torus_knot_mesh((0, 0, 0), (2, 3), 1.0, 0.4, 0.1, 1200, 96)
    assert volume(*mesh) == pytest.approx(math.pi * 0.01 * length, rel=2e-3)
    assert surface_area(*mesh) == pytest.approx(2 * math.pi * 0.1 * length, rel=2e-3)
