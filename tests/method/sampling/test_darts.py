"""Dart throwing: the spacing holds, the count is exact, saturation is maximal, and the law is that of plain darts."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.sampling.capacity import box_capacity, largest_spacing
from sppm_pipeline.method.sampling.darts import throw

UNIT = ([0.0] * 3, [1.0] * 3)
TORUS = (True, True, True)


def images(points: NDArray[np.float64], axes: tuple[bool, ...]) -> NDArray[np.float64]:
    """All images within two periods, (125 or fewer times n, dimension)."""
    shifts = np.array(list(itertools.product(*[(-2, -1, 0, 1, 2) if wraps else (0,) for wraps in axes])), dtype=float)
    return (points[None] + shifts[:, None]).reshape(-1, points.shape[1])


def closest(points: NDArray[np.float64], others: NDArray[np.float64], *, same: bool) -> float:
    """Smallest distance between two sets; distance 0 of a point to itself is left out where the sets are the same."""
    if len(points) == 0 or len(others) == 0:
        return math.inf
    distance = np.linalg.norm(points[:, None] - others[None], axis=-1)
    if same:
        rows = np.flatnonzero(np.all(others[None] == points[:, None], axis=-1).any(axis=0))
        assert len(rows) >= len(points)
        distance[distance == 0.0] = math.inf
    return float(distance.min())


def naive_darts(
    rng: np.random.Generator, count: int, spacing: float, lower: list[float], upper: list[float], periodic: bool
) -> NDArray[np.float64]:
    """The paper's words, one by one: discard and form again until the number is reached."""
    points = np.empty((0, 3))
    while len(points) < count:
        dart = np.asarray(lower) + (np.asarray(upper) - np.asarray(lower)) * rng.random(3)
        gap = np.abs(points - dart)
        if periodic:
            gap = np.minimum(gap, 1.0 - gap)
        if np.all((gap**2).sum(axis=1) >= spacing**2):
            points = np.vstack([points, dart])
    return points


@st.composite
def throws(draw: st.DrawFn) -> dict[str, object]:
    periodic = tuple(draw(st.booleans()) for _ in range(3))
    lower, upper = [], []
    for _ in range(3):
        start = draw(st.floats(-1.0, 1.0))
        lower.append(start)
        upper.append(start + draw(st.sampled_from([0.0, 0.3, 0.8, 1.0])))
    return {
        "spacing": draw(st.floats(0.08, 0.9)),
        "lower": lower,
        "upper": upper,
        "periodic": periodic,
        "share": draw(st.sampled_from([0.2, 0.6, 0.9, 1.0])),
        "obstacles": draw(st.integers(0, 6)),
        "obstacle_images": draw(st.booleans()),
        "seed": draw(st.integers(0, 2**32)),
    }


@settings(deadline=None, derandomize=True, max_examples=150)
@given(case=throws())
def test_spacing_is_never_violated(case: dict) -> None:
    obstacles = np.random.default_rng(case["seed"]).uniform(-1.5, 2.5, (case["obstacles"], 3))
    periodic, spacing = case["periodic"], case["spacing"]
    try:
        points = throw(
            np.random.default_rng(case["seed"]),
            None,
            spacing,
            case["lower"],
            case["upper"],
            periodic=periodic,
            obstacles=obstacles,
            obstacle_images=case["obstacle_images"],
            share=case["share"],
        )
    except DesignError:
        assert len(obstacles) > 0 or case["share"] == 0.9
        return
    assert np.all(points >= case["lower"])
    assert np.all(points <= case["upper"])
    assert closest(points, images(points, periodic), same=True) >= spacing
    every = (True, True, True) if case["obstacle_images"] else periodic
    # Obstacles lie up to two periods and a half away: fold them first, then two periods of images are enough.
    folded = np.where(every, obstacles - np.floor(obstacles - np.asarray(case["lower"])), obstacles)
    assert closest(points, images(folded, every), same=False) >= spacing


@pytest.mark.parametrize("share", [0.1, 0.5, 0.75, 0.9, 0.95])
@pytest.mark.parametrize("periodic", [(False,) * 3, TORUS, (True, False, True)])
def test_exact_count_at_every_share(share: float, periodic: tuple[bool, ...]) -> None:
    count = 120
    spacing = 0.05
    while box_capacity(1.0, spacing * 1.01, periodic) * share > count:
        spacing *= 1.01
    points = throw(np.random.default_rng(3), count, spacing, *UNIT, periodic=periodic)
    assert points.shape == (count, 3)
    assert points.dtype == np.float64
    assert closest(points, images(points, periodic), same=True) >= spacing


