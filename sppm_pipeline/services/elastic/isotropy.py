"""Distance of a stiffness from isotropy: the paper's deviation, and measures that do not depend on the frame."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sppm_pipeline.services.arrays import F64
from sppm_pipeline.services.elastic.voigt import from_lame, mandel, null_space


class IsotropicFit(NamedTuple):
    """The isotropic material nearest to a stiffness.

    Attributes
    ----------
    young, poisson : float
        NaN for Poisson's ratio of a structure without stiffness.
    deviation : float
        Squared distance (the paper's xi for its norm), stiffness^2.
    relative : float
        Distance over the norm of the stiffness, between 0 and 1; 0 without stiffness.
    """

    young: float
    poisson: float
    deviation: float
    relative: float


class Averages(NamedTuple):
    """Bulk and shear moduli of a polycrystal of the material: upper (Voigt), lower (Reuss), and their mean (Hill)."""

    bulk_voigt: float
    bulk_reuss: float
    shear_voigt: float
    shear_reuss: float

    @property
    def bulk_hill(self) -> float:
        return (self.bulk_voigt + self.bulk_reuss) / 2

    @property
    def shear_hill(self) -> float:
        return (self.shear_voigt + self.shear_reuss) / 2


def _means(stiffness: F64) -> tuple[float, float, float]:
    """Means of the longitudinal, the transverse and the shear entries."""
    a = float(np.trace(stiffness[:3, :3])) / 3
    b = float(stiffness[0, 1] + stiffness[0, 2] + stiffness[1, 2]) / 3
    c = float(np.trace(stiffness[3:, 3:])) / 3
    return a, b, c


def nearest_isotropic(stiffness: F64, norm: str = "paper") -> IsotropicFit:
    """The isotropic material nearest to `stiffness`.

    Both norms lead to a linear least-squares problem in the Lamé constants, so the minimum is exact. For a stiffness
    that some material below the bound of Voigt has, the constraints of the paper (0 < E < E_M, -1 < nu < 0.5) never
    bind.

    Parameters
    ----------
    stiffness : (6, 6)
        Voigt, symmetric.
    norm : {"paper", "tensor"}
        "paper": the Frobenius norm of the Voigt matrix (section 3.2), under which the deviation of one structure
        changes as it is turned. "tensor": that of the tensor, which does not.

    References
    ----------
    The paper, section 3.2; Martínez et al. 2016.
    """
    a, b, c = _means(stiffness)
    # where both derivatives of the squared distance vanish, by the bulk and by the shear modulus
    bulk = (a + 2 * b) / 3
    if norm == "paper":
        shear = (4 * (a - b) + 3 * c) / 11
    elif norm == "tensor":
        shear = (a - b + 3 * c) / 5
    else:
        raise ValueError(f"norm is 'paper' or 'tensor', got {norm!r}")

    def length(matrix: F64) -> float:
        return float(np.linalg.norm(matrix if norm == "paper" else mandel(matrix)))

    size = length(stiffness)
    if size == 0 or 3 * bulk + shear <= 0:
        return IsotropicFit(0.0, float("nan"), size**2, float(size > 0))
    young = 9 * bulk * shear / (3 * bulk + shear)
    poisson = (3 * bulk - 2 * shear) / (2 * (3 * bulk + shear))
    distance = length(from_lame(bulk - 2 * shear / 3, shear) - stiffness)
    return IsotropicFit(young, poisson, distance**2, distance / size)


def averages(stiffness: F64) -> Averages:
    """Bulk and shear moduli averaged over all orientations.

    The lower averages of a structure without stiffness in some direction are 0.

    References
    ----------
    Hill 1952, "The elastic behavior of a crystalline aggregate".
    """
    a, b, c = _means(stiffness)
    values, vectors = null_space(stiffness)
    bulk_reuss = shear_reuss = 0.0
    hydrostatic = np.array([1, 1, 1, 0, 0, 0]) / np.sqrt(3)
    along = (vectors.T @ hydrostatic) ** 2
    if not along[values == 0].sum() > 1e-6:
        stiff = values > 0
        flexible = float((along[stiff] / values[stiff]).sum())
        bulk_reuss = 1 / (3 * flexible) if flexible > 0 else 0.0
        if stiff.all():
            # the trace of the compliance less its hydrostatic part is that of the five deviators
            shear_reuss = 5 / (2 * (float((1 / values).sum()) - flexible))
    return Averages((a + 2 * b) / 3, bulk_reuss, (a - b + 3 * c) / 5, shear_reuss)


def universal_anisotropy(stiffness: F64) -> float:
    """Universal anisotropy index, 0 for isotropy, infinite if a direction has no stiffness.

    References
    ----------
    Ranganathan and Ostoja-Starzewski 2008, "Universal elastic anisotropy index".
    """
    mean = averages(stiffness)
    if not (mean.bulk_reuss > 0 and mean.shear_reuss > 0):
        return float("inf")
    return 5 * mean.shear_voigt / mean.shear_reuss + mean.bulk_voigt / mean.bulk_reuss - 6


def log_euclidean(stiffness: F64) -> float:
    """Log-Euclidean anisotropy index, 0 for isotropy, infinite if a direction has no stiffness.

    References
    ----------
    Kube 2016, "Elastic anisotropy of crystals".
    """
    mean = averages(stiffness)
    if not (mean.bulk_reuss > 0 and mean.shear_reuss > 0):
        return float("inf")
    bulk, shear = np.log(mean.bulk_voigt / mean.bulk_reuss), np.log(mean.shear_voigt / mean.shear_reuss)
    return float(np.sqrt(bulk**2 + 5 * shear**2))


def zener(stiffness: F64) -> tuple[float, float]:
    """Zener's ratio 2 C44 / (C11 - C12) of the means of the entries, and how far the structure is from cubic.

    Returns
    -------
    ratio : float
        1 for isotropy; means something only if the second number is small. NaN if C11 equals C12.
    distance : float
        Norm of what cubic symmetry about the axes forbids over the norm of the stiffness (of the tensor).
    """
    a, b, c = _means(stiffness)
    cubic = np.zeros((6, 6))
    cubic[:3, :3] = b
    cubic[range(6), range(6)] = [a] * 3 + [c] * 3
    size = float(np.linalg.norm(mandel(stiffness)))
    distance = float(np.linalg.norm(mandel(stiffness - cubic))) / size if size else 0.0
    return (2 * c / (a - b) if a != b else float("nan")), distance
