"""``fill.regions``: bodies hold their own fill exactly, and blend into the rest around them."""

import numpy as np
import pytest

from sppm_pipeline.errors import ConfigError, InputError
from sppm_pipeline.features.grading.stages.fill_regions import FillRegions
from sppm_pipeline.features.surface.stages.extract_marching_cubes import MarchingCubes
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.method.part.primitive_meshes import ball_mesh, box_mesh
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.grid import Grid, cell_centers
from sppm_pipeline.services.mesh.measures import volume
from sppm_pipeline.testing.plain_context import PlainContext
from tests.features.grading.test_field_blend import Waves, waves

EDGE = 2.0
FIRST = waves(1, 1.0, 0.6, edge=EDGE, region=(6, 4, 4))
SECOND = waves(2, -0.5, 0.4, edge=3.0)
GRID = cell_centers(12, (6, 4, 4))
X, Y, Z = np.meshgrid(*(EDGE * GRID.axis(axis) for axis in range(3)), indexing="ij")


def regions(*texts, fields=(FIRST, SECOND), domain=None, near=None, blend=1.0):
    stage = FillRegions(regions=texts, blend_width=None if blend is None else Length(blend), probes=50_000)
    stage.check_options()
    return stage.run(PlainContext(), fields, domain, near)


def second():
    """Solid of the second field at the places of the grid, which is in cells of the first."""
    h = EDGE / 3 / 12
    return SECOND.solid(Grid((h / 2,) * 3, (h,) * 3, GRID.shape))


def outside_box(low, high):
    gaps = [np.maximum(np.maximum(a - x, x - b), 0) for x, a, b in zip((X, Y, Z), low, high, strict=True)]
    return np.linalg.norm(gaps, axis=0)


BALL = np.sqrt((X - 8) ** 2 + (Y - 4) ** 2 + (Z - 4) ** 2) - 2.5


def test_a_field_of_its_own_solid_and_void_to_the_sample():
    box = outside_box((1, 1, 1), (4, 7, 7))
    made = regions("field 2 in box 1 1 1 to 4 7 7 mm", "solid in sphere 8 4 4 radius 2.5 mm").solid(GRID)
    assert made[BALL < 0].all()
    assert np.array_equal(made[box == 0], second()[box == 0])
    far = (BALL > 1) & (box > 1)
    assert np.array_equal(made[far], FIRST.solid(GRID)[far])
    hole = regions("empty in cylinder z at 8 4 radius 2 mm from 1 to 6").solid(GRID)
    inside = (np.hypot(X - 8, Y - 4) < 2) & (Z > 1) & (Z < 6)
    assert not hole[inside].any()
    assert hole[~inside].any()


def test_later_bodies_lie_over_earlier_ones():
    one, other = "solid in sphere 8 4 4 radius 2.5 mm", "field 2 in box 5 0 0 to 8 8 8 mm"
    half = (BALL < 0) & (X < 8)
    assert np.array_equal(regions(one, other).solid(GRID)[half], second()[half])
    assert regions(other, one).solid(GRID)[BALL < 0].all()
    # with no width there is nothing between
    sharp = regions(one, other, blend=0.0).solid(GRID)
    assert sharp[(BALL < 0) & (X > 8)].all()
    assert np.array_equal(sharp[(BALL > 0) & (X > 8)], FIRST.solid(GRID)[(BALL > 0) & (X > 8)])


def test_the_porosity_goes_evenly_from_one_to_the_other():
    """Outside of a half space, over the width: linear, within the scatter of pairs of fields."""
    found = {"solid": [], "field 2": []}
    for seed in range(4):
        first = waves(10 + seed, 1.0, 0.6, edge=1.0, region=(3, 6, 6))
        fields = (first, waves(20 + seed, -0.5, 0.3, edge=1.0, origin=(0.3, 0.7, 0.1)))
        for fill in found:
            made = regions(f"{fill} in box -9 -9 -9 to 0 9 9 mm", fields=fields, blend=3.0)
            found[fill].append(1 - made.solid(cell_centers(8, (3, 6, 6))).mean((1, 2)))
    x = (np.arange(24) + 0.5) / 24
    # the mean over whole cells: planes of one cell differ by themselves
    for fill, start in (("solid", 0.0), ("field 2", 0.3)):
        mean = np.mean(found[fill], 0).reshape(3, 8).mean(1)
        wanted = (start + (0.6 - start) * x).reshape(3, 8).mean(1)
        assert abs(mean - wanted).max() < 0.02, (fill, mean, wanted)


