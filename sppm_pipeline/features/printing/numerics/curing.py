"""Cure-through: light of later layers that reaches into void below them and cures resin there.

An exposure decays as exp(-depth / D_p), and one alone cures to the depth C_d = D_p ln(E / E_c) (Jacobs, "Rapid
Prototyping and Manufacturing", 1992: the working curve). Void at layer k has seen the layers above through the film:
sum over j of s(k + j) q^j, q = exp(-h / D_p), in units of the exposure; it is cured where exp(C_d / D_p) times that
reaches 1. Below a thick ceiling that is the depth C_d + D_p ln(1 / (1 - q)).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.jit.compiled import inline_jit

IGNORED_DOSE = 1e-3
"""Doses of layers farther up than this share of the critical one, all together, are left out."""


class CureThrough:
    """Layers as they cure; `add` those that are exposed, then `finish`.

    `shape` is (nx, ny); layer height, penetration D_p and cure depth C_d are in one unit.
    """

    def __init__(self, shape: tuple[int, int], layer: float, penetration: float, cure_depth: float) -> None:
        self._q = np.float32(math.exp(-layer / penetration))
        # a dose that reaches the critical one up to rounding of float32 cures
        self._critical = np.float32(math.exp(-cure_depth / penetration) * (1 - 1e-6))
        # layers from which on the geometric series of doses is below IGNORED_DOSE of the critical one
        ahead = (cure_depth + penetration * math.log(1 / (IGNORED_DOSE * (1 - float(self._q))))) / layer
        self._ahead = max(1, math.ceil(ahead))
        self._ring: deque[NDArray[np.uint8]] = deque()
        self._shape = shape[::-1]

    def add(self, solid: NDArray[np.uint8]) -> Iterator[NDArray[np.uint8]]:
        """Take in the next layer of zeros and ones; yields layers as printed, once all that reaches them is known."""
        self._ring.append(solid.copy())
        if len(self._ring) > self._ahead:
            yield self._cured()

    def finish(self) -> Iterator[NDArray[np.uint8]]:
        """The last layers."""
        while self._ring:
            yield self._cured()

    def _cured(self) -> NDArray[np.uint8]:
        first = self._ring.popleft()
        dose = np.zeros(self._shape, np.float32)
        for later in reversed(self._ring):
            _decay(dose.ravel(), later.ravel(), self._q)
        return (first.view(np.bool_) | (dose >= self._critical)).view(np.uint8)


@inline_jit
def _decay(dose: NDArray[np.float32], exposed: NDArray[np.uint8], q: np.float32) -> None:
    for i in range(dose.size):
        dose[i] = q * (dose[i] + np.float32(exposed[i]))
