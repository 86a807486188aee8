"""The march: cubes with known answers, the balance of energy, threads, contact, and bodies that are hopeless."""

import numpy as np
import pytest
from scipy.optimize import brentq
from sppm_crushing.numerics.body import body_of
from sppm_crushing.numerics.march import Failed, Load, March
from sppm_crushing.numerics.material import Material

from sppm_pipeline.features.stiffness.numerics.elasticity import stiffness

CUBE = np.ones((6, 6, 6), np.uint8)


def run(image, materials, load, threads=1):
    march = March(body_of(image, confined=load.confined), materials, load, threads)
    march.to(1)
    march.close()
    return march, march.history()


def stretched(material, stretch):
    """Principal Kirchhoff stresses of a neo-Hookean solid with a free side, and its sideways stretch."""
    lam, mu = material.lame

    def stress(side):
        j = stretch * side**2
        b = np.array([stretch**2, side**2, side**2]) * j ** (-2 / 3)
        return mu * (b - b.mean()) + (lam + 2 * mu / 3) / 2 * (j - 1 / j)

    side = brentq(lambda side: stress(side)[1], 0.5, 3)
    return stress(side), side


def test_neo_hookean_cube_has_the_stress_of_the_closed_form():
    rubber = Material(1.0, 0.35)
    march, history = run(CUBE, (rubber,), Load(0.6, 0.005))
    later = history.strain > 0.05
    exact = np.array([-stretched(rubber, 1 - e)[0][0] / (1 - e) for e in history.strain[later]])
    assert history.top[later] / 36 == pytest.approx(exact, rel=5e-3)
    assert history.bottom[later] / 36 == pytest.approx(exact, rel=5e-3)
    side = march.x[:, 0].max() - march.x[:, 0].min()
    assert side == pytest.approx(6 * stretched(rubber, 0.4)[1], rel=2e-3)
    shares = march.shares()
    assert abs(shares["unbalanced"]) < 2e-3
    assert shares["elastic"] == pytest.approx(1, abs=5e-3)


def test_plastic_cube_has_the_stress_of_its_yield_stress():
    metal = Material(2.0, 0.35, ((0.0, 0.04), (1.0, 0.14)))
    march, history = run(CUBE, (metal,), Load(0.6, 0.005))
    lam, mu = metal.lame
    bulk = lam + 2 * mu / 3

    def pulled(strain):
        """Stress where the logarithmic strain is elastic, volumetric and plastic together."""

        def parts(alpha):
            limit = 0.04 + 0.1 * alpha
            j = brentq(lambda j: bulk / 2 * (j - 1 / j) + limit / 3, 0.3, 1)
            mean = brentq(
                lambda m: (m - 2 * limit / 3 / mu) * (m + limit / 3 / mu) ** 2 - 1, 1e-9 + 2 * limit / 3 / mu, 3
            )
            return limit, np.log(mean - 2 * limit / 3 / mu) / 2 + np.log(j) / 3

        alpha = brentq(lambda alpha: parts(alpha)[1] - alpha - np.log(1 - strain), 0, 3)
        return parts(alpha)[0] / (1 - strain), alpha

    later = history.strain > 0.025  # it yields at .02
    exact = np.array([pulled(e)[0] for e in history.strain[later]])
    # the march is in units of the first material's modulus
    assert 2 * history.top[later] / 36 == pytest.approx(exact, rel=6e-3)
    assert march.plastic_strain.mean() == pytest.approx(pulled(0.6)[1], rel=3e-3)
    assert abs(march.shares()["unbalanced"]) < 5e-3


def test_energy_is_balanced_and_plates_agree(crushed):
    shares, history = crushed.shares(), crushed.history()
    assert abs(shares["unbalanced"]) < 2e-3
    assert shares["plastic"] > 0.7
    assert shares["contact"] > 1e-3
    assert shares["kinetic"] < 0.02
    later = history.strain > 0.05
    assert np.abs((history.top - history.bottom)[later]).mean() < 0.03 * history.top[later].mean()
    area = np.trapezoid(history.top, history.strain) * 16
    assert area == pytest.approx(history.work[-1], rel=5e-3)


def test_threads_and_interruptions_leave_no_trace(crushed, cell, plastic):
    whole = crushed.history()
    first = March(crushed.body, (plastic,), crushed.load, 2)
    first.to(0.5)
    kept = first.kept()
    first.close()
    then = March(crushed.body, (plastic,), crushed.load, 3)
    then.resume({name: value.copy() for name, value in kept.items()})
    then.to(0.55)
    then.close()
    other = March(crushed.body, (plastic,), crushed.load, 3)
    other.to(0.5)
    other.kept()
    other.to(0.55)
    other.close()
    assert np.array_equal(then.x, other.x)
    assert np.array_equal(then.history().top, other.history().top)
    n = np.count_nonzero(whole.strain < 0.49)
    assert np.array_equal(other.history().top[:n], whole.top[:n])


