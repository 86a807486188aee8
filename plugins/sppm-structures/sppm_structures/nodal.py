"""Nodal approximations of triply periodic minimal surfaces: sums of products of sines and cosines.

Sources: von Schnering and Nesper 1991, "Nodal surfaces of Fourier series: fundamental invariants of structured
matter"; Gandy et al. 2001, "Nodal surface approximations to the P, G, D and I-WP triply periodic minimal surfaces";
Lidinoid and split P after Lord and Mackay 2003 and the usual formulas of the literature on lattices.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Factor = tuple[str, int] | None
"""Sine or cosine of a multiple of the phase along one axis; None for 1."""


@dataclass(frozen=True)
class Nodal:
    """A sum of `terms` (coefficient, (factor along x, along y, along z)) and a constant.

    `formula` is for people, with X = 2 pi x.
    """

    terms: tuple[tuple[float, tuple[Factor, Factor, Factor]], ...]
    constant: float
    formula: str

    def value(self, x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64]) -> NDArray[np.float64]:
        """The sum at the phases x (nx, 1, 1), y (ny, 1), z (nz,), radians."""
        total = np.full(np.broadcast_shapes(x.shape, y.shape, z.shape), float(self.constant))
        for coefficient, factors in self.terms:
            total += _product(coefficient, factors, (x, y, z), None)
        return total

    def slope(self, x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64]) -> NDArray[np.float64]:
        """Length of the gradient by the phases."""
        squared = np.zeros(np.broadcast_shapes(x.shape, y.shape, z.shape))
        for axis in range(3):
            total = np.zeros_like(squared)
            for coefficient, factors in self.terms:
                if factors[axis] is not None:
                    total += _product(coefficient, factors, (x, y, z), axis)
            squared += total * total
        return np.sqrt(squared)


def _product(
    coefficient: float,
    factors: tuple[Factor, Factor, Factor],
    phases: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
    derived: int | None,
) -> NDArray[np.float64] | float:
    """One term, or its derivative along one axis; z and y, which are short, are multiplied first."""
    made: NDArray[np.float64] | float = coefficient
    for axis in (2, 1, 0):
        factor = factors[axis]
        if factor is None:
            continue
        word, times = factor
        angle = times * phases[axis]
        if axis != derived:
            made = made * (np.sin(angle) if word == "s" else np.cos(angle))
        else:
            made = made * (times * np.cos(angle) if word == "s" else -times * np.sin(angle))
    return made


def _cyclic(coefficient: float, x: Factor, y: Factor, z: Factor) -> list[tuple[float, tuple[Factor, Factor, Factor]]]:
    """A term and the two that follow by x -> y -> z -> x."""
    return [(coefficient, (x, y, z)), (coefficient, (z, x, y)), (coefficient, (y, z, x))]


S, C, S2, C2 = ("s", 1), ("c", 1), ("s", 2), ("c", 2)

SURFACES = {
    "schwarz_p": Nodal((*_cyclic(1, C, None, None),), 0, "cos X + cos Y + cos Z"),
    "gyroid": Nodal((*_cyclic(1, S, C, None),), 0, "sin X cos Y + sin Y cos Z + sin Z cos X"),
    "diamond": Nodal(
        ((1.0, (S, S, S)), *_cyclic(1, S, C, C)),
        0,
        "sin X sin Y sin Z + sin X cos Y cos Z + cos X sin Y cos Z + cos X cos Y sin Z",
    ),
    "iwp": Nodal(
        (*_cyclic(2, C, C, None), *_cyclic(-1, C2, None, None)),
        0,
        "2 (cos X cos Y + cos Y cos Z + cos Z cos X) - (cos 2X + cos 2Y + cos 2Z)",
    ),
    "neovius": Nodal(
        (*_cyclic(3, C, None, None), (4.0, (C, C, C))), 0, "3 (cos X + cos Y + cos Z) + 4 cos X cos Y cos Z"
    ),
    "fischer_koch_s": Nodal(
        (*_cyclic(1, C2, S, C),), 0, "cos 2X sin Y cos Z + cos X cos 2Y sin Z + sin X cos Y cos 2Z"
    ),
    "lidinoid": Nodal(
        (*_cyclic(0.5, S2, C, S), *_cyclic(-0.5, C2, C2, None)),
        0.15,
        "(sin 2X cos Y sin Z + sin X sin 2Y cos Z + cos X sin Y sin 2Z) / 2"
        " - (cos 2X cos 2Y + cos 2Y cos 2Z + cos 2Z cos 2X) / 2 + 0.15",
    ),
    "f_rd": Nodal(
        ((4.0, (C, C, C)), *_cyclic(-1, C2, C2, None)),
        0,
        "4 cos X cos Y cos Z - (cos 2X cos 2Y + cos 2Y cos 2Z + cos 2Z cos 2X)",
    ),
    "split_p": Nodal(
        (*_cyclic(1.1, S2, C, S), *_cyclic(-0.2, C2, C2, None), *_cyclic(-0.4, C2, None, None)),
        0,
        "1.1 (sin 2X cos Y sin Z + sin X sin 2Y cos Z + cos X sin Y sin 2Z)"
        " - 0.2 (cos 2X cos 2Y + cos 2Y cos 2Z + cos 2Z cos 2X) - 0.4 (cos 2X + cos 2Y + cos 2Z)",
    ),
}
"""By name; every one has the period 1 along x, y and z."""
