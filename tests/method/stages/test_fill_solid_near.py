"""Solid kept around named faces: exactly what is near them, in layers, samples, meshes, and with skin and border."""

import numpy as np
import pytest

from sppm_pipeline.errors import ConfigError, InputError
from sppm_pipeline.features.surface.stages.extract_marching_cubes import MarchingCubes
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.method.part.primitive_meshes import box_mesh
from sppm_pipeline.method.stages.fill_implicit import ImplicitFill
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.grid import cell_centers
from sppm_pipeline.services.mesh.measures import volume
from sppm_pipeline.testing.plain_context import PlainContext

GRID = cell_centers(16, (4, 3, 3))


def box():
    """A box whose faces at low z and high x are named as those of a CAD file."""
    vertices, faces = box_mesh((8.03, 6.02, 6.01), (12.0, 8.0, 8.0))
    middles = vertices[faces].mean(1)
    low, right = middles[:, 2] < 2.1, middles[:, 0] > 13.9
    order = np.concatenate([np.flatnonzero(one) for one in (low, right, ~(low | right))])
    groups = (("#1 plane color=#ff0000", 0, 2), ("#2 plane", 2, 4), ("#3 plane", 4, 12))
    return SurfaceMesh(vertices, faces[order], "box", groups)


BOX = box()


def filled(field, **options):
    context = PlainContext()
    stage = ImplicitFill(**options)
    stage.check_options()
    return stage.run(context, field, BOX), context


def near(part):
    """Samples within the box, and those of them that are near the two faces."""
    world = part.in_mm(GRID)
    at = np.stack(np.meshgrid(*(world.axis(a) for a in range(3)), indexing="ij"), -1)
    low, high = at - BOX.lower, BOX.upper - at
    inside = (np.minimum(low, high) > 0).all(-1)
    return inside, np.minimum(low[..., 2], high[..., 0]), np.minimum(low, high).min(-1)


@pytest.mark.parametrize("skin", [None, Length(0.8)])
def test_it_is_exactly_what_lies_near_the_faces_and_the_skin_stays(wang_tiling, skin):
    bare, _ = filled(wang_tiling, skin=skin)
    part, context = filled(wang_tiling, skin=skin, solid_near=("color red", "#2"), solid_within=Length(2.1))
    inside, away, _ = near(part)
    solid = part.solid(GRID)
    assert np.array_equal(solid, bare.solid(GRID) | (inside & (away <= 2.1)))
    assert (solid != bare.solid(GRID)).any()
    assert np.array_equal(part.solid_layers(GRID, 9, 21), solid[:, :, 9:21])
    # distances are offered from sample to sample: exact to a small share of the spacing
    assert np.mean((part.sample(GRID) < 0) != (solid > 0)) < (1e-9 if skin is None else 2e-3)
    assert context.reported["solid_triangles"] == part.summary()["solid_triangles"] == 4
    _, counts = part.counted_bits(GRID, 0, GRID.shape[2])
    assert counts["skin"] >= (inside & (away <= 2.1)).sum()


def test_its_mesh_holds_as_much_as_its_layers(wang_tiling):
    part, _ = filled(wang_tiling, solid_near=("#1", "#2"), solid_within=Length(2.0), islands="keep")
    made = MarchingCubes(resolution=32).run(PlainContext(), part)
    fine = cell_centers(32, (4, 3, 3))
    counted = part.solid(fine).sum() * (4 / 32) ** 3
    assert volume(made.vertices, made.faces) == pytest.approx(counted, rel=3e-3)
    # no surface within the solid, whose own is flat
    deep = np.minimum(made.vertices[:, 2] - BOX.lower[2], BOX.upper[0] - made.vertices[:, 0])
    depth = np.minimum(made.vertices - BOX.lower, BOX.upper - made.vertices).min(1)
    assert not ((deep < 1.98) & (depth > 1e-3)).any()
    assert (np.abs(deep - 2.0) < 1e-3).sum() > 500


def test_drains_win_and_a_border_is_put_on_after_it(wang_tiling):
    drain = (4.0, 6.0, 1.0, 4.0, 6.0, 5.0, 0.7)
    options = {"solid_near": ("#1",), "solid_within": Length(2.0)}
    part, _ = filled(wang_tiling, drains=(drain,), border="round", thinnest=Length(0.6), **options)
    inside, _, depth = near(part)
    world = part.in_mm(GRID)
    x, y, z = np.meshgrid(*(world.axis(a) for a in range(3)), indexing="ij")
    axis = np.hypot(x - 4, y - 6)
    solid = part.solid(GRID)
    assert not solid[(axis < 0.69) & (z < 4)].any()
    assert solid[inside & (z < BOX.lower[2] + 1.9) & (depth > 0.5) & (axis > 1.3)].all()


def test_what_is_refused(wang_tiling):
    for options in ({"solid_near": ("holes",)}, {"solid_within": Length(1)}):
        with pytest.raises(ConfigError, match="both or none"):
            ImplicitFill(**options).check_options()
    with pytest.raises(ConfigError, match=r"solid near faces of 0\.5 mm is not sure"):
        ImplicitFill(solid_near=("x",), solid_within=Length(0.5), border="round").check_options()
    with pytest.raises(InputError, match="no group 'holes'"):
        filled(wang_tiling, solid_near=("holes",), solid_within=Length(1))
    with pytest.raises(ValueError, match="does not have"):
        Part(wang_tiling, BOX, solid_mm=1.0, solid_faces=[12]).check()
