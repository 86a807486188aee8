"""Meeting one or two targets by one or two parameters with few, costly evaluations that may fail, jump or be noisy."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np

from sppm_pipeline.services.arrays import F64

MIN_BRACKET = 1e-4
"""Width of a bracket, as a share of the range, at which numbers that still differ too much at its ends are a jump. Ten
bisections more or less do not change the verdict on a smooth function."""

MIN_SPACING = 1 / 16
"""Share of the range down to which the neighborhood of a best interior value is searched for a crossing. Half of it
costs two evaluations more, and finds narrower peaks."""

STARTS = 3
"""Points of the first grid from which two targets are approached before they count as out of reach: more starts find
more local solutions, each at the price of a search."""

MIN_STEP = 0.01
"""Share of the range; where linear models fail for steps as small as this, numbers are noisy or jump."""

MIN_GAIN = 3e-3
"""Smallest relative reduction of the errors of two targets for which a step is tried; a smaller one is lost in the
noise of random cells."""

Point = tuple[float, ...]


class Trial(NamedTuple):
    """One evaluation: the parameters, and the numbers there; None where there are none."""

    at: Point
    numbers: Point | None


class Search(NamedTuple):
    """The result of a search."""

    met: bool
    best: Trial  # the one with the smallest error; of the largest error of both, if there are two targets
    # "outside" (no neighboring trials enclose the targets), "jump" (the numbers jump over them), "exhausted" (no
    # evaluation is left); empty if they are met
    why: str
    trials: tuple[Trial, ...]  # in the order of evaluation


def relative_error(number: float, target: float, scale: float) -> float:
    """The error of a number relative to its target, or to `scale` for the target 0."""
    return abs(number / target - 1) if target else abs(number) / scale if scale else abs(number)


def search(
    evaluate: Callable[[Point], Sequence[float] | None],
    low: Sequence[float],
    high: Sequence[float],
    targets: Sequence[float],
    accuracy: float,
    *,
    first: int,
    evaluations: int,
    whole: Sequence[bool] = (False, False),
) -> Search:
    """Find parameters at which an unknown function has its targets, one or two, by as many parameters.

    A grid of `first` values along each parameter comes first. One target is then enclosed by neighboring trials, and a
    monotone cubic between them proposes the next value (Fritsch and Carlson 1980); where it stalls, the bracket is
    halved. If none enclose it, the surroundings of the nearest trial are refined, unless it is an end. Two targets are
    approached by Gauss-Newton steps on a plane fitted to the trials, the near ones weighing most (a secant method that
    forgets nothing), inside the bounds and a trust region.

    `evaluate` may have no numbers for some parameters; a ValueError says that no trial has any. `accuracy` is the
    largest relative error; of a target 0, relative to the largest number of the first trials. Parameters that are
    `whole` take integers only.
    """
    trials: dict[Point, Point | None] = {}

    def try_out(at: Point) -> None:
        """Evaluate a new point, if an evaluation is left."""
        if at not in trials and len(trials) < evaluations:
            numbers = evaluate(at)
            fine = numbers is not None and all(map(math.isfinite, numbers))
            trials[at] = tuple(float(n) for n in numbers) if fine and numbers is not None else None

    axes = [
        sorted({_whole(value) if w else float(value) for value in np.linspace(a, b, first)})
        for a, b, w in zip(low, high, whole, strict=False)
    ]
    for at in product(*axes):
        try_out(at)
    known = [numbers for numbers in trials.values() if numbers is not None]
    if not known:
        raise ValueError("no trial has numbers")
    scales = [max(abs(numbers[i]) for numbers in known) for i in range(len(targets))]

    def error(numbers: Point | None) -> float:
        if numbers is None:
            return math.inf
        return max(relative_error(n, t, s) for n, t, s in zip(numbers, targets, scales, strict=True))

    proposals = _one(trials, targets[0], low[0], high[0], whole[0]) if len(targets) == 1 else _two(
        trials, targets, scales, axes, whole
    )  # fmt: skip
    why = ""
    while min(map(error, trials.values())) > accuracy:
        if len(trials) >= evaluations:
            why = "exhausted"
            break
        proposed = next(proposals)
        if isinstance(proposed, str):
            why = proposed
            break
        try_out(proposed)
    best = min(trials, key=lambda at: error(trials[at]))
    return Search(not why, Trial(best, trials[best]), why, tuple(Trial(at, n) for at, n in trials.items()))


def _whole(value: float) -> float:
    """The nearest integer; halves are rounded up."""
    return float(math.floor(value + 0.5))


def _one(
    trials: dict[Point, Point | None], target: float, low: float, high: float, whole: bool
) -> Iterator[Point | str]:
    """Proposals for one parameter, none twice, and at last why there is none."""
    widths: list[float] = []
    while True:
        x = np.array([at[0] for at, numbers in trials.items() if numbers is not None])
        y = np.array([numbers[0] for numbers in trials.values() if numbers is not None])
        order = np.argsort(x)
        x, y = x[order], y[order]
        try:
            guess, (left, right) = parameter_for(x, y, target)
        except ValueError:
            yield _refined(x, y, target, MIN_SPACING * (high - low), whole, {at[0] for at in trials}) or "outside"
            continue
        widths.append(right - left)
        if len(widths) > 3 and widths[-1] > 0.5 * widths[-4]:
            guess = (left + right) / 2
            widths.clear()
        # values without a number cut the bracket; a guess on a known value would teach nothing
        cuts = sorted(at[0] for at in trials if left <= at[0] <= right)
        left, right = next((a, b) for a, b in pairwise(cuts) if guess <= b)
        room = 1e-3 * (right - left)
        if not left + room <= guess <= right - room and len(cuts) > 2:
            guess = (left + right) / 2
        guess = min(max(guess, left + room), right - room)
        if whole:
            guess = min(max(_whole(guess), left + 1), right - 1)
            yield (guess,) if left < guess < right else "jump"
        else:
            yield (guess,) if right - left > MIN_BRACKET * (high - low) else "jump"


def _refined(x: F64, y: F64, target: float, finest: float, whole: bool, tried: set[float]) -> Point | None:
    """The middle of the wider gap beside the trial nearest to the target, which may hide an extreme beyond it."""
    best = int(np.argmin(np.abs(y - target)))
    if best in (0, len(x) - 1):
        return None
    left, right = x[best] - x[best - 1], x[best + 1] - x[best]
    middle = x[best] - left / 2 if left >= right else x[best] + right / 2
    middle = _whole(middle) if whole else float(middle)
    return None if max(left, right) <= finest or middle in tried else (middle,)


def parameter_for(parameters: F64, numbers: F64, target: float) -> tuple[float, tuple[float, float]]:
    """The parameter at which the number is expected to be `target`, and the neighboring ones that enclose it.

    A monotone cubic through the samples (Fritsch and Carlson 1980) is followed between two that enclose the target, so
    that the guess always lies between them. Where numbers keep the sign of the target, their logarithms are
    interpolated, which are nearly straight for moduli and permeabilities over the porosity. Parameters differ; a
    ValueError says that no neighboring samples enclose the target.
    """
    from scipy.interpolate import PchipInterpolator

    order = np.argsort(parameters)
    x, y = parameters[order], numbers[order]
    crossed = np.flatnonzero((y[:-1] - target) * (y[1:] - target) <= 0)
    if not len(crossed):
        raise ValueError("the target lies outside of the samples")
    # of several crossings the one between the samples that come nearest
    away = np.abs(y - target) / np.maximum(np.maximum(np.abs(y), abs(target)), 1e-300)
    best = int(crossed[np.argmin(np.minimum(away[crossed], away[crossed + 1]))])
    low, high = float(x[best]), float(x[best + 1])
    goal = target
    if target and y[best] * target > 0 and y[best + 1] * target > 0:
        same = y * target > 0
        start = best - int(np.argmin(np.append(same[best::-1], False))) + 1
        end = best + int(np.argmin(np.append(same[best:], False)))
        x, y, goal = x[start:end], np.log(np.abs(y[start:end])), math.log(abs(target))
    curve = PchipInterpolator(x, y)
    a, b = low, high
    # bisection down to rounding
    for _ in range(60):
        middle = (a + b) / 2
        if (curve(middle) - goal) * (curve(a) - goal) <= 0:
            b = middle
        else:
            a = middle
    return (a + b) / 2, (low, high)


def _two(
    trials: dict[Point, Point | None],
    targets: Sequence[float],
    scales: Sequence[float],
    axes: Sequence[Sequence[float]],
    whole: Sequence[bool],
) -> Iterator[Point | str]:
    """Proposals for two parameters, none twice, and at last why there is none."""
    from scipy.optimize import lsq_linear

    low, high = (np.array([axis[end] for axis in axes]) for end in (0, -1))
    size = np.where(high > low, high - low, 1.0)
    # logarithms of numbers that keep the sign of their target in all trials of the grid
    known = [numbers for numbers in trials.values() if numbers is not None]
    straight = [any(numbers[i] * targets[i] <= 0 for numbers in known) for i in range(2)]

    def residual(numbers: Point) -> F64:
        """Relative errors with a sign, of logarithms where they have one."""
        parts = []
        for number, target, scale, plain in zip(numbers, targets, scales, straight, strict=True):
            if plain:
                parts.append((number - target) / (abs(target) or scale or 1.0))
            else:
                parts.append(math.log(max(number / target, 1e-9)))
        return np.array(parts)

    def scaled(at: Point) -> F64:
        found: F64 = (np.array(at, np.float64) - low) / size
        return found

    def cost(at: Point) -> float:
        numbers = trials[at]
        return math.inf if numbers is None else float(np.linalg.norm(residual(numbers)))

    starts = sorted((at for at in trials if cost(at) < math.inf), key=cost)
    seen: list[F64] = []
    count = 0
    for start in starts:
        if count == STARTS:
            break
        if any(np.abs(scaled(start) - other).max() < 0.26 for other in seen):
            continue
        count += 1
        here, trust = start, 0.5 / max(len(axes[0]) - 1, 1)
        while trust > MIN_STEP:
            seen.append(scaled(here))
            numbers = trials[here]
            assert numbers is not None
            r, s = residual(numbers), scaled(here)
            slope = _plane(trials, here, scaled, residual)
            lower, upper = np.maximum(-s, -trust), np.minimum(1 - s, trust)
            open_ = upper - lower > 1e-12
            if not open_.any() or not np.any(slope):
                break
            step = np.zeros(2)
            step[open_] = lsq_linear(slope[:, open_], -r, (lower[open_], upper[open_])).x
            expected = float(np.linalg.norm(r) - np.linalg.norm(r + slope @ step))
            there = low + np.clip(s + step, 0, 1) * size
            at = tuple(_whole(v) if w else float(v) for v, w in zip(there, whole, strict=False))
            if at in trials or expected <= MIN_GAIN * float(np.linalg.norm(r)):
                trust /= 4
                continue
            yield at
            gained = cost(here) - cost(at)
            trust = max(trust, 2 * float(np.abs(step).max())) if gained > 0.5 * expected else trust
            trust = float(np.abs(step).max()) / 3 if gained < 0.1 * expected else min(trust, 0.5)
            if gained > 0:
                here = at
    while True:
        yield "outside"


def _plane(
    trials: dict[Point, Point | None], here: Point, scaled: Callable[[Point], F64], residual: Callable[[Point], F64]
) -> F64:
    """Slopes (2 residuals, 2 parameters) of a plane through one trial, fitted to the others by distance^-4."""
    numbers = trials[here]
    assert numbers is not None
    others = [(scaled(at) - scaled(here), residual(n)) for at, n in trials.items() if n is not None and at != here]
    if not others:
        return np.zeros((2, 2))
    steps = np.array([step for step, _ in others])
    rises = np.array([r for _, r in others]) - residual(numbers)
    weights = (steps**2).sum(1)[:, None] ** -1.0
    return np.asarray(np.linalg.lstsq(weights * steps, weights * rises, rcond=None)[0].T)
