"""``field.blend``: the share of solid is kept, the ends are the fields themselves, and there is no seam."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from sppm_pipeline.errors import ConfigError
from sppm_pipeline.features.grading.laws import FormulaLaw
from sppm_pipeline.features.grading.stages.field_blend import BlendFields, score_table, scores_of
from sppm_pipeline.method.fields.formula import FormulaField
from sppm_pipeline.method.nouns.maps import Grading
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.testing.plain_context import PlainContext


@dataclass(frozen=True, eq=False, kw_only=True)
class Waves(FormulaField):
    """Twenty waves of random phases through a cell, bent so that values are far from normal; solid by a share."""

    seed: int
    power: float
    level: float = 0.0

    def evaluate(self, x, y, z):
        rng = np.random.default_rng(self.seed)
        total = 0.0
        for _ in range(20):
            k, phase = rng.integers(-3, 4, 3), rng.uniform(0, 2 * np.pi)
            total = total + np.cos(2 * np.pi * (k[0] * x + k[1] * y + k[2] * z) + phase)
        return np.exp(self.power * total / 3) - self.level


def waves(seed, power, porosity, **place):
    cell = Waves(seed=seed, power=power)  # which repeats
    return Waves(seed=seed, power=power, level=float(np.quantile(cell.sample(32), 1 - porosity)), **place)


def maps(**formulas):
    laws = [FormulaLaw(name, "", text, (), (), None, None) for name, text in formulas.items()]
    return Grading(tuple(laws))


def blend(first, second, **formulas):
    return BlendFields(probes=100_000).run(PlainContext(), first, second, maps(**formulas))


PLACE = {"edge": 4.0, "region": (3, 1, 1), "origin": (-2.0, 1.0, 5.0)}
OTHER = {"edge": 3.0, "origin": (0.5, 0.0, 0.0)}


@pytest.mark.parametrize("porosity", [0.3, 0.7])
def test_the_share_of_void_is_kept(porosity):
    """Means over pairs of fields: a linear mixture of the same scores is off by four points and more."""
    errors, linear = [], []
    for seed in range(4):
        first, second = (waves(2 * seed + k, power, porosity, edge=1.0) for k, power in ((0, 1.0), (1, -0.5)))
        made = blend(first, second, weight="0.5")
        errors.append((made.sample(28) >= 0).mean() - porosity)
        scores = [scores_of(table, field.sample(28)) for table, field in zip(made.tables, (first, second), strict=True)]
        cut = np.quantile(scores[0], 1 - porosity)
        linear.append((sum(scores) / 2 >= cut).mean() - porosity)
    assert abs(np.mean(errors)) < 0.015, errors
    assert abs(np.mean(linear)) > 0.04, linear


def test_each_end_is_the_field_itself():
    first, second = waves(1, 1.0, 0.6, **PLACE), waves(2, -0.7, 0.35, **OTHER)
    made = blend(first, second, weight="smoothstep(2, 6, x)")
    assert made.cells == (3, 1, 1)
    assert (made.edge_mm, made.origin_mm) == (4.0, (-2.0, 1.0, 5.0))
    np.testing.assert_allclose(made.porosities, (0.6, 0.35), atol=0.01)
    h = 1 / 20
    grid = Grid((h / 2, h / 2, h / 2), (h,) * 3, (60, 20, 20))
    world = [grid.axis(axis) * 4 + low for axis, low in enumerate((-2.0, 1.0, 5.0))]
    there = Grid(tuple((w[0] - o) / 3 for w, o in zip(world, (0.5, 0, 0), strict=True)), (h * 4 / 3,) * 3, grid.shape)
    solid = made.solid(grid)
    left, right = world[0] < 2 - 0.5, world[0] > 6 + 0.5  # weights are linear over an eighth of a cell
    for side, field, own in ((left, first, grid), (right, second, there)):
        assert side.sum() > 10
        assert (solid[side] != field.solid(own)[side]).mean() < 1e-4
    middle = ~left & ~right
    assert (solid[middle] != first.solid(grid)[middle]).mean() > 0.02
    assert (solid[middle] != second.solid(there)[middle]).mean() > 0.02


def test_there_is_no_seam_and_no_slab():
    made = blend(waves(1, 1.0, 0.6, **PLACE), waves(2, -0.7, 0.35, **OTHER), weight="smoothstep(0, 8, x)")
    n = 16
    grid = Grid((0.03, 0.01, 0.02), (1 / n,) * 3, (3 * n, n, n))
    whole = made.sample(grid)
    parts = [made.sample_layers(grid, k, min(k + 5, n), threads=2) for k in range(0, n, 5)]
    np.testing.assert_array_equal(np.concatenate(parts, axis=2), whole)
    for plane in (1.0, 1 + 1 / 8, 2.0):  # of the lattice, and of the nodes of the maps
        e = 1e-7
        pair = made.sample(Grid((plane - e, 0.1, 0.1), (2 * e, 0.2, 0.2), (2, 4, 4)))
        assert np.abs(pair[0] - pair[1]).max() < 1e-4


def test_a_map_of_the_porosity_is_followed():
    first, second = waves(1, 1.0, 0.6, **PLACE), waves(2, -0.7, 0.35, **OTHER)
    made = blend(first, second, weight="0*x", porosity="0.2 + 0.05*(x + 2)")
    void = made.sample(24).reshape(3, 24, 24, 24) >= 0
    np.testing.assert_allclose(void.mean(axis=(1, 2, 3)), [0.3, 0.5, 0.7], atol=0.06)  # single cells of waves


def test_scores_are_those_of_a_normal_variable():
    rng = np.random.default_rng(0)
    values = np.exp(rng.normal(size=200_000)).astype(np.float32) - np.float32(0.7)
    table = score_table(values)
    common = np.abs(np.log(values + 0.7)) < 2
    np.testing.assert_allclose(scores_of(table, values)[common], np.log(values + 0.7)[common], atol=0.02)
    assert (np.sign(scores_of(table, values) - table.scores[table.values == 0]) == np.sign(values)).all()
    flat = np.where(rng.random(10_000) < 0.4, -1, values[:10_000]).astype(np.float32)
    scores = scores_of(score_table(flat), np.array([-3, -1, 0, 9, 50], np.float32))
    assert (np.diff(scores) > 0).all()


def test_what_cannot_be_blended():
    first, second = waves(1, 1.0, 0.6, **PLACE), waves(2, -0.7, 0.35, **OTHER)
    for pair, formulas, words in (
        ((first, second), {"porosity": "0.5"}, "no map `weight`"),
        ((first, waves(2, 1.0, 0.5)), {"weight": "0.5"}, "second field have no size"),
        ((first, waves(2, 1.0, 0.5, **{**PLACE, "origin": (0.0, 1.0, 5.0)})), {"weight": "0.5"}, "does not cover"),
        ((Waves(seed=1, power=1.0, **PLACE), second), {"weight": "0.5"}, "first field is all void"),
    ):
        with pytest.raises(ConfigError, match=words):
            blend(*pair, **formulas)
