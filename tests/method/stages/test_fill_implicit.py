"""What becomes of parts that are whole, inside out, open or hopeless."""

import numpy as np
import pytest
from scipy import ndimage

from sppm_pipeline.errors import ConfigError, InputError
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.part.primitive_meshes import ball_mesh
from sppm_pipeline.method.stages.fill_implicit import ImplicitFill
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.grid import cell_centers
from sppm_pipeline.testing.plain_context import PlainContext

GRID = cell_centers(12, (4, 3, 3))


def filled(field, mesh, **options):
    context = PlainContext()
    return ImplicitFill(**options).run(context, field, mesh), context


def test_a_closed_part_is_taken_as_it_is(wang_tiling, ball):
    part, context = filled(wang_tiling, ball)
    assert part.domain is ball
    assert context.reported == {"inside": "scanline", "closed": True, "turned_triangles": 0}
    assert not context.warnings
    assert part.summary()["inside"] == "scanline"


def test_shells_that_are_inside_out_are_turned_but_hollows_are_not(wang_tiling, ball):
    v, f = ball_mesh((5.0, 5.0, 5.0), 2.0, 2)
    hollow = SurfaceMesh(
        np.concatenate([ball.vertices, v]), np.concatenate([ball.faces, f[:, ::-1] + len(ball.vertices)])
    )
    expected, context = filled(wang_tiling, hollow)
    assert not context.warnings
    assert expected.domain is hollow
    turned, context = filled(wang_tiling, SurfaceMesh(hollow.vertices, hollow.faces[:, ::-1]))
    assert "turned" in context.warnings[0]
    assert np.array_equal(turned.solid(GRID), expected.solid(GRID))


@pytest.mark.parametrize("inside", ["auto", "winding", "vote"])
@pytest.mark.parametrize("skin", [None, Length(0.7)])
def test_an_open_part_wound_at_random_is_filled_with_a_warning(wang_tiling, ball, inside, skin):
    whole, _ = filled(wang_tiling, ball, skin=skin)
    faces = ball.faces[3:]
    faces = np.where(np.random.default_rng(0).random(len(faces))[:, None] < 0.4, faces[:, ::-1], faces)
    part, context = filled(wang_tiling, SurfaceMesh(ball.vertices, faces, name="scan.ply"), inside=inside, skin=skin)
    assert part.method == ("vote" if inside == "vote" else "winding")
    assert context.reported["closed"] is False
    assert 0 < context.reported["undecided_share"] < 0.05
    assert context.reported["disagreement"] < 0.02
    assert "scan.ply is not closed" in context.warnings[-2 if skin else -1]
    solid = part.solid(GRID)
    assert np.mean(solid != whole.solid(GRID)) < 0.005
    assert np.mean((part.sample(GRID) < 0) != solid) < (0.03 if skin else 1e-9)


def test_a_hopeless_part_is_refused(wang_tiling):
    rng = np.random.default_rng(0)
    soup = SurfaceMesh(3 + 6 * rng.random((120, 3)), np.arange(120).reshape(40, 3), name="soup.stl")
    with pytest.raises(InputError, match=r"soup.stl is not closed.*inside from outside") as caught:
        filled(wang_tiling, soup)
    assert "repair" in caught.value.hint
    with pytest.raises(InputError, match="no triangles"):
        filled(wang_tiling, SurfaceMesh(np.zeros((0, 3)), np.zeros((0, 3), int)))


def test_a_part_of_less_than_two_cells_is_filled_with_a_warning(wang_tiling, ball):
    edge = wang_tiling.physical_edge()
    extent = (ball.upper - ball.lower).max()
    for cells, warned in ((1.9, True), (2.1, False)):
        factor = cells * edge / extent
        _, context = filled(wang_tiling, SurfaceMesh(ball.vertices * factor, ball.faces))
        assert bool(context.warnings) is warned
    _, context = filled(wang_tiling, SurfaceMesh(ball.vertices * edge / extent, ball.faces))
    assert f"less than 2 cells of {edge:g} mm" in context.warnings[0]
    assert f"{25.4 * edge:.4g}" in context.warnings[0]


def test_a_skin_says_how_much_void_it_seals(wang_tiling, ball):
    part, context = filled(wang_tiling, ball, skin=Length(0.7))
    n = 24
    grid = cell_centers(n, (4, 3, 3))
    closed = part.solid(grid) == 0
    labels, _ = ndimage.label(closed)
    sealed = np.count_nonzero(closed & (labels != labels[0, 0, 0])) * (part.physical_edge() / n) ** 3
    assert sealed > 10
    assert context.reported["sealed_mm3"] == pytest.approx(sealed, rel=0.05)
    assert f"seals about {context.reported['sealed_mm3']:.3g} mm3" in context.warnings[-1]
    # a skin thinner than the voxels of the coarse grid stays closed
    _, thin = filled(wang_tiling, ball, skin=Length(0.02))
    assert thin.reported["sealed_mm3"] > context.reported["sealed_mm3"]
    assert "sealed_mm3" not in filled(wang_tiling, ball)[1].reported


def test_a_drain_opens_the_skin(wang_tiling, ball):
    """From the middle of the ball down and out: what was sealed is open, and nothing else has changed."""
    sealed, context = filled(wang_tiling, ball, skin=Length(0.7))
    low = float(ball.lower[2])
    x, y, z = ((ball.lower + ball.upper) / 2).tolist()
    drain = (x, y, z, x, y, low - 1, 0.6)
    part, opened = filled(wang_tiling, ball, skin=Length(0.7), drains=(drain,))
    assert opened.reported["sealed_mm3"] < 0.05 * context.reported["sealed_mm3"]
    assert not any("seals" in text for text in opened.warnings), opened.reported
    grid = cell_centers(24, (4, 3, 3))
    world = part.in_mm(grid)
    dx, dy, dz = np.meshgrid(*(world.axis(a) - c for a, c in enumerate((x, y, z))), indexing="ij")
    below = np.clip(-dz, 0, z - low + 1)
    inside = dx**2 + dy**2 + (dz + below) ** 2 < 0.36
    solid = part.solid(grid)
    assert np.array_equal(solid, np.where(inside, 0, sealed.solid(grid)))
    # in layers, and by the sampled field
    assert np.array_equal(part.solid_layers(grid, 20, 31), solid[:, :, 20:31])
    assert np.mean((part.sample(grid) < 0) != solid) < 0.02
    assert not (part.sample(grid)[inside] < 0).any()
    part.check()
    with pytest.raises(ConfigError, match="drain 1"):
        ImplicitFill(drains=((0, 0, 0, 1, 1, 1, 0.0),)).check_options()


def test_a_border_is_what_the_options_say(wang_tiling, ball):
    assert filled(wang_tiling, ball)[0].border is None
    assert filled(wang_tiling, ball, border="round")[0].border.thinnest_mm == 0.3
    assert filled(wang_tiling, ball, border="round", thinnest=Length(500, "um"))[0].border.thinnest_mm == 0.5
    assert filled(wang_tiling, ball, border="round", skin=Length(0.6))[0].skin_mm == 0.6


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"thinnest": Length(0.3)}, "there is none"),
        ({"border": "round", "skin": Length(0.5)}, "0.6 mm, or more"),
        ({"border": "round", "thinnest": Length(0.4), "skin": Length(0.7)}, "0.8 mm, or more"),
    ],
)
def test_a_border_needs_options_that_fit(options, says):
    with pytest.raises(ConfigError, match=says):
        ImplicitFill(**options).check_options()