def test_same_seed_same_bytes() -> None:
    first, second, other = (
        throw(np.random.default_rng(seed), 300, 0.1, *UNIT, periodic=TORUS).tobytes() for seed in (5, 5, 6)
    )
    assert first == second
    assert first != other


def test_a_throw_is_the_start_of_a_longer_throw() -> None:
    """Candidates come one by one from a stream: asking for more pores does not change those already thrown."""
    few, many = (throw(np.random.default_rng(1), n, 0.1, *UNIT) for n in (50, 200))
    np.testing.assert_array_equal(few, many[:50])


@pytest.mark.parametrize("dimension", [1, 2, 3])
@pytest.mark.parametrize("periodic", [(False,) * 3, TORUS])
def test_saturated_means_no_free_spot(dimension: int, periodic: tuple[bool, ...]) -> None:
    upper = np.array([1.0, 1.0, 1.0])
    upper[dimension:] = 0.0
    rng = np.random.default_rng(8)
    obstacles = rng.random((4, 3)) * upper
    spacing = 0.14
    points = throw(rng, None, spacing, [0.0] * 3, upper, periodic=periodic, obstacles=obstacles, share=1.0)
    everything = np.vstack([images(points, periodic), images(obstacles, TORUS)])
    everything = everything[np.all((everything > -spacing) & (everything < 1.0 + spacing), axis=1)]
    probes = rng.random((6000, 3)) * upper
    nearest = np.full(len(probes), math.inf)
    for point in everything:
        nearest = np.minimum(nearest, np.linalg.norm(probes - point, axis=1))
    assert nearest.max() < spacing


@pytest.mark.parametrize("dimension", [2, 3])
def test_saturation_is_exact_at_the_deepest_holes(dimension: int) -> None:
    """The spots farthest from all points are vertices of the Voronoi diagram: each of them is covered."""
    from scipy.spatial import Voronoi

    spacing = 0.1 if dimension == 2 else 0.25
    upper = np.array([1.0, 1.0, 0.0 if dimension == 2 else 1.0])
    for seed in range(20):
        points = throw(np.random.default_rng(seed), None, spacing, [0.0] * 3, upper, periodic=TORUS, share=1.0)
        around = images(points[:, :dimension], (True,) * dimension)
        around = around[np.all((around > -0.6) & (around < 1.6), axis=1)]
        vertices = Voronoi(around).vertices
        vertices = vertices[np.all((vertices >= 0.0) & (vertices <= 1.0), axis=1)]
        depth = np.full(len(vertices), math.inf)
        for point in around:
            depth = np.minimum(depth, np.linalg.norm(vertices - point, axis=1))
        assert len(depth) > len(points)
        assert depth.max() < spacing * (1 + 1e-6)


def test_saturation_finds_the_last_hole() -> None:
    """A hole of a millionth of the volume, which plain darts would not hit, is found."""
    grid = np.array(list(itertools.product(np.linspace(0.0, 1.0, 41), repeat=3)))
    spacing = 0.03
    hole = np.array([0.4125, 0.5625, 0.6125])
    obstacles = grid[np.linalg.norm(grid - hole, axis=1) > spacing + 0.0001]
    points = throw(
        np.random.default_rng(0), None, spacing, *UNIT, obstacles=obstacles, obstacle_images=False, share=1.0
    )
    assert len(points) == 1
    np.testing.assert_allclose(points[0], hole, atol=0.02)


def test_dense_throws_follow_the_law_of_plain_darts() -> None:
    """The last point of a nearly full line: its distribution agrees with the naive loop's (same mean and spread)."""
    spacing, count, runs = 0.2, 4, 1500
    rng = np.random.default_rng(11)
    ours, plain = [], []
    for _ in range(runs):
        try:
            ours.append(throw(rng, count, spacing, [0.0] * 3, [1.0, 0.0, 0.0], attempts=1)[:, 0])
        except DesignError:
            continue
    while len(plain) < runs:
        dart = np.sort(naive_darts(rng, 3, spacing, [0.0] * 3, [1.0, 0.0, 0.0], False)[:, 0])
        gaps = np.diff([-spacing, *dart, 1.0 + spacing]) - 2 * spacing
        room = np.maximum(gaps, 0.0)
        if room.sum() == 0.0:
            continue
        slot = rng.choice(4, p=room / room.sum())
        left = -spacing if slot == 0 else dart[slot - 1]
        plain.append(np.append(dart, left + spacing + room[slot] * rng.random()))
    last_ours = np.abs(np.array(ours)[:, -1] - 0.5)
    last_plain = np.abs(np.array(plain)[:, -1] - 0.5)
    error = math.sqrt(last_ours.var() / len(ours) + last_plain.var() / runs)
    assert abs(last_ours.mean() - last_plain.mean()) < 4 * error