def blocks(gap, shift, load):
    """Two blocks with a gap; by how much more than the gap they have come closer than one block, over pressure."""
    rubber = Material(1.0, 0.35)
    image = np.ones((4 + gap, 5, 5), np.uint8)
    image[2 : 2 + gap] = 0
    march = March(body_of(image), (rubber,), Load((gap + 4 * 0.3) / (4 + gap), 0.01, load, False, 0.2))
    upper = march.body.nodes[:, 2] > 2
    march.x[upper, :2] += shift
    march.relist()
    march.to(1)
    history = march.history()
    pressure = (history.top + history.bottom) / 50
    found = []
    for wanted in (0.03, 0.1, 0.2, 0.3):
        way = history.strain[np.argmax(pressure > wanted)] * (4 + gap)
        alone = brentq(lambda e, p=wanted: -stretched(rubber, 1 - e)[0][0] / (1 - e) - p, 0, 0.5)
        found.append(way - gap - 4 * alone)
    return np.array(found), pressure.max()


@pytest.mark.parametrize(("gap", "shift"), [(gap, shift) for gap in (1, 2, 3, 4) for shift in (0.0, 0.5)])
def test_blocks_meet_where_their_gap_closes(gap, shift):
    closed, most = blocks(gap, shift, 0.0)
    assert np.abs(closed).max() < 0.15
    assert most > 0.3  # nothing has slipped through


def test_phases_have_their_own_stiffness():
    """Two layers in series: the mean compliance, if they are slow and thin against their width."""
    image = np.ones((8, 4, 4), np.uint8)
    image[4:] = 2
    _, history = run(image, (Material(1.0, 0.0), Material(0.25, 0.0)), Load(0.01, 0.002))
    at = (history.strain > 0.005) & (history.strain < 0.01)
    modulus = np.polyfit(history.strain[at], history.top[at] / 16, 1)[0]
    assert modulus == pytest.approx(1 / (0.5 / 1 + 0.5 / 0.25), rel=0.03)


def test_rollers_and_sticking_plates_hold_what_they_should():
    rubber = Material(1.0, 0.3)
    lam, mu = rubber.lame
    march, history = run(CUBE, (rubber,), Load(0.02, 0.005, 0.0, True))
    assert march.x[:, 0].max() == 6
    at = history.strain > 0.01
    modulus = np.polyfit(history.strain[at], history.top[at] / 36, 1)[0]
    assert modulus == pytest.approx(lam + 2 * mu, rel=0.05)
    march, _ = run(CUBE, (rubber,), Load(0.1, 0.01, -1.0))
    ends = (march.body.nodes[:, 2] == 0) | (march.body.nodes[:, 2] == 6)
    assert march.x[ends, 0] == pytest.approx(march.body.nodes[ends, 0], abs=1e-12)
    assert march.x[~ends, 0].max() > 6.01


def test_rollers_and_plates_mirror_a_cell(small_cell):
    """At small strain, a confined cell is as stiff as the periodic one of 2 x 2 x 2 mirrored ones."""
    rubber, image = Material(1.0, 0.35), small_cell
    _, history = run(image, (rubber,), Load(0.012, 0.002, 0.0, True))
    at = history.strain > 0.002
    secant = (history.top + history.bottom)[at] / (128 * history.strain[at])
    modulus = np.polyfit(history.strain[at], secant, 1)[1]
    lam, mu = rubber.lame
    mirrored, cell = (
        stiffness(lam * solid, mu * solid, (1.0, 1.0, 1.0)).stiffness[2, 2]
        for solid in (np.pad(image, ((0, 8),) * 3, mode="symmetric").astype(float), image.astype(float))
    )
    assert modulus == pytest.approx(mirrored, rel=5e-3)
    assert mirrored < 0.95 * cell  # what would be compared with the wrong cell


def test_loose_pieces_fall_out_without_harm(plastic):
    image = np.zeros((10, 8, 8), np.uint8)
    image[:, 2:5, 2:5] = 1
    image[4:6, 6:8, 6:8] = 1
    march, history = run(image, (plastic,), Load(0.5, 0.02))
    assert np.isfinite(march.x).all()
    assert history.top[-1] > 0.02 * 9
    assert abs(march.shares()["unbalanced"]) < 0.02
    loose = march.body.nodes[:, 0] >= 6
    assert np.ptp(march.x[loose, 2]) == pytest.approx(2, abs=0.2)  # unharmed


@pytest.mark.parametrize("harm", ["light", "lost"])
def test_what_comes_apart_keeps_what_it_was_worth(harm):
    march = March(body_of(CUBE), (Material(1.0, 0.35),), Load(0.3, 0.02))
    march.to(0.1)
    before = march.history()
    if harm == "light":
        march._mass *= 0.05  # the step is too long for it
        march._density *= 0.05
    else:
        march.x[10] = np.nan
    with pytest.raises(Failed, match=r"(inside out|without bound) beyond a strain of 0\.1") as failed:
        march.to(0.3)
    history = march.history()
    assert failed.value.strain == history.strain[-1] == pytest.approx(0.1, abs=5e-3)
    assert np.array_equal(history.top[: len(before.top) - 1], before.top[:-1])
    assert history.top[-1] == pytest.approx(before.top[-1], rel=0.1)
    assert all(np.isfinite(values).all() for values in (history.work, *history.energies.values()))


def test_nothing_to_crush_is_an_error():
    with pytest.raises(ValueError, match="no solid"):
        body_of(np.zeros((3, 3, 3), np.uint8))
