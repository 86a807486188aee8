"""Exactly n pores, whatever there is."""

import numpy as np
import pytest

from sppm_pipeline.method.stages.sample_elimination import Elimination
from sppm_pipeline.method.stages.sample_mirrored_faces import MirroredFaces
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.nouns.palette import Palette
from sppm_pipeline.testing.plain_context import PlainContext


@pytest.mark.parametrize("count", [1, 2, 50])
def test_the_number_is_met_in_every_interior(count):
    pores = Elimination(count=count).run(PlainContext(1, palette=Palette(3)), None)
    pores.check()
    assert [len(pores.of_piece(t)) for t in range(3)] == [count] * 3
    assert pores.spacing is None


def test_it_is_far_better_spaced_than_chance():
    pores = Elimination(count=60).run(PlainContext(1), None).centers
    chance = np.random.default_rng(1).random((60, 3))

    def least(points):
        d = points[:, None] - points[None]
        d = np.linalg.norm(d - np.round(d), axis=2)
        return d[np.triu_indices(60, 1)].min()

    assert least(pores) > 2 * least(chance)


def test_the_gap_keeps_it_from_the_faces_and_no_spacing_is_claimed():
    context = PlainContext(1)
    faces = MirroredFaces(count=9, spacing=Length(0.2)).run(context, None)
    pores = Elimination(count=30, gap=Length(0.1)).run(context, faces)
    inside = pores.of_piece(0)
    assert 0.1 <= inside.min() <= inside.max() <= 0.9
    assert pores.spacing is None
    assert Elimination(count=5).run(context, faces).of_piece(0).min() >= 0.2
