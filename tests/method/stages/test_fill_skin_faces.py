"""A skin on some faces: the same in layers, samples and mesh, and what it seals is told."""

import numpy as np
import pytest

from sppm_pipeline.errors import ConfigError, InputError
from sppm_pipeline.features.files.formats.detect import decode_mesh_file
from sppm_pipeline.features.surface.field_surface import FieldSurface
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.part.inside import inside_layers, prepare_inside
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.method.part.primitive_meshes import ball_mesh, box_mesh
from sppm_pipeline.method.stages.fill_implicit import ImplicitFill
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.grid import cell_centers
from sppm_pipeline.testing.plain_context import PlainContext

GRID = cell_centers(16, (4, 3, 3))
BOX = SurfaceMesh(*box_mesh((8.03, 6.02, 6.01), (12.0, 8.0, 8.0)), name="box")


def filled(field, mesh, near=None, **options):
    context = PlainContext()
    return ImplicitFill(**options).run(context, field, mesh, near), context


def depths(part):
    """x, y, z of the samples less the low corner of the box, and those of the high corner less them."""
    world = part.in_mm(GRID)
    at = np.stack(np.meshgrid(*(world.axis(a) for a in range(3)), indexing="ij"), -1)
    return at - part.domain.lower, part.domain.upper - at


def test_two_sides_of_a_box(wang_tiling):
    """A skin on the side of low z and on that of high x: exactly what is near one of these rectangles."""
    part, context = filled(wang_tiling, BOX, skin=Length(0.9), skin_toward=((0, 0, -1), (2, 0, 0)), skin_angle=1.0)
    bare, _ = filled(wang_tiling, BOX)
    low, high = depths(part)
    inside = (np.minimum(low, high) > 0).all(-1)
    expected = inside & ((low[..., 2] <= 0.9) | (high[..., 0] <= 0.9))
    solid = part.solid(GRID)
    assert np.array_equal(solid, bare.solid(GRID) | expected)
    assert (solid != bare.solid(GRID)).any()
    assert np.array_equal(part.solid_layers(GRID, 9, 21), solid[:, :, 9:21])
    assert np.array_equal(part.sample(GRID) < 0, solid > 0)
    assert context.reported["skin_triangles"] == 4
    assert context.reported["skin_area_mm2"] == pytest.approx(12 * 8 + 8 * 8)
    assert part.summary()["skin_triangles"] == 4
    # two of six sides seal less than all of them, and little
    _, sealed = filled(wang_tiling, BOX, skin=Length(0.9))
    assert 0 <= context.reported["sealed_mm3"] < 0.2 * sealed.reported["sealed_mm3"]
    assert any("seals about" in text for text in sealed.warnings)
    assert not any("seals about" in text for text in context.warnings)


def test_the_mesh_has_the_same_skin(wang_tiling, ball):
    part, _ = filled(wang_tiling, ball, skin=Length(1.0), skin_toward=((0, 0, -1),), skin_angle=50.0)
    chosen = ball.vertices[ball.faces[part.skin_faces]]
    vertices, _, _, kinds = FieldSurface(part, GRID, "keep").mesh_with_kinds()
    samples = part.sample(GRID) < 0
    assert np.mean(samples != (part.solid(GRID) > 0)) < 1e-4
    # no surface within the skin: of all vertices inside the ball, none is nearer to the chosen faces
    at = np.array(part.origin_mm) + part.physical_edge() * vertices
    deep = at[np.linalg.norm(at - 5, axis=1) < 4.8]
    from sppm_pipeline.services.nearest import squared_to_triangle

    nearest = np.sqrt([min(squared_to_triangle(t, *p) for t in chosen) for p in deep[::40]])
    assert len(nearest) > 50
    assert nearest.min() > 1.0 - 0.02
    assert np.count_nonzero(np.abs(nearest - 1.0) < 0.01) > 5
    assert set(kinds.tolist()) == {0, 1, 2}


def test_all_triangles_are_the_whole_skin_to_half_a_voxel(wang_tiling, ball):
    some, context = filled(wang_tiling, ball, skin=Length(1.0), skin_toward=((0, 0, 1),), skin_angle=180.0)
    whole, sealed = filled(wang_tiling, ball, skin=Length(1.0))
    assert len(some.skin_faces) == len(ball.faces)
    world = some.in_mm(GRID)
    inside = inside_layers(prepare_inside(ball.vertices, ball.faces, world, "scanline"), 0, GRID.shape[2]).mask.T
    z = np.stack(np.meshgrid(*(world.axis(a) for a in range(3)), indexing="ij"), -1)
    depth = 5 - np.linalg.norm(z - 5, axis=-1)
    differ = some.solid(GRID) != whole.solid(GRID)
    assert not differ[~inside.astype(bool)].any()
    assert (np.abs(depth[differ] - 1.0) < 0.25).all()  # voxels are .25 mm wide
    assert np.array_equal(some.sample(GRID) < 0, whole.sample(GRID) < 0)
    assert context.reported["sealed_mm3"] == pytest.approx(sealed.reported["sealed_mm3"], rel=0.2)
    assert any("seals about" in text for text in context.warnings)