def test_a_mesh_is_as_good_as_a_word_and_slabs_do_not_matter():
    ball = SurfaceMesh(*ball_mesh((8.0, 4.0, 4.0), 2.5, 5), name="ball")
    vertices, faces = ball.vertices, ball.faces
    named = SurfaceMesh(
        np.concatenate([box_mesh((6, 4, 4), (11, 7, 7))[0], vertices]),
        np.concatenate([box_mesh((6, 4, 4), (11, 7, 7))[1], faces[:, ::-1] + 8]),
        "part", (("shell", 0, 12), ("core", 12, 12 + len(faces))),
    )  # fmt: skip
    word = regions("solid in sphere 8 4 4 radius 2.5 mm")
    near = regions("solid in near", near=ball)
    group = regions("solid in group core", domain=named)
    for made in (near, group):  # a polyhedron of 5120 triangles lies up to 0.003 mm inside
        assert np.mean(made.solid(GRID) != word.solid(GRID)) < 2e-3
    assert np.array_equal(near.solid(GRID), group.solid(GRID))
    # one that lies beside the grid is felt in it
    beside = SurfaceMesh(*box_mesh((-2.0, 4.0, 4.0), (2.0, 4.0, 20.0)))
    other = regions("solid in near", near=beside, blend=4.0).solid(GRID)
    assert np.array_equal(other, regions("solid in box -3 2 -6 to -1 6 14 mm", blend=4.0).solid(GRID))
    assert (other != FIRST.solid(GRID)).mean() > 0.01
    whole = near.sample_zyx(GRID, 0, GRID.shape[2])
    parts = [near.sample_zyx(GRID, *ends, 2) for ends in ((0, 7), (7, 8), (8, GRID.shape[2]))]
    assert np.array_equal(np.concatenate(parts), whole)


def test_the_mesh_of_a_part_holds_as_much_as_its_layers():
    domain = SurfaceMesh(*box_mesh((6.0, 4.0, 4.0), (11.0, 7.0, 7.0)), name="box")
    empty = regions("solid in sphere 8 4 4 radius 2.5 mm", "empty in sphere 8 4 4 radius 1 mm", blend=0.5)
    part = Part(empty, domain, islands="keep")
    mesh = MarchingCubes(resolution=20).run(PlainContext(), part)
    counted = part.solid(cell_centers(20, (6, 4, 4))).sum() * (EDGE / 20) ** 3
    assert volume(mesh.vertices, mesh.faces) == pytest.approx(counted, rel=5e-3)
    # the surface of the cavity is that of the ball
    away = np.linalg.norm(mesh.vertices - [8, 4, 4], axis=1)
    wall = away[away < 1.4]
    assert len(wall) > 500
    assert abs(wall - 1).max() < 0.01


def test_what_is_refused(run_yaml):
    for text, match in (
        ("filled in near", "fills nothing"), ("field 0 in near", "fills nothing"), ("solid in", "fills nothing"),
        ("solid in plane z at 0", "has no inside"), ("solid in surface", "has no inside"),
        ("solid in ball 3", "expected 'plane'"), ("empty in box 0 0 0 to 1 1", "expected a number"),
    ):  # fmt: skip
        with pytest.raises(ConfigError, match=match):
            FillRegions(regions=(text,)).check_options()
    with pytest.raises(ConfigError, match="no `regions`"):
        FillRegions(regions=()).check_options()
    with pytest.raises(ConfigError, match="no field 3, only 2"):
        regions("field 3 in sphere 0 0 0 radius 1")
    with pytest.raises(ConfigError, match="needs a mesh"):
        regions("solid in body boss")
    with pytest.raises(ConfigError, match="no size in millimeters"):
        regions("solid in sphere 0 0 0 radius 1", fields=(FIRST, Waves(seed=1, power=1.0)))
    box = box_mesh((6, 4, 4), (11, 7, 7))
    mesh = SurfaceMesh(*box, "box", (("lid", 0, 2), ("rest", 2, 12)))
    with pytest.raises(InputError, match="the 2 triangles do not close"):
        regions("solid in group lid", domain=mesh)
    with pytest.raises(InputError, match="no group 'boss'"):
        regions("solid in group boss", domain=mesh)


def test_in_a_configuration_it_is_kept_and_repeated(run_yaml):
    text = """
seed: 3
recipes:
  cell:
    - {stage: sample.dart_throwing, count: 16, spacing: 0.2}
    - {stage: connect.mst}
    - {stage: field.gaussian, pore_radius: 0.16, tunnel_radius: 0.06}
pipeline:
  - {stage: read.primitive, shape: box, size: [9 mm, 6 mm, 6 mm]}
  - {stage: tile.scattered, id: coarse, recipe: cell, cell: 3 mm, porosity: 0.7, resolution: 8}
  - {stage: tile.scattered, id: fine, recipe: cell, cell: 2 mm, porosity: 0.5, resolution: 8}
  - {stage: fill.regions, from: {fields: [coarse, fine]}, blend_width: 1 mm, probes: 10000,
     regions: [field 2 in box 0 0 0 to 4.5 9 9 mm, solid in cylinder z at 0 0 radius 1 mm]}
  - {stage: fill.implicit, islands: keep}
  - {stage: slice.field, pixel: 0.2 mm}
  - {stage: write.png, path: layers}
"""
    record, out = run_yaml(text)
    _, other = run_yaml(text)
    stages = {stage["id"]: stage for stage in record["stages"]}
    found = stages["fill.regions"]["summary"]["porosities"]
    assert found[0] == pytest.approx(0.7, abs=0.06)
    assert found[1] == pytest.approx(0.5, abs=0.06)
    files = [[path.read_bytes() for path in sorted((one / "layers").glob("*.png"))] for one in (out, other)]
    assert files[0] == files[1]
