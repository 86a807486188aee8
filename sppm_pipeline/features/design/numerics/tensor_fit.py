"""Fit of a family of structures to a stiffness tensor: dials, two stretches and a rotation, by few costly evaluations.

A structure of the family is made with its dials, stretched by ``diag(1, a, b) / (a b)^(1/3)`` at unchanged porosity,
and turned. The rotation costs nothing, as it turns the stiffness exactly; so it is fitted again with every step.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.arrays import F64
from sppm_pipeline.services.elastic.directional import young_along
from sppm_pipeline.services.elastic.voigt import mandel, rotated, tensor

MAX_STRETCH = 4.0
"""Largest of the stretches a and b: beyond, cells of some pores across have two along their shortest edge."""

SLOPE = 1.5
"""Logarithm of the ratio of Young's moduli over that of the stretch, from which the search starts: 1.1 to 1.8 for walls
with struts at porosities from 0.72 to 0.85."""

MAX_STEPS = 0.25, 0.35
"""Largest steps of dials, over their range, and of logarithms of the stretches, in which slopes are trusted."""

STEPS = 0.12, 0.1
"""Steps of finite differences: of dials, over their range; of logarithms of the stretches."""

ITERATIONS = 4
"""Most Gauss-Newton steps on the few draws; cells took two or three."""

ENOUGH = 0.01
"""Relative distance at which they end, a third of what eight draws scatter."""

_TURN = 1e-4


class Design(NamedTuple):
    """A member of the family."""

    dials: tuple[float, ...]
    stretch: F64  # along the axes of the recipe, (3,); their product is 1
    rotation: F64  # takes vectors of the recipe to where they point in the part
    distance: float  # between its stiffness and the target, over the norm of the target


def orthotropic(stiffness: F64) -> F64:
    """The part of a stiffness that mirrors at the planes of the axes leave: that of the mean over mirrored draws."""
    found = np.diag(np.diag(stiffness))
    found[:3, :3] = stiffness[:3, :3]
    return np.asarray((found + found.T) / 2)


def stretch_of(logs: Sequence[float] | F64) -> F64:
    """Stretches along x, y and z of the product 1, from ``(ln a, ln b)``."""
    found = np.array([0.0, logs[0], logs[1]])
    return np.asarray(np.exp(found - found.mean()))


def turned(vector: NDArray[Any]) -> F64:
    """The rotation by a vector: its length is the angle."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(vector).as_matrix(), np.float64)


def principal_frame(stiffness: F64) -> F64:
    """A rotation whose columns are the principal axes of ``C_iikl``, from the softest to the stiffest (Cowin and
    Mehrabadi 1987: those of an orthotropic tensor are its axes)."""
    _, vectors = np.linalg.eigh(np.einsum("iikl->kl", tensor(stiffness)))
    frame = vectors[:, np.argsort(young_along(stiffness, vectors.T), kind="stable")]
    frame[:, 2] *= np.sign(np.linalg.det(frame))
    return np.asarray(frame, np.float64)


