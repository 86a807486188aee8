"""The rule keeps the contract of tile rules, and its own promises."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from my_plugin.checkerboard import Checkerboard

import sppm_pipeline as sppm
from sppm_pipeline.testing.contracts import TilerContract
from sppm_pipeline.testing.plain_context import PlainContext


@cache
def tileset(interiors=5):
    """A small set: what it looks like is no matter to a rule."""
    recipe = [
        sppm.step.sample.mirrored_faces(count=4, spacing=0.2),
        sppm.step.sample.dart_throwing(count=4, spacing=0.2),
        sppm.step.connect.mst(),
        sppm.step.field.gaussian(pore_radius=0.15, tunnel_radius=0.06),
    ]
    return sppm.tileset.free_faces(recipe=recipe, colors=2, interiors=interiors, resolution=8, seed=1)


class TestCheckerboard(TilerContract):
    def stages(self):
        return [Checkerboard(cells=(3, 4, 5)), Checkerboard(cells=(2, 4, 2), periodic=True)]

    def tileset(self):
        return tileset()


def test_neighbors_across_faces_differ():
    interior = Checkerboard(cells=(5, 4, 6)).run(PlainContext(3), tileset(), None).arrays.interior
    for axis in range(3):
        assert (np.diff(interior, axis=axis) != 0).all()
    assert set(interior.flat) == set(range(5))


def test_one_interior_is_not_enough():
    with pytest.raises(sppm.DesignError, match="two interiors"):
        Checkerboard(cells=(2, 2, 2)).run(PlainContext(), tileset(interiors=1), None)
