"""Layers of meshes: analytic solids, agreement with layers of a field, meshes with holes."""

import numpy as np
import pytest

from sppm_pipeline.errors import DesignError, InputError
from sppm_pipeline.features.surface.stages.extract_marching_cubes import MarchingCubes
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.part.primitive_meshes import ball_mesh, box_mesh, torus_knot_mesh
from sppm_pipeline.method.slicing import sampled_slices
from sppm_pipeline.method.stages.slice_field import SliceField
from sppm_pipeline.method.stages.slice_mesh import SliceMesh
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.testing.plain_context import PlainContext

KNOT = SurfaceMesh(*torus_knot_mesh((0, 0, 0), (2, 3), 6.0, 2.5, 1.5, 160, 24), name="knot.stl")


def layers(stack):
    """All layers, and that slabs come in order without a gap."""
    return layers_and_findings(stack)[0]


def layers_and_findings(stack):
    slabs, at = [], 0
    reading = stack.slabs()
    for start, slab in reading:
        assert start == at
        at += len(slab)
        slabs.append(slab.copy())
    found = np.concatenate(slabs)
    assert found.shape == stack.shape[::-1]
    assert found.dtype == np.uint8
    return found, reading.findings


def slices(mesh, context=None, **options):
    stage = SliceMesh(**{name: Length(v) if name in ("pixel", "layer") else v for name, v in options.items()})
    stage.check_options()
    return stage.run(context or PlainContext(), mesh)


def middles(stack):
    nx, ny, nz = stack.shape
    ox, oy, oz = stack.origin_mm
    (hx, hy), layer = stack.pixel_mm, stack.layer_mm
    z, y, x = np.meshgrid(
        oz + (np.arange(nz) + 0.5) * layer,
        oy + (np.arange(ny) + 0.5) * hy,
        ox + (np.arange(nx) + 0.5) * hx,
        indexing="ij",
    )
    return x, y, z


def test_a_box_fills_its_layers():
    stack = slices(SurfaceMesh(*box_mesh((1.0, 2.0, 3.0), (4, 3, 2))), pixel=0.25, layer=0.1)
    assert stack.shape == (16, 12, 20)
    assert stack.origin_mm == (-1, 0.5, 2)
    found, findings = layers_and_findings(stack)
    assert (found == 255).all()
    assert findings["solid_volume_mm3"] == pytest.approx(24)
    assert findings["solid_share_of_box"] == 1
    assert not stack.gray


@pytest.mark.parametrize("anchor", ["part", "origin"])
def test_a_ball_is_decided_at_the_middle_of_each_pixel(anchor):
    vertices, faces = ball_mesh((0.13, 0.21, 5.37), 3.0, 5)
    stack = slices(SurfaceMesh(vertices, faces), pixel=0.2, layer=0.11, anchor=anchor)
    x, y, z = middles(stack)
    far = np.sqrt((x - 0.13) ** 2 + (y - 0.21) ** 2 + (z - 5.37) ** 2)
    found = layers(stack) > 0
    deep = np.linalg.norm(vertices[faces].mean(1) - (0.13, 0.21, 5.37), axis=1).min()
    assert found[far < deep].all()
    assert not found[far > 3].any()
    assert np.mean((far > deep) & (far < 3)) < 0.002
    for o, low, h in zip(stack.origin_mm, vertices.min(0), (0.2, 0.2, 0.11), strict=True):
        assert o <= low + 1e-9 < o + h
        if anchor == "origin":
            assert o / h == pytest.approx(round(o / h))
        else:
            assert o == low


