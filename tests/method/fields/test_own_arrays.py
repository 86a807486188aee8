"""Nobody writes into what a field hands out: it may be an array that the field keeps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from sppm_pipeline.features.surface.field_surface import FieldSurface
from sppm_pipeline.method.fields.level_field import LevelField
from sppm_pipeline.method.fields.scalar_field import CleanedField, CutField, ScalarField
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.services.grid import Grid

N = 12


@dataclass(frozen=True, eq=False)
class Kept(ScalarField):
    """A ball and an islet, sampled once for all."""

    edge_mm: float | None = 4.0
    cells: tuple = (1, 1, 1)
    periodic: bool = False

    def sample_layers(self, grid: Grid, start: int, stop: int, threads: int = 1):
        return KEPT[: grid.shape[0], : grid.shape[1], start:stop]


place = np.stack(np.meshgrid(*[np.arange(3 * N)] * 3, indexing="ij"))
KEPT = np.asfortranarray(np.minimum(np.hypot.reduce(place - 4.0) - 3, np.hypot.reduce(place - 9.5) - 1.2), np.float32)


@pytest.fixture
def kept():
    before = KEPT.copy()
    KEPT.flags.writeable = False
    yield Kept()
    KEPT.flags.writeable = True
    assert np.array_equal(KEPT, before)


def test_surfaces(kept):
    surface = FieldSurface(kept, Grid((0.0,) * 3, (1 / N,) * 3, (N + 1,) * 3))
    first, second = surface.mesh(), surface.mesh()
    assert first[2]["removed_share"] == second[2]["removed_share"] > 0
    assert np.array_equal(first[0], second[0])


def test_wrapped_fields(kept):
    cut = CutField(kept, 0.5)
    assert np.array_equal(cut.sample(N), cut.sample(N))
    cleaned = CleanedField(kept, np.ones((N,) * 3, np.uint8), N)
    assert (cleaned.sample(N) >= 0).all()


def test_levels(kept):
    field = LevelField(kept, np.full((1, 1, 1), 0.1))
    assert np.array_equal(field.sample(N), field.sample(N))


def test_parts_with_fills_and_drains(kept, ball):
    part = Part(kept, ball, drains=((0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.3),), fills=np.array([[1.0, 0, 0, 1, 0, 1, 0.3]]))
    assert np.array_equal(part.sample(N), part.sample(N))
