"""Finite-strain J2 plasticity with isotropic hardening, of many elements at once.

Hyperelastic and elastic-plastic bodies share one law: the multiplicative split of the deformation gradient, a
neo-Hookean elastic part, and radial return (Simo and Hughes, "Computational Inelasticity", box 9.1, with one term
more). A body that does not yield has a yield stress beyond reach.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics import inline_jit

LANES = 32
"""Elements of a block: they have one material, and what is alive of them lies in a scratch array whose rows have a
constant distance, so that the compiler can tell that they never overlap and uses vector instructions."""

NO_YIELD = 1e30
"""A yield stress that is never reached."""

#: Rows of scratch: deformation gradient, first Piola-Kirchhoff stress, and state of the material.
GRADIENT, STRESS = 24, 43
PLASTIC, ALPHA, RATIO = 33, 39, 42
YIELD, HARDENING, STORED, DISSIPATED = 52, 53, 54, 55

_F = tuple(np.uint64(LANES * (GRADIENT + i)) for i in range(9))
_P = tuple(np.uint64(LANES * (STRESS + i)) for i in range(9))
_C = tuple(np.uint64(LANES * (PLASTIC + i)) for i in range(6))
_ALPHA, _RATIO = np.uint64(LANES * ALPHA), np.uint64(LANES * RATIO)
_YIELD, _HARDENING = np.uint64(LANES * YIELD), np.uint64(LANES * HARDENING)
_STORED, _DISSIPATED = np.uint64(LANES * STORED), np.uint64(LANES * DISSIPATED)
_LANES = np.uint64(LANES)
_ROOT = (2 / 3) ** 0.5

RELEASED = 0.02
"""Yield stress, over that where softening begins, and strength that a crack leaves, below which a voxel is released."""

_DECAY = (0.0, 0.25, 0.5, 0.8, 1.2, 1.7, 2.4, 3.2, -math.log(RELEASED))
"""Kinks of the piecewise linear softening: where on the exponential they lie, -ln of the stress. The chords enclose 2 %
more area than the exponential, which their spacing makes up for."""


class Material(NamedTuple):
    """An isotropic material; its yield stress is linear between plastic strains, constant beyond, empty if elastic.

    With a crack band (Bazant and Oh 1983) `fracture` is the work to failure over the volume of a voxel: energy per
    area of a crack over the voxel's edge, in the unit of Young's modulus. Beyond the last plastic strain of the table
    the yield stress then falls exponentially, so that plastic work takes up just this until the voxel is released; an
    infinite one changes nothing. With a `strength` voxels crack where the largest principal stress reaches it.
    """

    young: float
    poisson: float
    yield_stress: tuple[tuple[float, float], ...] = ()
    fracture: float = math.inf
    strength: float = math.inf
    softens: bool = True

    @property
    def curve(self) -> tuple[tuple[float, float], ...]:
        """Table of the yield stress with its softening."""
        if not (self.fails and self.yield_stress):
            return self.yield_stress
        start, peak = self.yield_stress[-1]
        stresses = [math.exp(-x) for x in _DECAY]
        area = sum((b - a) * (s + t) / 2 for (a, b), (s, t) in zip(pairwise(_DECAY), pairwise(stresses), strict=True))
        # from decay lengths to plastic strain
        scale = self.fracture / (peak * area)
        falling = tuple((start + scale * x, peak * s) for x, s in zip(_DECAY, stresses, strict=True))
        return self.yield_stress[:-1] + falling

    @property
    def fails(self) -> bool:
        """Whether plastic flow softens the material until it fails."""
        return self.softens and bool(self.yield_stress) and math.isfinite(self.fracture)

    @property
    def cracks(self) -> bool:
        """Whether it cracks in tension."""
        return math.isfinite(self.strength) and math.isfinite(self.fracture)

    @property
    def failure_strain(self) -> float:
        """Plastic strain at which a voxel is released."""
        return self.curve[-1][0] if self.fails else math.inf

    @property
    def least_fracture(self) -> float:
        """Work to failure over the volume of a voxel below which the stress of a voxel would snap back: it would have
        to fall while the voxel gets longer."""
        limits = [0.0]
        if self.softens and self.yield_stress:
            # a bar of one voxel is stable while its yield stress falls slower than with Young's modulus
            unit = self._replace(fracture=self.yield_stress[-1][1])
            (a, s), (b, t) = unit.curve[len(self.yield_stress) - 1 : len(self.yield_stress) + 1]
            limits.append(unit.fracture * (s - t) / (b - a) / self.young)
        if math.isfinite(self.strength):
            # half of it is elastic energy; what is left falls no steeper than the stress rose
            limits.append(1.5 * self.strength**2 / self.young)
        return max(limits)

    @property
    def lame(self) -> tuple[float, float]:
        """Lamé's constants λ and μ."""
        mu = self.young / (2 + 2 * self.poisson)
        return 2 * mu * self.poisson / (1 - 2 * self.poisson), mu

    @property
    def wave_modulus(self) -> float:
        """λ + 2μ."""
        lam, mu = self.lame
        return lam + 2 * mu


