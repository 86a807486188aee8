"""Twins of scans: parameters of structures of our own are found again, and what is not matched is said."""

import functools

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from sppm_pipeline.errors import ConfigError
from sppm_pipeline.features.scans.image_field import ImageField
from sppm_pipeline.features.scans.stages.tune_match import KINDS, Look, TuneMatch, differences, distance
from sppm_pipeline.method.stages.connect_mbdst import BoundedDegreeSubgraph
from sppm_pipeline.method.stages.field_gaussian import GaussianField
from sppm_pipeline.method.stages.sample_dart_throwing import DartThrowing
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.testing.plain_context import PlainContext, recipe_of
from tests.features.scans.test_statistics import spheres

TOTAL, N = 80, 40


def recipe(total=TOTAL, edge=None):
    return recipe_of(
        DartThrowing(total=total, edge=edge),
        BoundedDegreeSubgraph(degree=(3, 5), mode="greedy"),
        GaussianField(pore_radius=Length(0.03), tunnel_radius=Length(0.03)),
    )


@functools.cache
def scan_of(total=TOTAL, n=N):
    """A cell of another seed as a scanner sees it: blurred, with noise."""
    values = recipe(total).run(PlainContext(77)).sample(n)
    solid = (values < np.quantile(values, 0.4)).astype(np.float32)
    rng = np.random.default_rng(0)
    gray = gaussian_filter(solid, 0.7, mode="wrap") + rng.normal(0, 0.1, solid.shape).astype(np.float32)
    smooth = 0.5 - gaussian_filter(gray, 0.5, mode="wrap")
    return ImageField.through(np.asfortranarray(smooth), (1 / n,) * 3, physical=False, periodic=True)


def matched(scan, **options):
    context = PlainContext(1)
    given = {"vary": ("sample.dart_throwing.total",), "low": (40.0,), "high": (160.0,), "starts": 8, "evaluations": 14}
    made = TuneMatch(**given | {"resolution": N, "hold_out": False} | options).run(context, recipe(total=100), scan)
    return made, context


def test_the_number_of_pores_is_found_again():
    scan = scan_of()
    made, context = matched(scan, draws=2)
    found = context.reported
    assert found["values"][0] == pytest.approx(TOTAL, rel=0.05)
    assert abs(found["porosity"]) < 1e-3
    assert found["S2"] < 0.02
    assert abs(found["chords"]["solid"]) < 0.05
    assert abs(found["thickness"]["solid"]) < 0.05
    assert 1 - made.to_numpy(N).mean() == pytest.approx(1 - scan.to_numpy(N).mean(), abs=1e-3)


def test_what_is_not_matched_is_measured():
    few = {"starts": 2, "evaluations": 3, "low": (18.0,), "high": (22.0,), "resolution": 24}
    _, context = matched(scan_of(20, 24), hold_out=True, **few)
    # trials differ by their options alone, so that the same comes out again
    assert matched(scan_of(20, 24), **few)[1].reported["values"] == context.reported["values"]
    for name in ("scan", "twin"):
        assert 0 < context.reported[name]["stiffness"] < 0.4
        assert context.reported[name]["permeability"] > 0
    ratio = context.reported["twin"]["stiffness"] / context.reported["scan"]["stiffness"]
    assert context.reported["held_out"]["stiffness"] == pytest.approx(ratio - 1)


def test_the_distance_is_zero_for_the_same_and_grows_with_the_size_of_balls():
    looks = [Look.at(spheres(48, radius, 0.4, seed=1), True, 12) for radius in (4, 4.5, 6)]
    for kind in KINDS:
        assert distance(looks[0], looks[0], (kind,)) == 0
    near, far = (distance(looks[0], look, ("S2", "chords", "thickness")) for look in looks[1:])
    assert 0 < near < far < 1
    assert differences(looks[0], looks[2])["chords"]["solid"] > 0.3


def test_options_that_do_not_fit_are_refused():
    with pytest.raises(ConfigError, match="2 options, with 1 values of `low`"):
        TuneMatch(vary=("a", "b"), low=(0.0,), high=(1.0,)).check_options()
    with pytest.raises(ConfigError, match="they should rise"):
        TuneMatch(vary=("a",), low=(1.0,), high=(1.0,)).check_options()
    values = np.array(scan_of(20, 24).sample(24), order="F")
    sized = ImageField.through(values, (0.1,) * 3, physical=True, periodic=True)
    with pytest.raises(ConfigError, match="a cell without one"):
        matched(sized, resolution=24)
