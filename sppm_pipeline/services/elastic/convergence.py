"""Richardson extrapolation over a sequence of grids, and the error bar of the finest."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from sppm_pipeline.services.arrays import F64

ORDERS = (0.5, 4.0)
"""Orders of convergence that are accepted; outside, the grids are too coarse to extrapolate."""

SAFETY = 1.25
"""Roache's factor ("Verification and Validation in Computational Science and Engineering", 1998) for an order that was
observed on three grids; 3 is used for an assumed one."""


class Limit(NamedTuple):
    """An extrapolation to infinitely fine grids.

    Attributes
    ----------
    value : array
        The extrapolated values; those of the finest grid where the grids are too coarse to extrapolate.
    error : array
        Error bar of the finest grid's values.
    order : float
        Observed order of convergence, or the assumed one.
    observed : bool
        Whether three grids agreed on the order.
    """

    value: F64
    error: F64
    order: float
    observed: bool


def richardson(spacings: list[float], values: list[F64], assumed: float = 2.0) -> Limit:
    """Extrapolate over two or three grids.

    The order is that of the change of all values together (its norm), as single entries of a stiffness matrix may be
    zero or change sign.

    Parameters
    ----------
    spacings : list of float
        Two or three, falling.
    values : list of arrays
        One for each grid, of one shape.
    assumed : float
        Order used for two grids.

    References
    ----------
    Roache 1994, "Perspective: a method for uniform reporting of grid refinement studies".
    """
    if len(spacings) != len(values) or len(spacings) not in (2, 3):
        raise ValueError("Richardson's extrapolation takes two or three grids")
    if any(fine >= coarse for coarse, fine in pairwise(spacings)):
        raise ValueError(f"spacings must fall, got {spacings}")
    arrays = [np.asarray(value, np.float64) for value in values]
    order, observed = assumed, False
    if len(values) == 3:
        found = _observed(spacings, arrays)
        if found is not None:
            order, observed = found, True
    change = arrays[-1] - arrays[-2]
    ratio = spacings[-2] / spacings[-1]
    correction = change / (ratio**order - 1)
    error = (SAFETY if observed else 3.0) * np.abs(correction)
    if len(values) == 3 and not observed:
        # the changes do not shrink as those of a convergent sequence: no limit is claimed
        return Limit(arrays[-1], np.maximum(3 * np.abs(change), error), order, False)
    return Limit(arrays[-1] + correction, error, order, observed)


def _observed(spacings: list[float], values: list[F64]) -> float | None:
    """The order at which the changes shrink, by bisection; None outside `ORDERS`."""
    first, second = (float(np.linalg.norm(b - a)) for a, b in pairwise(values))
    if not (first > 0 and second > 0):
        return None
    coarse, middle, fine = spacings

    def excess(order: float) -> float:
        return float(first / second - (coarse**order - middle**order) / (middle**order - fine**order))

    low, high = ORDERS
    if excess(low) * excess(high) > 0:
        return None
    for _ in range(60):
        half = (low + high) / 2
        low, high = (half, high) if excess(low) * excess(half) > 0 else (low, half)
    return (low + high) / 2