def constants(materials: tuple[Material, ...]) -> NDArray[np.float64]:
    """Constants of each material for the kernels (phases, 5 + 2 n), in units of the first one's Young's modulus.

    λ, μ, bulk modulus, yield stress before any strain, number of kinks, then the strain at each kink of the hardening
    curve, softening included, and by how much its slope rises there.
    """
    kinks = max(1, *(len(m.curve) for m in materials))
    table = np.zeros((len(materials), 5 + 2 * kinks))
    unit = materials[0].young
    for row, m in zip(table, materials, strict=True):
        lam, mu = m.lame
        row[:5] = lam / unit, mu / unit, (lam + 2 * mu / 3) / unit, NO_YIELD, 0
        if m.curve:
            strain, stress = np.array(m.curve, np.float64).T
            slopes = np.concatenate([[0.0], np.diff(stress / unit) / np.diff(strain), [0.0]])
            row[3:5] = stress[0] / unit, len(strain)
            row[5 : 5 + 2 * len(strain)] = np.stack([strain, np.diff(slopes)], axis=1).ravel()
    return table


def failing(materials: tuple[Material, ...]) -> NDArray[np.float64]:
    """Of each material the stress at which it cracks, work to failure per volume, and Young's modulus (phases, 3).

    In units of the first one's Young's modulus; empty (0, 3) if none fails in any way.
    """
    if not any(m.fails or m.cracks for m in materials):
        return np.zeros((0, 3))
    unit = materials[0].young
    return np.array([
        (m.strength / unit if m.cracks else NO_YIELD, min(m.fracture / unit, NO_YIELD), m.young / unit)
        for m in materials
    ])  # fmt: skip


@inline_jit
def yield_stresses(s: NDArray[Any], table: NDArray[Any], phase: Any) -> None:
    """Write yield stress and hardening of a block of elements; `phase` is a row of the table of `constants`."""
    first = table[phase, 3]
    for e in range(_LANES):
        s[e + _YIELD] = first
        s[e + _HARDENING] = 0.0
    for kink in range(int(table[phase, 4])):
        at, slope = table[phase, 5 + 2 * kink], table[phase, 6 + 2 * kink]
        for e in range(_LANES):
            beyond = s[e + _ALPHA] - at
            s[e + _YIELD] += slope * max(beyond, 0.0)
            s[e + _HARDENING] += slope if beyond >= 0.0 else 0.0


