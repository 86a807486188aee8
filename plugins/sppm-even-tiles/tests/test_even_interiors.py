"""The stage: the contract of stages, its report, and the kinds of tile set it serves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
import pytest
from sppm_even_tiles.even_interiors import EvenInteriors

from sppm_pipeline.errors import ConfigError
from sppm_pipeline.method.fields.tileset import TileSet
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.stages.connect_mst import MinimumSpanningTree
from sppm_pipeline.method.stages.field_gaussian import GaussianField
from sppm_pipeline.method.stages.read_primitive import ReadPrimitive
from sppm_pipeline.method.stages.sample_dart_throwing import DartThrowing
from sppm_pipeline.method.stages.sample_mirrored_faces import MirroredFaces
from sppm_pipeline.method.stages.tileset_corner_colors import CornerColorsTileSet
from sppm_pipeline.method.stages.tileset_free_faces import FreeFacesTileSet
from sppm_pipeline.method.stages.tileset_wang_3color import WangTileSet
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.stage import Stage
from sppm_pipeline.testing.contracts import StageContract
from sppm_pipeline.testing.plain_context import PlainContext, recipe_of


@cache
def drawn(maker: Stage) -> TileSet:
    """A small set."""
    recipe = recipe_of(
        MirroredFaces(count=6, spacing=Length(0.25)),
        DartThrowing(count=4, spacing=Length(0.25)),
        MinimumSpanningTree(),
        GaussianField(pore_radius=Length(0.15), tunnel_radius=Length(0.06)),
    )
    made = maker.run(PlainContext(1), recipe)
    assert isinstance(made, TileSet)
    return made


FREE = FreeFacesTileSet(colors=2, interiors=27, resolution=8)


class TestEvenInteriors(StageContract):
    def stages(self) -> Sequence[Stage]:
        return [EvenInteriors(cells=(3, 4, 5)), EvenInteriors(cells=(1, 1, 1), cell=Length(5.0, "mm"))]

    def inputs(self) -> Mapping[str, Any]:
        return {"tileset": drawn(FREE)}


class TestWithCornerColors(TestEvenInteriors):
    def inputs(self) -> Mapping[str, Any]:
        return {"tileset": drawn(CornerColorsTileSet(colors=1, interiors=20, resolution=8))}


def test_a_part_is_covered_and_the_promise_is_counted() -> None:
    cover = ReadPrimitive(shape="torus_knot", size=(Length(40.0, "mm"), Length(40.0, "mm"), Length(20.0, "mm"))).run(
        PlainContext()
    )
    assert isinstance(cover, SurfaceMesh)
    context = PlainContext(2)
    tiling = EvenInteriors(cell=Length(5.0, "mm")).run(context, drawn(FREE), cover)
    interior = tiling.arrays.interior
    count = np.bincount(interior[interior >= 0], minlength=27)
    assert (interior < 0).any()
    assert context.reported["min_uses"] == count.min()
    assert context.reported["max_uses"] == count.max() <= count.min() + 1
    assert [context.reported[f"alike_across_{what}"] for what in ("faces", "edges", "corners")] == [0, 0, 0]
    assert not context.warnings


def test_too_few_interiors_are_told() -> None:
    context = PlainContext(2)
    EvenInteriors(cells=(4, 4, 4)).run(context, drawn(FreeFacesTileSet(colors=2, interiors=6, resolution=8)), None)
    assert context.reported["alike_across_faces"] == 0
    assert context.reported["alike_across_corners"] > 0
    assert "27 suffice" in context.warnings[0]


def test_the_papers_tiles_can_not_be_dealt_as_their_faces_bind_them() -> None:
    with pytest.raises(ConfigError, match=r"free or corner.*'wang'"):
        EvenInteriors(cells=(4, 4, 4)).run(PlainContext(), drawn(WangTileSet(colors=2, resolution=8)), None)