def test_groups_lists_and_another_mesh(run_yaml, tmp_path):
    """The sides of a box by what its file names, by numbers, and by a plate near it: one and the same skin."""
    vertices, faces = box_mesh((0.0, 0.0, 0.0), (6.0, 6.0, 6.0))
    top = vertices[faces].min(1)[:, 2] > 0
    order = np.argsort(top, kind="stable")
    plate, corners = box_mesh((0.0, 0.0, 3.2), (7.0, 7.0, 0.2))
    rows = [f"v {x} {y} {z}" for x, y, z in plate] + [f"f {a} {b} {c}" for a, b, c in corners + 1]
    (tmp_path / "plate.obj").write_text("\n".join(rows))
    lines = [f"v {x} {y} {z}" for x, y, z in vertices] + ["usemtl gray", "g walls"]
    for number, (a, b, c) in enumerate(faces[order] + 1):
        lines += (["g lid cover"] if number == len(faces) - 2 else []) + [f"f {a} {b} {c}"]
    (tmp_path / "box.obj").write_text("\n".join(lines))
    (tmp_path / "list.txt").write_text(f"{len(faces) - 2}, {len(faces) - 1}\n")
    head = """
recipes:
  cell:
    - {stage: sample.mirrored_faces, count: 6, spacing: 0.25}
    - {stage: sample.dart_throwing, count: 5, spacing: 0.25}
    - {stage: connect.mst}
    - {stage: field.gaussian, pore_radius: 0.16, tunnel_radius: 0.06}
pipeline:
  - {stage: tileset.wang_3color, recipe: cell, porosity: 0.6, colors: 1, resolution: 8, tolerance: 0.1}
  - {stage: read.mesh, id: plate, path: PLATE, unit: mm}
  - {stage: read.mesh, path: BOX, unit: mm}
  - {stage: tile.wang_3color, cell: 2 mm}
""".replace("PLATE", str(tmp_path / "plate.obj")).replace("BOX", str(tmp_path / "box.obj"))
    ways = (
        "skin_groups: [lid]", f"skin_triangles: {tmp_path / 'list.txt'}", "skin_toward: [[0, 0, 1]]",
        "skin_within: 0.2 mm, from: {domain: read.mesh, skin_near: plate}",
    )  # fmt: skip
    found = []
    for way in ways:
        record, out = run_yaml(
            f"sppm: 1\nseed: 1{head}  - {{stage: fill.implicit, skin: 0.5 mm, {way}}}\n"
            "  - {stage: slice.field, pixel: 0.25 mm}\n  - {stage: write.png, path: layers}\n"
        )
        stages = {stage["id"]: stage for stage in record["stages"]}
        assert stages["fill.implicit"]["summary"]["skin_triangles"] == 2
        found.append([path.read_bytes() for path in sorted((out / "layers").glob("*.png"))])
    assert stages["read.mesh"]["summary"]["groups"] == ["walls", "gray", "lid", "cover"]
    assert found[0]
    assert all(layers == found[0] for layers in found[1:])


def test_what_can_not_be_chosen(wang_tiling, tmp_path):
    with pytest.raises(ConfigError, match="there is none"):
        ImplicitFill(skin_toward=((0, 0, 1),)).check_options()
    with pytest.raises(ConfigError, match="direction 2"):
        ImplicitFill(skin=Length(1), skin_toward=((0, 0, 1), (0, 0, 0))).check_options()
    with pytest.raises(ConfigError, match="`skin_near`"):
        filled(wang_tiling, BOX, skin=Length(1), skin_within=Length(1))
    with pytest.raises(InputError, match="none of the 12 triangles"):
        filled(wang_tiling, BOX, skin=Length(1), skin_toward=((1, 1, 1),), skin_angle=5.0)
    named = SurfaceMesh(BOX.vertices, BOX.faces, "box", (("lid", 0, 2), ("walls", 2, 12)))
    with pytest.raises(InputError, match="no group 'Lid'") as caught:
        filled(wang_tiling, named, skin=Length(1), skin_groups=("Lid",))
    assert caught.value.hint == "it has lid, walls"
    with pytest.raises(InputError, match="no group"):
        filled(wang_tiling, BOX, skin=Length(1), skin_groups=("lid",))
    for text in ("12", "-1", "1.5", "x", "9" * 30):
        (tmp_path / "list.txt").write_text(f"0 {text}")
        with pytest.raises(InputError, match="is no triangle"):
            filled(wang_tiling, BOX, skin=Length(1), skin_triangles=tmp_path / "list.txt")
    with pytest.raises(ValueError, match="does not have"):
        Part(wang_tiling, BOX, 1.0, skin_faces=[12]).check()
    with pytest.raises(ValueError, match="do not exist"):
        SurfaceMesh(BOX.vertices, BOX.faces, "box", (("lid", 3, 13),)).check()


def test_readers_keep_the_names_of_groups():
    obj = b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3\ng a b\nusemtl m\nf 1 2 3 4\ng\nf 1 3 4\no last\nf 1 2 4"
    assert decode_mesh_file(obj, "x.obj").groups == (("a", 1, 3), ("b", 1, 3), ("m", 1, 5), ("last", 4, 5))
    facet = "facet normal 0 0 1 outer loop vertex {0} 0 0 vertex 1 {0} 0 vertex 0 1 1 endloop endfacet\n"
    text = (
        f"solid upper half\n{facet.format(0)}{facet.format(2)}endsolid upper half\nsolid\n{facet.format(3)}endsolid\n"
    )
    text += f"solid low\n{facet.format(4)}endsolid"
    assert decode_mesh_file(text.encode(), "x.stl").groups == (("upper half", 0, 2), ("low", 3, 4))
    from sppm_pipeline.features.files.formats import three_mf

    vertices, faces = ball_mesh((0.0, 0.0, 0.0), 1.0, 1)
    data = b"".join(three_mf.encode(vertices, faces))
    assert decode_mesh_file(data, "x.3mf").groups == (("mesh", 0, 80),)