class Fit:
    """The search of the design whose stiffness is nearest to a target (6, 6), with weights of its rows (6,)."""

    def __init__(self, target: F64, weights: F64, low: Sequence[float], high: Sequence[float]) -> None:
        self._scale = np.outer(weights, weights)
        self._target = mandel(target) * self._scale
        self._norm = float(np.linalg.norm(self._target))
        self._frame = principal_frame(target)
        moduli = young_along(target, self._frame.T)
        start = np.log(np.maximum(moduli / moduli[0], 1.0)) / SLOPE
        reach = math.log(MAX_STRETCH)
        self.low = np.array([*low, -reach, -reach])
        self.high = np.array([*high, reach, reach])
        self.start = np.clip(start[1:], -reach, reach)
        self._slopes: F64 | None = None

    def residual(self, stiffness: F64, rotation: F64) -> F64:
        """Differences of all entries, weighted, over the norm of the target, (36,)."""
        return np.asarray((mandel(rotated(stiffness, rotation)) * self._scale - self._target).ravel() / self._norm)

    def turned_best(self, stiffness: F64, rotation: F64) -> tuple[F64, F64]:
        """The rotation near to one given that brings a stiffness nearest to the target, and what is then left."""
        r = self.residual(stiffness, rotation)
        for _ in range(20):
            slopes = self._turning(stiffness, rotation, r)
            step = np.linalg.lstsq(slopes, -r, rcond=1e-6)[0]
            step *= min(1.0, 0.3 / max(float(np.linalg.norm(step)), 1e-12))
            tried = turned(step) @ rotation
            after = self.residual(stiffness, tried)
            if not np.linalg.norm(after) < np.linalg.norm(r) * (1 - 1e-6):
                break
            rotation, r = tried, after
        return rotation, r

    def _turning(self, stiffness: F64, rotation: F64, r: F64) -> F64:
        """Derivatives of the residual by a further turn about x, y and z, (36, 3)."""
        columns = [(self.residual(stiffness, turned(_TURN * e) @ rotation) - r) / _TURN for e in np.eye(3)]
        return np.stack(columns, axis=1)

    def first(self, scanned: Sequence[tuple[tuple[float, ...], F64]]) -> F64:
        """Where to start: the dials of unstretched structures whose norm is nearest, between two of them."""
        off = [math.log(float(np.linalg.norm(mandel(c) * self._scale)) / self._norm) for _, c in scanned]
        best = min(range(len(off)), key=lambda k: abs(off[k]))
        at = np.array(scanned[best][0])
        other = next((k for k, one in enumerate(off) if one * off[best] < 0), best)
        share = off[best] / (off[best] - off[other]) if other != best else 0.0
        return np.concatenate([at + share * (np.array(scanned[other][0]) - at), self.start])

    def design(self, x: F64, stiffness: F64, rotation: F64 | None = None) -> Design:
        """The design at parameters of known stiffness, turned as well as it can be."""
        rotation, r = self.turned_best(stiffness, self._frame if rotation is None else rotation)
        return Design(tuple(map(float, x[:-2])), stretch_of(x[-2:]), rotation, float(np.linalg.norm(r)))

    def run(self, evaluate: Callable[[F64], F64], x: F64) -> tuple[F64, F64]:
        """Gauss-Newton steps from x with the derivatives of finite differences, which secants keep up.

        Returns the parameters, and the stiffness there.
        """
        c = evaluate(x)
        widths = np.array([*(STEPS[0] * (self.high - self.low)[:-2]), STEPS[1], STEPS[1]])
        columns = []
        for k, width in enumerate(widths):
            step = width if x[k] + width <= self.high[k] else -width
            there = x.copy()
            there[k] += step
            columns.append((evaluate(there) - c).ravel() / step)
        self._slopes = np.stack(columns, axis=1)
        here = self.design(x, c)
        trust = 1.0
        for _ in range(ITERATIONS):
            step = self._step(x, c, here.rotation, trust)
            if here.distance < ENOUGH or np.abs(step / widths).max(initial=0) < 0.1:
                break
            tried = evaluate(x + step)
            # Broyden's rule: the slopes are right along the last step
            error = (tried - c).ravel() - self._slopes @ step
            self._slopes += np.outer(error, step) / float(step @ step)
            there_ = self.design(x + step, tried, here.rotation)
            gain = here.distance - there_.distance
            if gain > 0:
                x, c, here = x + step, tried, there_
            trust = 1.0 if gain > 0 else trust / 3
            if gain < 0.02 * here.distance and trust < 0.5:
                break
        return x, c

    def corrected(self, x: F64, stiffness: F64) -> F64:
        """Parameters after one more step, by the slopes known, from the stiffness of more draws on finer grids."""
        rotation, _ = self.turned_best(stiffness, self._frame)
        return x + self._step(x, stiffness, rotation)

    def _step(self, x: F64, stiffness: F64, rotation: F64, trust: float = 1.0) -> F64:
        """The step of dials and stretches, with the rotation free, within the bounds."""
        from scipy.optimize import lsq_linear

        assert self._slopes is not None
        r = self.residual(stiffness, rotation)
        size = np.maximum(self.high - self.low, 1e-12)
        own = [(mandel(rotated(s.reshape(6, 6), rotation)) * self._scale).ravel() / self._norm for s in self._slopes.T]
        slopes = np.concatenate([np.stack(own, axis=1) * size, self._turning(stiffness, rotation, r)], axis=1)
        # a little damping where slopes are nearly alike
        damped = np.concatenate([slopes, 0.01 * np.eye(slopes.shape[1])])
        room = trust * np.array([MAX_STEPS[0]] * (len(x) - 2) + [MAX_STEPS[1]] * 2)
        room[-2:] /= size[-2:]
        lower = np.concatenate([np.maximum((self.low - x) / size, -room), [-0.5] * 3]) - 1e-9
        upper = np.concatenate([np.minimum((self.high - x) / size, room), [0.5] * 3]) + 1e-9
        step = lsq_linear(damped, np.concatenate([-r, np.zeros(slopes.shape[1])]), (lower, upper)).x[: len(x)]
        return np.asarray(np.clip(x + step * size, self.low, self.high) - x)


def interval(draws: F64, share: float = 0.95) -> tuple[F64, F64, F64]:
    """Mean of draws (n, 6, 6), half width of its interval, and of that in which one more draw lies (Student's t)."""
    from scipy.special import stdtrit

    n = len(draws)
    t = float(stdtrit(n - 1, 0.5 + share / 2))
    deviation = draws.std(axis=0, ddof=1)
    return draws.mean(axis=0), t * deviation / math.sqrt(n), t * deviation * math.sqrt(1 + 1 / n)
