"""``fix.fill``: small closed voids become solid and nothing else changes; what is left, and what was added, is said."""

import json

import numpy as np
import pytest
from scipy import ndimage

from sppm_pipeline.errors import ResourceError
from sppm_pipeline.features.printing.stages.fix_fill import FixFill
from sppm_pipeline.features.surface.field_surface import FieldSurface
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.method.part.primitive_meshes import ball_mesh
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.grid import cell_centers
from sppm_pipeline.testing.plain_context import PlainContext


def closed_voids(solid):
    """Closed components of the void by scipy: labels, and the voxels of each."""
    labels, count = ndimage.label(solid == 0)
    sizes = np.bincount(labels.ravel(), minlength=count + 1)
    border = np.ones(solid.shape, bool)
    border[1:-1, 1:-1, 1:-1] = False
    sizes[np.unique(labels[border])] = 0
    sizes[0] = 0
    return labels, sizes


def depth_in(capsules, points):
    """How deep points (..., 3) lie in the deepest of some capsules."""
    deep = np.full(points.shape[:-1], -np.inf)
    for *ends, radius in capsules:
        a, b = np.array(ends[:3]), np.array(ends[3:])
        along = max(float((b - a) @ (b - a)), 1e-300)
        t = np.clip((points - a) @ (b - a) / along, 0, 1)
        deep = np.maximum(deep, radius - np.linalg.norm(points - a - t[..., None] * (b - a), axis=-1))
    return deep


@pytest.fixture(scope="module")
def skinned(wang_tiling):
    return Part(wang_tiling, SurfaceMesh(*ball_mesh((8.0, 6.0, 6.0), 4.5, 3), name="ball"), 0.6)


def test_small_voids_become_solid_and_nothing_else(skinned):
    context = PlainContext()
    made = FixFill(largest=2.0, voxel=Length(0.12, "mm")).run(context, skinned)
    before, grid = skinned.coarse_solid(1, 0.12)
    after, _ = made.coarse_solid(1, 0.12)
    voxel = 0.12**3
    labels, sizes = closed_voids(before)
    small = (sizes > 0) & (sizes * voxel <= 2.0)
    assert small.sum() > 10
    assert (sizes * voxel > 2.0).any()
    assert np.array_equal(after, before | small[labels])
    said = context.reported
    assert said["filled_voids"] == small.sum()
    assert said["added_mm3"] == pytest.approx(sizes[small].sum() * voxel)
    assert said["trapped_before_mm3"] == pytest.approx(sizes.sum() * voxel)
    assert said["trapped_mm3"] == pytest.approx(sizes[~small].sum() * voxel)
    assert said["traps_left"] == np.count_nonzero(sizes[~small])
    assert "larger than `largest`" in context.warnings[0]
    listed = json.loads((context.directory / "fills" / "fills.json").read_text())["fills"]
    assert [row["volume_mm3"] for row in listed] == pytest.approx(sorted(sizes[small] * voxel, reverse=True), rel=1e-5)
    for row in listed:
        k, j, i = (round((row["place_mm"][a] - grid.origin[a]) / 0.12) for a in (2, 1, 0))
        assert sizes[labels[k, j, i]] * voxel == pytest.approx(row["volume_mm3"], rel=1e-5)


def test_layers_samples_and_mesh_agree_and_drains_win(skinned):
    x, y, z = 8.0, 6.0, 6.0
    made = FixFill(largest=50.0).run(PlainContext(), skinned)
    assert len(made.fills)
    grid = cell_centers(20, (4, 3, 3))
    solid = made.solid(grid)
    world = made.in_mm(grid)
    points = np.stack(np.meshgrid(*(world.axis(a) for a in range(3)), indexing="ij"), -1)
    deep = depth_in(made.fills, points)
    inside = np.linalg.norm(points - (x, y, z), axis=-1) < 4.4
    whole = skinned.solid(grid)
    assert ((deep > 1e-5) & inside & (whole == 0)).any()
    assert np.array_equal(solid, np.where(inside & (deep > 1e-5), 1, np.where(deep > -1e-5, solid, whole)))
    values = made.sample(grid)
    assert (values[inside & (deep > 1e-5)] < 0).all()
    assert np.array_equal((values < 0)[deep < -1e-5], (skinned.sample(grid) < 0)[deep < -1e-5])
    assert np.array_equal(made.solid_layers(grid, 17, 31), solid[:, :, 17:31])
    for part in (made, Part(made.base, made.domain, fills=made.fills)):  # with and without a skin
        vertices, faces, _ = FieldSurface(part, grid, "keep").mesh()
        at = np.array(made.origin_mm) + made.physical_edge() * vertices
        within = np.linalg.norm(at - (x, y, z), axis=1) < 4.4
        assert len(faces)
        assert depth_in(made.fills, at[within]).max() < 0.08  # no surface within what was filled, to .4 voxels
    drained = Part(made.base, made.domain, made.skin_mm, drains=((x, y, z, x, y, z - 6, 0.6),), fills=made.fills).solid(
        grid
    )
    hole = (np.hypot(points[..., 0] - x, points[..., 1] - y) < 0.59) & (points[..., 2] < z) & (points[..., 2] > z - 6)
    assert not drained[hole].any()


def test_nothing_to_fill_and_grids_that_are_too_large(skinned):
    part = Part(skinned.base, skinned.domain)
    made = FixFill(largest=1e-6).run(context := PlainContext(), part)
    assert len(made.fills) == context.reported["filled_voids"] == 0
    with pytest.raises(ResourceError, match=r"voxels of 0\.001 mm"):
        FixFill(voxel=Length(0.001, "mm")).run(PlainContext(), part)
    with pytest.raises(ValueError, match="positive radius"):
        Part(skinned.base, skinned.domain, fills=[[0, 0, 0, 1, 1, 1, 0]]).check()
