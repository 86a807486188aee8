"""Voigt and Mandel matrices, the tensor of fourth rank, rotation, and compliance."""

from __future__ import annotations

from typing import Any

import numpy as np

from sppm_pipeline.services.arrays import F64

PAIRS = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))
"""Tensor indices of the Voigt indices."""

# Mandel's notation: with shear entries times sqrt(2), the product of 6-vectors is that of the tensors
_ROOT2 = np.sqrt(2.0)
_WEIGHT = np.array([1, 1, 1, _ROOT2, _ROOT2, _ROOT2])

SOFT = 1e-7
"""Eigenvalues below this fraction of the largest count as zero stiffness: less than what solvers in single precision
leave of a mechanism, far more than rounding."""


def isotropic(young: float, poisson: float) -> F64:
    """The stiffness of an isotropic material, (6, 6).

    Parameters
    ----------
    young : float
        Young's modulus; the result has its unit.
    poisson : float
        Poisson's ratio, between -1 and 0.5.
    """
    lam, mu = lame(young, poisson)
    return from_lame(lam, mu)


def lame(young: Any, poisson: Any) -> tuple[Any, Any]:
    """Lamé's constants λ and μ from Young's modulus and Poisson's ratio, scalars or arrays."""
    return young * poisson / ((1 + poisson) * (1 - 2 * poisson)), young / (2 * (1 + poisson))


def from_lame(lam: float, mu: float) -> F64:
    """The isotropic stiffness with Lamé's constants λ and μ, (6, 6)."""
    matrix = np.zeros((6, 6))
    matrix[:3, :3] = lam
    matrix[range(6), range(6)] += [2 * mu] * 3 + [mu] * 3
    return matrix


def mandel(stiffness: F64) -> F64:
    """The same in Mandel's basis, which is orthonormal: eigenvalues and norms are those of the tensor, (6, 6)."""
    return np.asarray(stiffness, np.float64) * np.outer(_WEIGHT, _WEIGHT)


def tensor(stiffness: F64) -> F64:
    """The tensor of fourth rank, (3, 3, 3, 3)."""
    full = np.empty((3, 3, 3, 3))
    for row, (i, j) in enumerate(PAIRS):
        for column, (k, m) in enumerate(PAIRS):
            value = stiffness[row, column]
            for a, b in ((i, j), (j, i)):
                for c, d in ((k, m), (m, k)):
                    full[a, b, c, d] = value
    return full


def from_tensor(full: F64) -> F64:
    """The Voigt matrix of a tensor of fourth rank with the minor symmetries, (6, 6)."""
    return np.array([[full[i, j, k, m] for k, m in PAIRS] for i, j in PAIRS])


def rotated(stiffness: F64, rotation: F64) -> F64:
    """The stiffness of a body that was turned by `rotation`, (6, 6).

    Parameters
    ----------
    stiffness : (6, 6)
    rotation : (3, 3)
        Orthogonal; takes a vector of the body to where it points afterwards.
    """
    return from_tensor(np.einsum("ai,bj,ck,dm,ijkm->abcd", rotation, rotation, rotation, rotation, tensor(stiffness)))


def null_space(stiffness: F64, soft: float = SOFT) -> tuple[F64, F64]:
    """Eigenvalues and eigenvectors in Mandel's basis; those that count as zero are exactly zero.

    Returns
    -------
    (6,) and (6, 6) float64
        Ascending; eigenvectors are columns.
    """
    symmetric = mandel(stiffness)
    values, vectors = np.linalg.eigh((symmetric + symmetric.T) / 2)
    return np.where(values > soft * max(values[-1], 0.0), values, 0.0), vectors


def compliance(stiffness: F64) -> F64:
    """The compliance in Voigt's notation, (6, 6); infinite entries where the structure has no stiffness are left out.

    That is the pseudo-inverse in Mandel's basis: strains that meet no resistance are not counted.
    """
    values, vectors = null_space(stiffness)
    inverse = np.divide(1.0, values, out=np.zeros(6), where=values > 0)
    full: F64 = (vectors * inverse) @ vectors.T * np.outer(_WEIGHT, _WEIGHT)
    return full


def engineering_constants(stiffness: F64) -> dict[str, F64]:
    """Moduli and Poisson's ratios along the axes.

    Returns
    -------
    dict
        ``E`` (3,) along x, y, z; ``G`` (3,) for yz, xz, xy; ``nu`` (3, 3), whose entry ij is the contraction along j
        when pulled along i; the diagonal is NaN, as is a row without resistance. A direction without
        stiffness has modulus 0.
    """
    values, vectors = null_space(stiffness)
    stiff = values > 0
    # a stress that has a part along a strain without resistance can't be carried
    loose = (vectors[:, ~stiff] ** 2).sum(axis=1) > 1e-6
    flexibility = compliance(stiffness)
    diagonal = np.diag(flexibility)
    moduli = np.divide(1.0, diagonal, out=np.zeros(6), where=~loose & (diagonal > 0))
    poisson = np.full((3, 3), np.nan)
    for i in range(3):
        for j in range(3):
            if i != j and moduli[i] > 0:
                poisson[i, j] = -flexibility[j, i] * moduli[i]
    return {"E": moduli[:3], "G": moduli[3:], "nu": poisson}
