"""Twins of scans: parameters of structures of our own are found again, and what is not matched is said."""

import functools

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from sppm_pipeline import Voxels
from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.scans.image_field import ImageField
from sppm_pipeline.features.scans.numerics.statistics import configurations, fabric
from sppm_pipeline.features.scans.numerics.stretching import matrix_of, stretch_of, stretched
from sppm_pipeline.features.scans.stages.tune_match import (
    KINDS,
    PROPERTIES,
    Look,
    TuneMatch,
    differences,
    distance,
    properties_of,
)
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


def test_properties_are_matched_where_they_are_asked_for():
    few = {"starts": 3, "evaluations": 3, "low": (14.0,), "high": (34.0,), "resolution": 24}
    off = {}
    for match in (("S2",), ("S2", *PROPERTIES)):
        made, context = matched(scan_of(20, 24), match=match, **few)
        images = (scan_of(20, 24).sample(24) < 0, made.sample(24) < 0)
        of = [properties_of(context, Voxels.from_array(image, spacing=1 / 24, periodic=True)) for image in images]
        off[match] = np.array([np.log(of[1][kind] / of[0][kind]) for kind in PROPERTIES])
    S2 = distance(*(Look.at(image, True, 6) for image in images), ("S2",))
    # that of the nearest trial is made of what was measured on voxels
    assert context.reported["distance"] == pytest.approx(np.sqrt(np.mean([S2**2, *off[match] ** 2])), rel=1e-3)
    assert np.linalg.norm(off[match]) < np.linalg.norm(off["S2",])
    blocked = np.ones((24, 24, 24), bool)
    blocked[4:8] = blocked[:, 4:8] = blocked[:, :, 4:8] = False
    with pytest.raises(DesignError, match="has no stiffness that could be matched"):
        matched(Voxels.from_array(blocked, spacing=1 / 24, periodic=True), match=("stiffness",), **few)


def test_the_distance_is_zero_for_the_same_and_grows_with_the_size_of_balls():
    looks = [Look.at(spheres(48, radius, 0.4, seed=1), True, 12) for radius in (4, 4.5, 6)]
    for kind in set(KINDS) - set(PROPERTIES):
        assert distance(looks[0], looks[0], (kind,)) == 0
    near, far = (distance(looks[0], look, ("S2", "chords", "thickness")) for look in looks[1:])
    assert 0 < near < far < 1
    assert differences(looks[0], looks[2])["chords"]["solid"] > 0.3


STRETCH, TURN = (1.3, 1.0, 1 / 1.3), (10.0, -20.0, 30.0)


def test_cells_are_mapped_about_their_middle():
    values = np.random.default_rng(0).random((8, 8, 8), np.float32)
    np.testing.assert_array_equal(stretched(values, 1, np.eye(3), (8, 8, 8)), values)
    turned = stretched(values, 1, matrix_of((1, 1, 1), (0, 0, 90)), (8, 8, 8))
    np.testing.assert_allclose(turned, np.rot90(values), atol=1e-5)
    # half as long along x: two periods in the box, each of every other sample's mean
    halved = stretched(values, 1, matrix_of((0.5, 1, 1), None), (8, 8, 8))
    np.testing.assert_allclose(halved[:4], np.roll(values.reshape(4, 2, 8, 8).mean(1), -2, 0), atol=1e-5)
    np.testing.assert_allclose(halved[:4], halved[4:], atol=1e-5)
    # twice as fine samples of the same cell
    np.testing.assert_allclose(
        stretched(values.repeat(2, 0).repeat(2, 1).repeat(2, 2), 2, np.eye(3), (8, 8, 8)), values
    )


def test_the_fabric_shows_stretch_and_turn():
    values = recipe(60).run(PlainContext(3)).sample(64)
    box = stretched(values, 1, matrix_of(STRETCH, TURN), (64, 64, 64)) < np.quantile(values, 0.4)
    stretch, turn = stretch_of(*fabric(configurations(box, False), (1.0,) * 3))
    np.testing.assert_allclose(stretch, STRETCH, rtol=0.06)
    off = matrix_of((1, 1, 1), TURN).T @ matrix_of((1, 1, 1), tuple(turn))
    assert np.degrees(np.arccos((np.trace(off) - 1) / 2)) < 12
    lengths, axes = np.array([3.0, 2.0, 1.0]), matrix_of((1, 1, 1), TURN).T
    stretch, turn = stretch_of(lengths, axes)
    np.testing.assert_allclose(stretch, lengths / 6 ** (1 / 3))
    np.testing.assert_allclose(turn, TURN)
    np.testing.assert_allclose(stretch_of(lengths, -axes)[1], TURN)  # axes have no sign


def test_a_twin_is_stretched_and_the_nearest_of_its_draws():
    values = recipe(60).run(PlainContext(3)).sample(36)
    values = stretched(values, 1, matrix_of(STRETCH, TURN), (36, 36, 36))
    values = np.asfortranarray(values - np.float32(np.quantile(values, 0.4)))
    scan = ImageField.through(values, (1 / 36,) * 3, physical=False, periodic=False)
    few = {"starts": 2, "evaluations": 2, "low": (55.0,), "high": (65.0,), "resolution": 36}
    _, plain = matched(scan, **few)
    assert "`stretch: [1." in plain.warnings[0]
    made, context = matched(scan, **few, stretch=STRETCH, turn=TURN, draws=3)
    found = context.reported
    assert made.periodic  # as it was before it was stretched
    assert found["draw"] in (0, 1, 2)
    assert abs(found["fabric"]) < 0.12 < abs(plain.reported["fabric"])
    assert not context.warnings


def test_options_that_do_not_fit_are_refused():
    with pytest.raises(ConfigError, match="2 options, with 1 values of `low`"):
        TuneMatch(vary=("a", "b"), low=(0.0,), high=(1.0,)).check_options()
    with pytest.raises(ConfigError, match="they should rise"):
        TuneMatch(vary=("a",), low=(1.0,), high=(1.0,)).check_options()
    values = np.array(scan_of(20, 24).sample(24), order="F")
    sized = ImageField.through(values, (0.1,) * 3, physical=True, periodic=True)
    with pytest.raises(ConfigError, match="a cell without one"):
        matched(sized, resolution=24)