def test_layers_of_a_field_and_of_its_mesh(wang_tiling):
    """They differ by less than a pixel at the border of the solid."""
    mesh = MarchingCubes(resolution=48, islands="keep").run(PlainContext(), wang_tiling)
    by_field = SliceField(pixel=Length(0.16), islands="keep").run(PlainContext(), wang_tiling)
    by_mesh = slices(mesh, pixel=0.16, anchor="origin")
    assert by_mesh.shape == by_field.shape
    assert by_mesh.origin_mm == pytest.approx(by_field.origin_mm)
    one, other = layers(by_field) > 0, layers(by_mesh) > 0
    differ = one != other
    assert np.count_nonzero(one & other) / np.count_nonzero(one | other) > 0.985
    border = np.zeros_like(one)
    for axis in range(3):
        for shift in (1, -1):
            border |= np.roll(one, shift, axis) != one
    assert not (differ & ~border).any()


def test_slabs_and_gray(monkeypatch):
    found = layers(slices(KNOT, pixel=0.3, layer=0.2))
    fine = layers(slices(KNOT, pixel=0.1, layer=0.2))
    gray = slices(KNOT, pixel=0.3, layer=0.2, gray=3)
    assert gray.gray
    shades = layers(gray)
    ny, nx = found.shape[1:]
    padded = np.zeros((len(fine), 3 * ny, 3 * nx))
    padded[:, : fine.shape[1], : fine.shape[2]] = fine
    share = padded.reshape(-1, ny, 3, nx, 3).mean((2, 4))
    assert np.abs(shades - share).max() <= 0.5 + 1e-6
    high = layers(slices(KNOT, pixel=0.3, layer=0.3, gray_layers=3))
    low = layers(slices(KNOT, pixel=0.3, layer=0.1)) > 0
    low = np.pad(low, ((0, 3 * len(high) - len(low)), (0, 0), (0, 0))).reshape(len(high), 3, *low.shape[1:])
    assert np.abs(high - 255 * low.mean(1)).max() <= 0.5 + 1e-6
    monkeypatch.setattr(sampled_slices, "SLAB_PIXELS", 1)
    assert layers(slices(KNOT, pixel=0.3, layer=0.2)).tobytes() == found.tobytes()
    assert layers(slices(KNOT, pixel=0.3, layer=0.3, gray_layers=3)).tobytes() == high.tobytes()


@pytest.mark.parametrize("inside", ["auto", "vote"])
def test_a_mesh_with_a_hole_wound_at_random(inside, monkeypatch):
    expected = layers(slices(KNOT, pixel=0.3)) > 0
    rng = np.random.default_rng(0)
    faces = KNOT.faces[6:]
    faces = np.where(rng.random(len(faces))[:, None] < 0.4, faces[:, ::-1], faces)
    broken, context = SurfaceMesh(KNOT.vertices, faces, name="scan.stl"), PlainContext()
    stack = slices(broken, context, pixel=0.3, inside=inside)
    found, findings = layers_and_findings(stack)
    assert np.mean((found > 0) != expected) < 0.001
    assert context.reported["inside"] == ("vote" if inside == "vote" else "winding")
    assert context.reported["turned_triangles"] > 1000
    assert 0 < context.reported["undecided_share"] < 0.05
    assert any("not closed" in warning for warning in context.warnings)
    assert 0 < findings["undecided_share"] < 0.05
    for limit in ("SLAB_PIXELS", "VOTED_PIXELS"):
        monkeypatch.setattr(sampled_slices, limit, 10_000)
    assert layers(slices(broken, pixel=0.3, inside=inside)).tobytes() == found.tobytes()


def test_what_cannot_be_sliced():
    rng = np.random.default_rng(0)
    soup = SurfaceMesh(rng.random((120, 3)), np.arange(120).reshape(40, 3), name="soup.stl")
    with pytest.raises(InputError, match=r"soup.stl is not closed.*inside from outside") as caught:
        slices(soup, pixel=0.1)
    assert "check.mesh" in caught.value.hint
    with pytest.raises(InputError, match="no triangles"):
        slices(SurfaceMesh(np.zeros((0, 3)), np.zeros((0, 3), int)), pixel=0.1)
    with pytest.raises(DesignError, match="pixels") as caught:
        slices(KNOT, pixel=1e-5)
    assert "unit" in caught.value.hint
