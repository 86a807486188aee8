"""Proof by Bernstein coefficients, not samples, that a trilinear hexahedron is nowhere inside out.

The determinant of the derivative is a polynomial of degree two along each axis. It lies between the least and the
largest of its 27 Bernstein coefficients, of which those at the corners are its values there (Johnen, Remacle and
Geuzaine 2013). Where the least one is not above a bound and no corner is below it, the hexahedron is halved, upon
which coefficients come nearer to the values, by a factor of four each time that all axes are.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_BETWEEN = np.array([[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]])  # from the values at two ends to those at 0, 1/2 and 1
_COEFFICIENTS = np.array([[1.0, 0.0, 0.0], [-0.5, 2.0, -0.5], [0.0, 0.0, 1.0]])  # from these to those of Bernstein
_HALVES = (
    np.array([[1.0, 0.0, 0.0], [0.5, 0.5, 0.0], [0.25, 0.5, 0.25]]),
    np.array([[0.25, 0.5, 0.25], [0.0, 0.5, 0.5], [0.0, 0.0, 1.0]]),
)

_LEVELS = 30
"""Halvings at most, ten along each axis or more along one. What is undecided then is within some millionths of its
range of the bound, and counts as below.
"""

_MAX_PARTS = 512
"""Parts of a hexahedron that may be undecided at the same time; more are where it is flat along a face."""

_AT_ONCE, _HALVED_AT_ONCE = 4096, 64


def determinant_coefficients(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Bernstein coefficients of the determinant of hexahedra (m, 2, 2, 2, 3), (m, 3, 3, 3) by x, y, z."""
    w = _BETWEEN
    along_x = np.einsum("jb,kc,mbcv->mjkv", w, w, corners[:, 1] - corners[:, 0])[:, None]
    along_y = np.einsum("ia,kc,macv->mikv", w, w, corners[:, :, 1] - corners[:, :, 0])[:, :, None]
    along_z = np.einsum("ia,jb,mabv->mijv", w, w, corners[:, :, :, 1] - corners[:, :, :, 0])[:, :, :, None]
    # 27 values determine a polynomial of degree two along each axis
    values = (along_x * np.cross(along_y, along_z)).sum(axis=-1)
    c = _COEFFICIENTS
    return np.asarray(np.einsum("ia,jb,kc,mabc->mijk", c, c, c, values, optimize=True))


def largest_determinants(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Upper bounds of the determinant of the derivative in hexahedra (m, 2, 2, 2, 3), (m,)."""
    parts = [
        determinant_coefficients(corners[first : first + _AT_ONCE]).max(axis=(1, 2, 3))
        for first in range(0, len(corners), _AT_ONCE)
    ]
    return np.concatenate([np.zeros(0), *parts])


def above_throughout(corners: NDArray[np.float64], bounds: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which hexahedra (m, 2, 2, 2, 3) have a determinant of the derivative above their bound (m,) everywhere; not also
    where it is so close to the bound that a few hundred parts do not decide.
    """
    above = np.ones(len(corners), bool)
    for first in range(0, len(corners), _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        excess = determinant_coefficients(corners[some]) - bounds[some, None, None, None]
        undecided = np.flatnonzero((excess <= 0).any(axis=(1, 2, 3)))
        for begin in range(0, len(undecided), _HALVED_AT_ONCE):
            chosen = undecided[begin : begin + _HALVED_AT_ONCE]
            above[first + chosen] = _positive(excess[chosen])
    return above


def _positive(coefficients: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Test whether polynomials (m, 3, 3, 3) are positive throughout, by halving."""
    positive, owner = np.ones(len(coefficients), bool), np.arange(len(coefficients))
    for level in range(_LEVELS + 1):
        positive[owner[(coefficients[:, ::2, ::2, ::2] <= 0).any(axis=(1, 2, 3))]] = False
        unsure = (coefficients <= 0).any(axis=(1, 2, 3)) & positive[owner]
        positive &= np.bincount(owner[unsure], minlength=len(positive)) <= _MAX_PARTS
        unsure &= positive[owner]
        coefficients, owner = coefficients[unsure], owner[unsure]
        if level == _LEVELS or not len(owner):
            break
        # coefficients differ from values by the second differences: halved is the axis of the largest one
        bent = [np.abs(np.diff(coefficients, 2, axis)).max(axis=(1, 2, 3)) for axis in (1, 2, 3)]
        longest = np.argmax(bent, axis=0)
        halves, owners = [], []
        for axis in range(3):
            own = np.flatnonzero(longest == axis)
            along = np.moveaxis(coefficients[own], 1 + axis, 3)
            halves += [np.moveaxis(along @ half.T, 3, 1 + axis) for half in _HALVES]
            owners += [owner[own]] * 2
        coefficients, owner = np.concatenate(halves), np.concatenate(owners)
    positive[owner] = False
    return positive
