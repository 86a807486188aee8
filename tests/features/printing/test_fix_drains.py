"""``fix.drains``: shells drain after it, and what no hole opens is said."""

import json

import numpy as np
import pytest

from sppm_pipeline.errors import ConfigError
from sppm_pipeline.features.printing.numerics.routes import find_traps, way_out
from sppm_pipeline.features.printing.stages.fix_drains import FixDrains
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
    # the first hole leaves at the side, near the lowest void
    listed = json.loads((context.directory / "drains" / "drains.json").read_text())["drains"]
    low, high = part.domain.lower[2], part.domain.upper[2]
    assert low - 2 * grid.spacing[0] < listed[0]["to_mm"][2] < low + 0.6 * (high - low)
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
    monkeypatch.setattr(FixDrains, "_drain", lambda *_: (-50.0, 0.0, 0.0, -40.0, 0.0, 0.0, 1.0))
    made, context = fixed(shell(wang_tiling, "ball", 1.0))
    assert made.drains == ()
    assert "no hole opens them" in context.warnings[0]
    assert not (context.directory / "drains" / "plugs.stl").exists()


def test_a_part_that_drains_is_left_alone(wang_tiling):
    part = shell(wang_tiling, "ball", 0.0)
    made, context = fixed(part, smallest=5.0)
    assert made.drains == part.drains == ()
    assert not context.warnings


def test_the_way_out_goes_through_the_least_solid():
    solid = np.zeros((14, 14, 14), np.uint8)
    solid[1:13, 1:13, 1:13] = 1
    solid[4:10, 4:10, 4:11] = 0  # two of solid towards large x, three elsewhere
    solid[2, 5, 5] = 0  # a pore on a way that is as short but for it
    traps = find_traps(solid)
    assert traps.sizes.tolist() == [6 * 6 * 7, 1]
    assert way_out(traps, 2, 2, 13).solid == 2
    assert way_out(traps, 2, 0, 0).end[0] == 0
    assert way_out(traps, 2, 0, 0).solid == 2  # three, of which the pore is one
    assert way_out(traps, 2, 3, 12).end[2] == 13
    assert way_out(traps, 2, 20, 30) is None