@inline_jit
def stresses(s: NDArray[Any], table: NDArray[Any], phase: Any) -> None:
    """First Piola-Kirchhoff stress of a block of elements, whose plastic state is advanced.

    Of the scratch `s` deformation gradient, state and what `yield_stresses` has written are read; stress, state, and
    energies are written: the energy stored and what was dissipated by this step, both per reference volume; also the
    largest stiffness of the element. `phase` is a row of the table of `constants`.
    """
    mu, bulk = table[phase, 1], table[phase, 2]
    wave = table[phase, 0] + 2 * mu
    for e in range(_LANES):
        f00, f01, f02 = s[e + _F[0]], s[e + _F[1]], s[e + _F[2]]
        f10, f11, f12 = s[e + _F[3]], s[e + _F[4]], s[e + _F[5]]
        f20, f21, f22 = s[e + _F[6]], s[e + _F[7]], s[e + _F[8]]
        # cofactors; the inverse is their transpose over J
        k00, k01, k02 = f11 * f22 - f12 * f21, f12 * f20 - f10 * f22, f10 * f21 - f11 * f20
        k10, k11, k12 = f02 * f21 - f01 * f22, f00 * f22 - f02 * f20, f01 * f20 - f00 * f21
        k20, k21, k22 = f01 * f12 - f02 * f11, f02 * f10 - f00 * f12, f00 * f11 - f01 * f10
        j = f00 * k00 + f01 * k01 + f02 * k02
        i = 1.0 / j
        # J^-1/3 by Newton's method; exact to 1e-9 from J = 0.05 on
        r = (2.0 + j) / (1.0 + 2.0 * j)
        r *= (4.0 - j * r * r * r) * (1 / 3)
        r *= (4.0 - j * r * r * r) * (1 / 3)
        r *= (4.0 - j * r * r * r) * (1 / 3)
        r *= (4.0 - j * r * r * r) * (1 / 3)
        r *= (4.0 - j * r * r * r) * (1 / 3)
        r2 = r * r
        # elastic left Cauchy-Green tensor without volume change, xx yy zz yz xz xy
        c0, c1, c2, c3, c4, c5 = s[e + _C[0]], s[e + _C[1]], s[e + _C[2]], s[e + _C[3]], s[e + _C[4]], s[e + _C[5]]
        t00, t01, t02 = f00 * c0 + f01 * c5 + f02 * c4, f00 * c5 + f01 * c1 + f02 * c3, f00 * c4 + f01 * c3 + f02 * c2
        t10, t11, t12 = f10 * c0 + f11 * c5 + f12 * c4, f10 * c5 + f11 * c1 + f12 * c3, f10 * c4 + f11 * c3 + f12 * c2
        t20, t21, t22 = f20 * c0 + f21 * c5 + f22 * c4, f20 * c5 + f21 * c1 + f22 * c3, f20 * c4 + f21 * c3 + f22 * c2
        b0 = r2 * (t00 * f00 + t01 * f01 + t02 * f02)
        b1 = r2 * (t10 * f10 + t11 * f11 + t12 * f12)
        b2 = r2 * (t20 * f20 + t21 * f21 + t22 * f22)
        b3 = r2 * (t10 * f20 + t11 * f21 + t12 * f22)
        b4 = r2 * (t00 * f20 + t01 * f21 + t02 * f22)
        b5 = r2 * (t00 * f10 + t01 * f11 + t02 * f12)
        mean = (b0 + b1 + b2) * (1 / 3)
        s0, s1, s2, s3, s4, s5 = mu * (b0 - mean), mu * (b1 - mean), mu * (b2 - mean), mu * b3, mu * b4, mu * b5
        size = np.sqrt(s0 * s0 + s1 * s1 + s2 * s2 + 2.0 * (s3 * s3 + s4 * s4 + s5 * s5)) + 1e-300
        limit, hardening = s[e + _YIELD], s[e + _HARDENING]
        # what plastic flow takes off the stress: the trace of n b n for the direction n = s / |s|. With that of b / 3,
        # as in box 9.1, the equivalent plastic strain of a cube at 60 % lags the logarithmic one so far that the stress
        # is 2.6 % low; so it is 0.2 %
        odd = s0 * (s1 * s2 - s3 * s3) - s5 * (s5 * s2 - s3 * s4) + s4 * (s5 * s3 - s1 * s4)
        shear = mu * mean + 3.0 * odd / (size * size + 1e-300)
        # one step of the return map is exact for piecewise linear hardening, but for kinks within the step
        flow = max(size - _ROOT * limit, 0.0) / (2.0 * shear + hardening * (2 / 3))
        back = 1.0 - 2.0 * shear * flow / size
        s0, s1, s2, s3, s4, s5 = back * s0, back * s1, back * s2, back * s3, back * s4, back * s5
        s[e + _ALPHA] += _ROOT * flow
        # the returned tensor has lost a little of its determinant, which would let the volume drift
        b0, b1, b2 = s0 / mu + mean, s1 / mu + mean, s2 / mu + mean
        b3, b4, b5 = s3 / mu, s4 / mu, s5 / mu
        det = b0 * (b1 * b2 - b3 * b3) - b5 * (b5 * b2 - b3 * b4) + b4 * (b5 * b3 - b1 * b4)
        q = (2.0 + det) / (1.0 + 2.0 * det)
        q *= (4.0 - det * q * q * q) * (1 / 3)
        q *= (4.0 - det * q * q * q) * (1 / 3)
        b0, b1, b2, b3, b4, b5 = q * b0, q * b1, q * b2, q * b3, q * b4, q * b5
        # what the return takes from the energy, at the final stress
        s[e + _DISSIPATED] = mu * (3.0 * mean - b0 - b1 - b2) * back / (1.0 + back)
        # the slope of K/2 (J + 1/J - 2) times J: without bound as J falls to 0, and without a logarithm
        pressed = bulk * 0.5 * (j - i)
        s[e + _STORED] = mu * (0.5 * (b0 + b1 + b2) - 1.5) + bulk * 0.5 * (j + i - 2.0)
        # inverse of F: rows are columns of the cofactors
        g00, g01, g02 = i * k00, i * k10, i * k20
        g10, g11, g12 = i * k01, i * k11, i * k21
        g20, g21, g22 = i * k02, i * k12, i * k22
        # plastic metric that belongs to the returned tensor: J^2/3 F^-1 b F^-T
        u00, u01, u02 = g00 * b0 + g01 * b5 + g02 * b4, g00 * b5 + g01 * b1 + g02 * b3, g00 * b4 + g01 * b3 + g02 * b2
        u10, u11, u12 = g10 * b0 + g11 * b5 + g12 * b4, g10 * b5 + g11 * b1 + g12 * b3, g10 * b4 + g11 * b3 + g12 * b2
        u20, u21, u22 = g20 * b0 + g21 * b5 + g22 * b4, g20 * b5 + g21 * b1 + g22 * b3, g20 * b4 + g21 * b3 + g22 * b2
        w = 1.0 / r2
        flows = flow > 0.0
        s[e + _C[0]] = w * (u00 * g00 + u01 * g01 + u02 * g02) if flows else c0
        s[e + _C[1]] = w * (u10 * g10 + u11 * g11 + u12 * g12) if flows else c1
        s[e + _C[2]] = w * (u20 * g20 + u21 * g21 + u22 * g22) if flows else c2
        s[e + _C[3]] = w * (u10 * g20 + u11 * g21 + u12 * g22) if flows else c3
        s[e + _C[4]] = w * (u00 * g20 + u01 * g21 + u02 * g22) if flows else c4
        s[e + _C[5]] = w * (u00 * g10 + u01 * g11 + u02 * g12) if flows else c5
        s0, s1, s2 = s0 + pressed, s1 + pressed, s2 + pressed
        s[e + _P[0]] = s0 * g00 + s5 * g01 + s4 * g02
        s[e + _P[1]] = s0 * g10 + s5 * g11 + s4 * g12
        s[e + _P[2]] = s0 * g20 + s5 * g21 + s4 * g22
        s[e + _P[3]] = s5 * g00 + s1 * g01 + s3 * g02
        s[e + _P[4]] = s5 * g10 + s1 * g11 + s3 * g12
        s[e + _P[5]] = s5 * g20 + s1 * g21 + s3 * g22
        s[e + _P[6]] = s4 * g00 + s3 * g01 + s2 * g02
        s[e + _P[7]] = s4 * g10 + s3 * g11 + s2 * g12
        s[e + _P[8]] = s4 * g20 + s3 * g21 + s2 * g22
        # largest curvature of the energy of a brick of its own, over the wave modulus: it bounds the time step. In the
        # direction of F^-T, where the volume changes fastest; `most` is |F^-1 F^-T|^2 / |F^-1|^2, exact at rest and
        # where one direction is crushed
        n = g00 * g00 + g01 * g01 + g02 * g02 + g10 * g10 + g11 * g11 + g12 * g12
        n += g20 * g20 + g21 * g21 + g22 * g22
        most = n - 6.0 / n
        curved = 0.5 * bulk * ((j + i) * n + max(i - j, 0.0) * most)
        s[e + _RATIO] = (curved + mu * mean * (2.0 * most - n * (2 / 3))) / wave
