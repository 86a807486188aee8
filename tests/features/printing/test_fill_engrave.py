"""Engraved text: letters that differ, grooves of the width and depth asked for, on flat and curved faces."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from sppm_pipeline import SliceStack
from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.printing.numerics.lettering import GLYPHS, strokes
from sppm_pipeline.features.printing.stages.fill_engrave import Engrave
from sppm_pipeline.features.printing.stages.slice_plate import SlicePlate
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.method.part.primitive_meshes import ball_mesh, box_mesh
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.testing.plain_context import PlainContext


def engraved(part, **options):
    middle = tuple(Length(number) for number in options.pop("at", (8, 6, 9)))
    names = {"letter_height": "height", "stroke": "stroke", "groove_depth": "depth"}
    sizes = {name: Length(options.pop(key)) for name, key in names.items() if key in options}
    stage = Engrave(middle=middle, **sizes, **options)
    stage.check_options()
    context = PlainContext()
    return stage.run(context, part), context


def box(tiling, skin=1.0):
    """A box of 9 x 7 x 6 mm, whose upper side is at z = 9 mm."""
    return Part(tiling, SurfaceMesh(*box_mesh((8.0, 6.0, 6.0), (9.0, 7.0, 6.0)), name="box"), skin)


def test_letters_differ():
    def drawn(letter):
        ends = strokes(letter)
        points = ends[:, :1] + (ends[:, 1:] - ends[:, :1]) * np.linspace(0, 1, 25)[:, None]
        y, x = np.mgrid[-3:3.1:0.5, -2:2.1:0.5]
        places = np.column_stack([x.ravel(), y.ravel()])
        return (np.linalg.norm(places[:, None] - points.reshape(-1, 2), axis=2) < 0.4).any(1)

    letters = {letter: drawn(letter) for letter in GLYPHS if letter != " "}
    assert len(letters) == 42
    for (a, one), (b, two) in itertools.combinations(letters.items(), 2):
        assert (one != two).sum() >= 2, (a, b)


def test_a_groove_has_the_width_and_depth_asked_for(wang_tiling):
    made, context = engraved(box(wang_tiling), text="-", height=6, stroke=0.8, depth=0.3)
    assert not context.warnings
    edge, pixel = made.physical_edge(), 0.02
    radius = (0.8**2 / 4 + 0.3**2) / 0.6
    for below in (0.01, 0.15, 0.25, 0.35):
        low = (np.array([5, 4, 9 - below]) + pixel / 2 * np.array([1, 1, 0]) - made.origin_mm) / edge
        grid = Grid(tuple(low.tolist()), (pixel / edge,) * 3, (300, 200, 1))
        removed = 1 - made.solid_zyx(grid, 0, 1)[0]
        half = math.sqrt(max(0.0, radius**2 - (radius - 0.3 + below) ** 2))
        assert removed.sum() * pixel**2 == pytest.approx(2 * 2 * half + math.pi * half**2, rel=0.01)
        if half:
            y, x = np.nonzero(removed)
            assert (x.mean() * pixel + 5.01, y.mean() * pixel + 4.01) == pytest.approx((8, 6), abs=0.02)


def test_text_follows_a_curved_face(wang_tiling):
    ball = Part(wang_tiling, SurfaceMesh(*ball_mesh((8.0, 6.0, 6.0), 4.5, 4), name="ball"), 1.0)
    made, context = engraved(ball, text="n7", at=(8, 1, 6), facing=(0, -1, 0), upward=(0, 0, 1), height=3, depth=0.15)
    drains = np.array(made.drains)
    ends = drains[:, [[0, 1, 2], [3, 4, 5]]].reshape(-1, 3) - [8, 6, 6]
    assert np.abs(np.linalg.norm(ends, axis=1) - np.repeat(drains[:, 6], 2) - (4.5 - 0.15)).max() < 0.03
    # read from the front, x runs to the right and z up: the 7 is right of the N, and its foot left of its head
    assert context.reported["strokes"] == len(drains)
    assert (ends[:, 1] < 0).all()
    seven = ends[ends[:, 0] > 0.2]
    assert seven[seven[:, 2].argmin(), 0] < seven[:, 0].max() - 0.5


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"text": "é"}, "has 'É'"),
        ({"text": " "}, "is not that"),
        ({"text": "1" * 41}, "is not that"),
        ({"text": "1", "stroke": 2.0}, "run together"),
        ({"text": "1", "stroke": 0.4, "depth": 0.3}, "deeper than half"),
        ({"text": "1", "upward": (0, 0, 2)}, "are two directions"),
        ({"text": "1", "facing": (0, 0, 0)}, "are two directions"),
    ],
)
def test_options_that_do_not_fit(options, words, wang_tiling):
    with pytest.raises(ConfigError, match=words):
        engraved(box(wang_tiling), **options)


def test_text_beyond_the_surface_is_refused(wang_tiling):
    with pytest.raises(DesignError, match="meet no surface that faces"):
        engraved(box(wang_tiling), text="12345", height=5)
    with pytest.raises(DesignError, match="100% of it meet no surface"):
        engraved(box(wang_tiling), text="1", at=(8, 6, 30))


def test_grooves_without_a_skin_are_warned_about(wang_tiling):
    _, context = engraved(box(wang_tiling, skin=0.1), text="1", height=4)
    assert "no skin of that thickness everywhere" in context.warnings[0]


def test_a_plate_holds_twenty_parts_that_differ():
    stacks = [SliceStack.from_array(np.ones((k, 3, k), bool), pixel_mm=0.1, layer_mm=0.1) for k in range(1, 21)]
    plate = SlicePlate(separation=Length(0.1)).run(PlainContext(), tuple(stacks))
    layers = np.concatenate([slab for _, slab in plate.slabs(1)])
    # part k has 3 k pixels in its k layers
    assert [int(np.count_nonzero(layer)) for layer in layers] == [
        sum(3 * k for k in range(z, 21)) for z in range(1, 21)
    ]


def test_a_skin_on_the_face_with_the_text_is_enough(wang_tiling):
    part = box(wang_tiling)
    top = np.flatnonzero((part.domain.vertices[part.domain.faces][:, :, 2] > 8.9).all(1)).astype(np.int32)
    _, context = engraved(replace(part, skin_faces=top), text="1", height=4)
    assert not context.warnings
    _, context = engraved(
        replace(part, skin_faces=np.setdiff1d(np.arange(12, dtype=np.int32), top)), text="1", height=4
    )
    assert len(context.warnings) == 1
