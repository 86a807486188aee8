"""Hyperuniform pores in cells, between face pores and in tile sets."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.spatial import cKDTree

from sppm_pipeline.errors import ConfigError
from sppm_pipeline.method.nouns.pores import PoreSet
from sppm_pipeline.method.sampling.capacity import box_capacity, min_spacing
from sppm_pipeline.method.sampling.stealthy import stealthy_waves
from sppm_pipeline.method.sampling.structure_factor import structure_factor
from sppm_pipeline.method.stages.sample_hyperuniform import BETWEEN_FACES, PERIODIC, Hyperuniform
from sppm_pipeline.method.stages.sample_mirrored_faces import MirroredFaces
from sppm_pipeline.method.stages.tileset_wang_3color import WangTileSet
from sppm_pipeline.nouns.length import Cell, Length
from sppm_pipeline.nouns.palette import Blocks, Palette
from sppm_pipeline.stage import Stage
from sppm_pipeline.testing.contracts import SamplerContract
from sppm_pipeline.testing.plain_context import PlainContext


class TestHyperuniform(SamplerContract):
    def stages(self) -> Sequence[Stage]:
        return [Hyperuniform(count=30), Hyperuniform(count=40, stealth=0.1)]


def test_a_periodic_cell_is_silent_and_says_so() -> None:
    context = PlainContext(2, palette=Palette(interiors=2))
    pores = Hyperuniform(total=60, stealth=0.5, spacing=Length(0.2)).run(context, None)
    waves = stealthy_waves(60, 0.5)
    found = [structure_factor(pores.of_piece(t), waves).max() for t in range(2)]
    assert max(found) <= 1e-10
    assert context.reported["largest_structure_factor"] == pytest.approx(max(found), abs=1e-15)
    assert context.reported["waves"] == 2 * waves.number
    assert context.reported["shortest_wave"] == pytest.approx(1 / waves.radius)
    closest = min(min_spacing(pores.of_piece(t)) for t in range(2))
    assert context.reported["smallest_distance"] == closest >= 0.2 == pores.spacing


def test_without_a_spacing_that_of_half_packing_is_kept() -> None:
    context = PlainContext(1)
    pores = Hyperuniform(count=40).run(context, None)
    assert pores.spacing is not None
    assert context.reported["smallest_distance"] >= pores.spacing
    assert box_capacity((1, 1, 1), pores.spacing, periodic=True) == pytest.approx(80, rel=1e-6)


@pytest.mark.parametrize("periodic", [True, False])
def test_scattered_pores_are_evened_out_across_blocks_and_keep_the_spacing(periodic: bool) -> None:
    blocks = Blocks(np.ones((4, 3, 3), np.bool_), periodic)
    context = PlainContext(1, palette=Palette(36, (0, 0, 0), blocks=blocks))
    faces = MirroredFaces(total=40, share=0.5).run(context, None)
    pores = Hyperuniform(total=40).run(context, faces)
    pores.check()
    assert len(pores.centers) == 36 * 40
    assert np.ptp(np.bincount(pores.piece)) > 0  # blocks exchange pores, but only a few
    assert np.bincount(pores.piece).std() < 0.5 * np.sqrt(40)
    period = [4, 3, 3] if periodic else None
    distances, _ = cKDTree(points := pores.centers + blocks.sites[pores.piece], boxsize=period).query(points, k=2)
    assert distances[:, 1].min() >= pores.spacing
    if periodic:
        assert 0 < context.reported["mean_structure_factor"] < 0.1


def test_scattered_pores_thrown_before_stay() -> None:
    blocks = Blocks(np.ones((3, 2, 2), np.bool_), True)
    context = PlainContext(1, palette=Palette(12, (0, 0, 0), blocks=blocks))
    first = MirroredFaces(count=6, spacing=Length(0.2)).run(context, None)
    pores = Hyperuniform(count=30).run(context, first)
    assert len(pores.centers) == 12 * 36
    for t in range(12):
        own = pores.of_piece(t)
        assert all((np.abs(own - center).max(1) < 1e-12).any() for center in first.of_piece(t))


def test_blocks_whose_density_follows_a_map_are_silenced_one_by_one() -> None:
    blocks = Blocks(np.ones((2, 2, 2), np.bool_), False, density=np.ones((9, 9, 9)))
    context = PlainContext(1, palette=Palette(8, (0, 0, 0), blocks=blocks))
    pores = Hyperuniform(total=40).run(context, None)
    waves = stealthy_waves(40, PERIODIC)
    for t in range(8):
        assert structure_factor(pores.of_piece(t), waves).max() <= 1e-10
    assert context.reported["largest_structure_factor"] <= 1e-10


def test_mirrored_faces_stay_and_the_whole_cell_is_silent() -> None:
    context = PlainContext(1)
    faces = MirroredFaces(total=95, share=0.5).run(context, None)
    pores = Hyperuniform(total=95).run(context, faces)
    assert len(pores.centers) == 95
    np.testing.assert_array_equal(pores.centers[: len(faces.centers)], faces.centers)
    waves = stealthy_waves(95 - len(faces.centers), BETWEEN_FACES)
    assert structure_factor(pores.centers, waves).max() <= 1e-10
    # the interior alone is not: it makes up for what the faces lack
    assert structure_factor(pores.of_piece(0), waves).max() > 1e-3
    assert min_spacing(pores.centers) >= faces.spacing == pores.spacing
    assert pores.of_piece(0).min() >= faces.spacing / 2


def test_every_tile_of_the_27_is_silent_with_its_own_faces() -> None:
    palette = WangTileSet().palette()
    context = PlainContext(4, palette=palette)
    faces = MirroredFaces(total=72, share=0.5).run(context, None)
    pores = Hyperuniform(total=72, stealth=0.1).run(context, faces)
    assert palette.meetings is not None
    for t in range(pores.interiors):
        met = {(axis, color) for _, axis, _, color in palette.meetings[palette.meetings[:, 0] == t]}
        assert len(met) == 3
        cell = [pores.of_piece(t), *(pores.of_piece(pores.face_piece(*face)) for face in sorted(met))]
        waves = stealthy_waves(len(cell[0]), 0.1)
        assert structure_factor(np.concatenate(cell), waves).max() <= 1e-10


def test_with_a_choice_of_faces_their_mean_is_silent() -> None:
    context = PlainContext(3, palette=Palette(interiors=2, colors=(2, 2, 2)))
    faces = MirroredFaces(total=70, share=0.4).run(context, None)
    pores = Hyperuniform(total=70, stealth=0.15).run(context, faces)
    on_faces = pores.centers[pores.piece >= 2]
    for t in range(2):
        inside = pores.of_piece(t)
        points = np.concatenate([inside, on_faces])
        weight = np.concatenate([np.ones(len(inside)), np.full(len(on_faces), 0.5)])
        assert structure_factor(points, stealthy_waves(len(inside), 0.15), weight).max() <= 1e-10
    assert context.reported["largest_structure_factor"] <= 1e-10


def test_pores_thrown_before_count_too() -> None:
    first = np.random.default_rng(0).random((10, 3))
    before = PoreSet(cell=Cell(), centers=first, piece=np.zeros(10, np.int32))
    pores = Hyperuniform(count=50, stealth=0.3).run(PlainContext(1), before)
    np.testing.assert_array_equal(pores.centers[:10], first)
    assert structure_factor(pores.centers, stealthy_waves(50, 0.3)).max() <= 1e-10


def test_the_number_of_pores_is_given_once() -> None:
    for options in ({}, {"count": 50, "total": 50}):
        with pytest.raises(ConfigError, match="number of pores"):
            Hyperuniform(**options).check_options()
    assert 0 < BETWEEN_FACES < PERIODIC <= 0.5