def test_uniform_over_the_torus() -> None:
    """No place of the torus is preferred by a dense throw: the moments of a coordinate are those of a uniform one."""
    points = np.vstack([throw(np.random.default_rng(seed), 40, 0.24, *UNIT, periodic=TORUS) for seed in range(60)])
    phase = np.exp(2j * np.pi * points)
    assert np.abs(phase.mean(axis=0)).max() < 3.5 / math.sqrt(len(points))


def test_full_obstacles_leave_nothing() -> None:
    grid = np.array(list(itertools.product(np.linspace(0.0, 1.0, 6), repeat=3)))
    assert throw(np.random.default_rng(0), None, 0.5, *UNIT, obstacles=grid, share=1.0).shape == (0, 3)
    with pytest.raises(DesignError, match="only 0 of 3"):
        throw(np.random.default_rng(0), 3, 0.3, *UNIT, obstacles=grid)


def test_obstacle_images_count_only_where_asked() -> None:
    obstacle = [[0.5, 0.5, 0.0]]
    box = ([0.5, 0.5, 0.9], [0.5, 0.5, 1.0])
    with pytest.raises(DesignError, match="only 0 of 1"):
        throw(np.random.default_rng(0), 1, 0.2, *box, obstacles=obstacle)
    assert len(throw(np.random.default_rng(0), 1, 0.2, *box, obstacles=obstacle, obstacle_images=False)) == 1


def test_failure_names_the_best_count() -> None:
    spacing = largest_spacing(100, (1.0, 1.0, 1.0))
    obstacles = np.random.default_rng(0).random((20, 3))
    with pytest.raises(DesignError, match="of 100 pores") as caught:
        throw(np.random.default_rng(0), 100, spacing, *UNIT, obstacles=obstacles)
    best = int(caught.value.message.split()[1])
    assert 60 <= best < 100
    assert caught.value.hint is not None
    assert str(best) in caught.value.hint
    assert len(throw(np.random.default_rng(1), best - 3, spacing, *UNIT, obstacles=obstacles)) == best - 3


def test_points_without_spacing() -> None:
    assert throw(np.random.default_rng(0), 1000, 0.0, *UNIT).shape == (1000, 3)
    assert throw(np.random.default_rng(0), 0, 0.1, *UNIT).shape == (0, 3)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"count": 10**6}, "do not fit"),
        ({"count": -1}, ">= 0"),
        ({"spacing": -0.1}, "spacing"),
        ({"spacing": math.nan}, "spacing"),
        ({"spacing": 1.5, "periodic": TORUS}, "image"),
        ({"count": None, "share": 0.0}, "share"),
        ({"count": None, "share": 1.5}, "share"),
        ({"count": None, "share": 1.0, "spacing": 0.0}, "spacing"),
        ({"count": None, "share": 1.0, "spacing": 1e-5}, "at most"),
        ({"count": None, "share": 0.5, "spacing": 1e-5}, "at most"),
    ],
)
def test_impossible_wishes(change: dict, words: str) -> None:
    options = {"count": 10, "spacing": 0.1, "lower": [0.0] * 3, "upper": [1.0] * 3} | change
    with pytest.raises(DesignError, match=words):
        throw(np.random.default_rng(0), **options)


@pytest.mark.parametrize(
    "change",
    [
        {"lower": [0.0, 0.0]},
        {"lower": [0.0, 0.0, 2.0]},
        {"upper": [1.0, 1.0, 1.5], "periodic": TORUS},
        {"upper": [1.0, 1.0, math.inf]},
        {"share": 0.5},
        {"count": None},
    ],
)
def test_wrong_calls(change: dict) -> None:
    options = {"count": 10, "spacing": 0.1, "lower": [0.0] * 3, "upper": [1.0] * 3} | change
    with pytest.raises(ValueError, match=r"box|entries|share|broadcast"):
        throw(np.random.default_rng(0), **options)
