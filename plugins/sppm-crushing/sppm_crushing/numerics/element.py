"""Trilinear bricks at large strains: one-point integration with the hourglass stiffness of full integration.

The corners of a brick enter through their Walsh-Hadamard modes, sums and differences alone. Three modes are the mean
deformation gradient, which the material sees. The other four bend and twist the brick; their energy is that of the part
of the Green strain that they add, integrated exactly, so that the tangent at rest is the stiffness of a fully
integrated brick, the one `homogenize.voxel` uses. As that strain is turned back by the mean deformation gradient, no
rotation has to be found. Where the material flows, bending yields, too: by a secant stiffness.

Corner a of a voxel lies on its low side along x, y, z where bit 0, 1, 2 of a is set, which makes the transform its own
transpose.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_crushing.numerics.material import (
    ALPHA,
    DISSIPATED,
    HARDENING,
    LANES,
    PLASTIC,
    RELEASED,
    STORED,
    YIELD,
    stresses,
    yield_stresses,
)
from sppm_pipeline.numerics import inline_jit, jit

#: Rows of scratch: 24 of corners or modes, 9 deformation gradient, 10 state, 9 stress, yield stress, hardening,
#: energies stored and dissipated, bending energy, its work in this step, 12 generalized forces of bending, strain,
#: bound of the largest principal stress, or plastic strain before the step.
ROWS = 72
STATE = 10
"""Numbers kept of an element: 6 of the plastic metric, equivalent plastic strain, energy of bending were it elastic,
the share of its stiffness, and the largest stiffness of the element."""

_BENT, _SHARE, _WORK, _BOUND = 40, 41, 57, 71
_LANES = np.uint64(LANES)
_R = tuple(np.uint64(LANES * row) for row in range(ROWS))
_8 = np.uint64(8 * LANES)

TAKEN = 1 - RELEASED
"""Share of the work to failure that a crack takes up until its voxel is released."""

#: What `forces` adds up for each slab: energy stored in the mean strain and in bending, dissipated by plastic flow,
#: work of bending.
SUMS = 4


@inline_jit
def _transform(s: NDArray[Any]) -> None:
    """Walsh-Hadamard transform of the eight rows of each component, in place."""
    for c in range(3):
        o = np.uint64(c) * _8
        for e in range(o, o + _LANES):
            a0, a1, a2, a3 = s[e], s[e + _R[1]], s[e + _R[2]], s[e + _R[3]]
            a4, a5, a6, a7 = s[e + _R[4]], s[e + _R[5]], s[e + _R[6]], s[e + _R[7]]
            b0, b1, b2, b3 = a0 + a1, a0 - a1, a2 + a3, a2 - a3
            b4, b5, b6, b7 = a4 + a5, a4 - a5, a6 + a7, a6 - a7
            a0, a1, a2, a3 = b0 + b2, b1 + b3, b0 - b2, b1 - b3
            a4, a5, a6, a7 = b4 + b6, b5 + b7, b4 - b6, b5 - b7
            s[e], s[e + _R[1]], s[e + _R[2]], s[e + _R[3]] = a0 + a4, a1 + a5, a2 + a6, a3 + a7
            s[e + _R[4]], s[e + _R[5]], s[e + _R[6]], s[e + _R[7]] = a0 - a4, a1 - a5, a2 - a6, a3 - a7


@inline_jit
def _bend(s: NDArray[Any], lam: Any, mu: Any) -> None:
    """Mean deformation gradient, and the forces of elastic bending; d110x is along x of the mode of ξη, turned back."""
    a, b = 1 / 48, 1 / 144
    for e in range(_LANES):
        xx, xy, xz = 0.25 * s[e + _R[1]], 0.25 * s[e + _R[2]], 0.25 * s[e + _R[4]]
        yx, yy, yz = 0.25 * s[e + _R[9]], 0.25 * s[e + _R[10]], 0.25 * s[e + _R[12]]
        zx, zy, zz = 0.25 * s[e + _R[17]], 0.25 * s[e + _R[18]], 0.25 * s[e + _R[20]]
        s[e + _R[24]], s[e + _R[25]], s[e + _R[26]] = xx, xy, xz
        s[e + _R[27]], s[e + _R[28]], s[e + _R[29]] = yx, yy, yz
        s[e + _R[30]], s[e + _R[31]], s[e + _R[32]] = zx, zy, zz
        x, y, z = s[e + _R[3]], s[e + _R[11]], s[e + _R[19]]
        d110x, d110y, d110z = xx * x + yx * y + zx * z, xy * x + yy * y + zy * z, xz * x + yz * y + zz * z
        x, y, z = s[e + _R[5]], s[e + _R[13]], s[e + _R[21]]
        d101x, d101y, d101z = xx * x + yx * y + zx * z, xy * x + yy * y + zy * z, xz * x + yz * y + zz * z
        x, y, z = s[e + _R[6]], s[e + _R[14]], s[e + _R[22]]
        d011x, d011y, d011z = xx * x + yx * y + zx * z, xy * x + yy * y + zy * z, xz * x + yz * y + zz * z
        x, y, z = s[e + _R[7]], s[e + _R[15]], s[e + _R[23]]
        d111x, d111y, d111z = xx * x + yx * y + zx * z, xy * x + yy * y + zy * z, xz * x + yz * y + zz * z
        # strains along the axes that vary together, and shears
        vx, vy, vz = d110y + d101z, d110x + d011z, d101x + d011y
        gz, gy, gx = d101y + d011x, d110z + d011x, d110z + d101y
        p110x, p110y = a * (lam * vy + 3 * mu * d110x), a * (lam * vx + 3 * mu * d110y)
        p101x, p101z = a * (lam * vz + 3 * mu * d101x), a * (lam * vx + 3 * mu * d101z)
        p011y, p011z = a * (lam * vz + 3 * mu * d011y), a * (lam * vy + 3 * mu * d011z)
        p110z, p101y, p011x = a * mu * (gy + gx), a * mu * (gz + gx), a * mu * (gz + gy)
        k = b * (lam + 4 * mu)
        s[e + _R[58]], s[e + _R[59]], s[e + _R[60]] = p110x, p110y, p110z
        s[e + _R[61]], s[e + _R[62]], s[e + _R[63]] = p101x, p101y, p101z
        s[e + _R[64]], s[e + _R[65]], s[e + _R[66]] = p011x, p011y, p011z
        s[e + _R[67]], s[e + _R[68]], s[e + _R[69]] = k * d111x, k * d111y, k * d111z
        energy = p110x * d110x + p110y * d110y + p110z * d110z + p101x * d101x + p101y * d101y + p101z * d101z
        cubic = d111x * d111x + d111y * d111y + d111z * d111z
        energy += p011x * d011x + p011y * d011y + p011z * d011z + k * cubic
        s[e + _R[56]] = 0.5 * energy
        # 2 mu <E:E> is the energy without its volumetric part
        energy -= lam * (a * (vx * vx + vy * vy + vz * vz) + b * cubic)
        s[e + _R[70]] = energy / (2 * mu)


@inline_jit
def _push(s: NDArray[Any], mu: Any) -> None:
    """Forces on the modes, and the work of bending."""
    for e in range(_LANES):
        limit = s[e + _R[YIELD]]
        strain = np.sqrt((2 / 3) * max(s[e + _R[70]], 0.0))
        # secant stiffness: what the accumulated plastic strain leaves, and no more stress than the yield stress
        share = min(limit / (limit + 3 * mu * s[e + _R[ALPHA]]), limit / (3 * mu * strain + 1e-30))
        s[e + _R[57]] = 0.5 * (share + s[e + _R[41]]) * (s[e + _R[56]] - s[e + _R[40]])
        s[e + _R[40]], s[e + _R[41]] = s[e + _R[56]], share
        xx, xy, xz = s[e + _R[24]], s[e + _R[25]], s[e + _R[26]]
        yx, yy, yz = s[e + _R[27]], s[e + _R[28]], s[e + _R[29]]
        zx, zy, zz = s[e + _R[30]], s[e + _R[31]], s[e + _R[32]]
        ax, ay, az = share * s[e + _R[58]], share * s[e + _R[59]], share * s[e + _R[60]]
        bx, by, bz = share * s[e + _R[61]], share * s[e + _R[62]], share * s[e + _R[63]]
        cx, cy, cz = share * s[e + _R[64]], share * s[e + _R[65]], share * s[e + _R[66]]
        dx, dy, dz = share * s[e + _R[67]], share * s[e + _R[68]], share * s[e + _R[69]]
        for c in range(3):
            o = np.uint64(c) * _8
            q = np.uint64(3 * c) * _LANES
            k, m, n, p = s[e + o + _R[3]], s[e + o + _R[5]], s[e + o + _R[6]], s[e + o + _R[7]]
            s[e + o + _R[1]] = 0.25 * (s[e + q + _R[43]] + k * ax + m * bx + n * cx + p * dx)
            s[e + o + _R[2]] = 0.25 * (s[e + q + _R[44]] + k * ay + m * by + n * cy + p * dy)
            s[e + o + _R[4]] = 0.25 * (s[e + q + _R[45]] + k * az + m * bz + n * cz + p * dz)
        s[e], s[e + _R[8]], s[e + _R[16]] = 0.0, 0.0, 0.0
        s[e + _R[3]], s[e + _R[11]] = xx * ax + xy * ay + xz * az, yx * ax + yy * ay + yz * az
        s[e + _R[19]] = zx * ax + zy * ay + zz * az
        s[e + _R[5]], s[e + _R[13]] = xx * bx + xy * by + xz * bz, yx * bx + yy * by + yz * bz
        s[e + _R[21]] = zx * bx + zy * by + zz * bz
        s[e + _R[6]], s[e + _R[14]] = xx * cx + xy * cy + xz * cz, yx * cx + yy * cy + yz * cz
        s[e + _R[22]] = zx * cx + zy * cy + zz * cz
        s[e + _R[7]], s[e + _R[15]] = xx * dx + xy * dy + xz * dz, yx * dx + yy * dy + yz * dz
        s[e + _R[23]] = zx * dx + zy * dy + zz * dz


@inline_jit
def _bound(s: NDArray[Any]) -> None:
    """Upper bound of the largest principal Kirchhoff stress."""
    for e in range(_LANES):
        xx = s[e + _R[43]] * s[e + _R[24]] + s[e + _R[44]] * s[e + _R[25]] + s[e + _R[45]] * s[e + _R[26]]
        yy = s[e + _R[46]] * s[e + _R[27]] + s[e + _R[47]] * s[e + _R[28]] + s[e + _R[48]] * s[e + _R[29]]
        zz = s[e + _R[49]] * s[e + _R[30]] + s[e + _R[50]] * s[e + _R[31]] + s[e + _R[51]] * s[e + _R[32]]
        xy = s[e + _R[43]] * s[e + _R[27]] + s[e + _R[44]] * s[e + _R[28]] + s[e + _R[45]] * s[e + _R[29]]
        xz = s[e + _R[43]] * s[e + _R[30]] + s[e + _R[44]] * s[e + _R[31]] + s[e + _R[45]] * s[e + _R[32]]
        yz = s[e + _R[46]] * s[e + _R[30]] + s[e + _R[47]] * s[e + _R[31]] + s[e + _R[48]] * s[e + _R[32]]
        mean = (xx + yy + zz) * (1 / 3)
        xx, yy, zz = xx - mean, yy - mean, zz - mean
        square = xx * xx + yy * yy + zz * zz + 2.0 * (xy * xy + xz * xz + yz * yz)
        s[e + _R[_BOUND]] = mean + np.sqrt((2 / 3) * square)


@jit
def _principal(s: NDArray[Any], e: Any) -> Any:
    """Largest principal Kirchhoff stress of an element."""
    xx = s[e + _R[43]] * s[e + _R[24]] + s[e + _R[44]] * s[e + _R[25]] + s[e + _R[45]] * s[e + _R[26]]
    yy = s[e + _R[46]] * s[e + _R[27]] + s[e + _R[47]] * s[e + _R[28]] + s[e + _R[48]] * s[e + _R[29]]
    zz = s[e + _R[49]] * s[e + _R[30]] + s[e + _R[50]] * s[e + _R[31]] + s[e + _R[51]] * s[e + _R[32]]
    xy = s[e + _R[43]] * s[e + _R[27]] + s[e + _R[44]] * s[e + _R[28]] + s[e + _R[45]] * s[e + _R[29]]
    xz = s[e + _R[43]] * s[e + _R[30]] + s[e + _R[44]] * s[e + _R[31]] + s[e + _R[45]] * s[e + _R[32]]
    yz = s[e + _R[46]] * s[e + _R[30]] + s[e + _R[47]] * s[e + _R[31]] + s[e + _R[48]] * s[e + _R[32]]
    mean = (xx + yy + zz) / 3
    xx, yy, zz = xx - mean, yy - mean, zz - mean
    second = 0.5 * (xx * xx + yy * yy + zz * zz) + xy * xy + xz * xz + yz * yz
    third = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
    root = np.sqrt(second / 3) + 1e-300
    angle = np.arccos(min(max(third / (2 * root * root * root), -1.0), 1.0)) / 3
    return mean + 2 * root * np.cos(angle)


@inline_jit
def _crack(s: NDArray[Any], own: NDArray[Any], strength: float, fracture: float, young: float) -> None:
    """Weaken cracked elements: isotropic damage, which the largest principal effective stress (Rankine) lets grow.

    Damage follows the root of the stored energy, as a stress; so it takes up the work to failure, `fracture` per
    volume, in any state of stress. `own` (4, LANES) has that stress where a crack began, the largest so far, the
    damage, and that stress one step ago.
    """
    _bound(s)
    for e in range(_LANES):
        # elastic energies of the mean strain and of bending
        energy = s[e + _R[STORED]] + s[e + _R[_SHARE]] * s[e + _R[56]]
        driving = np.sqrt(2 * young * max(energy, 0.0))
        if s[e + _R[_BOUND]] > strength and driving > own[1, e] and _principal(s, e) > strength:
            if own[0, e] == 0:
                own[0, e] = own[1, e] = driving
            first = own[0, e]
            begun = first * first / (2 * young)
            # no steeper than it rose: else the stress would snap back
            decay = TAKEN * first / (young * max(fracture - begun, 2 * begun))
            damage = 1 - first / driving * np.exp(-decay * (driving - first))
            # forces before and after, over the way between, dissipate by the geometric mean of the energies
            s[e + _R[DISSIPATED]] += (damage - own[2, e]) * driving * own[3, e] / (2 * young)
            own[1, e], own[2, e] = driving, damage
        own[3, e] = driving
        left = 1 - own[2, e]
        if left < 1:
            s[e + _R[STORED]] *= left
            s[e + _R[56]] *= left
            for row in range(9):
                s[e + _R[43] + np.uint64(row) * _LANES] *= left
            for row in range(12):
                s[e + _R[58] + np.uint64(row) * _LANES] *= left


@jit
def forces(
    x: NDArray[Any], corners: NDArray[Any], phases: NDArray[Any], slabs: NDArray[Any], first: int, last: int,
    table: NDArray[Any], state: NDArray[Any], surface: NDArray[Any], pushed: NDArray[Any], push: NDArray[Any],
    s: NDArray[Any], f: NDArray[Any], sums: NDArray[Any], failing: NDArray[Any], cracks: NDArray[Any],
) -> None:  # fmt: skip
    """Add the forces of every second slab of elements to those of the nodes, and advance the elements' state.

    Slabs first, first + 2, ... below last: those of the same parity share no nodes, so that threads may work on them
    at once, and sums don't depend on which thread does what. `x` and `f` are (nodes, 3), `corners` (blocks, LANES, 8)
    nodes of the elements, -1 where a block has none, `phases` (blocks,) rows of `table` (`material.constants`),
    `slabs` (slabs + 1,) where the blocks of each begin. `state` (blocks, STATE, LANES) is advanced in place. `surface`
    (blocks, LANES) numbers voxels at the surface, or is -1; of these `pushed` says which are in contact, and `push`
    (voxels, 8, 3) has the forces on their corners. `s` (ROWS * LANES,) is scratch. Of `sums` (slabs, SUMS) the
    energies stored are set; what was dissipated, and the work of bending, are added to. `failing` is
    `material.failing`, empty if nothing fails; `cracks` (blocks, 4, LANES) is that of `_crack`, advanced in
    place, empty if nothing cracks.
    """
    fails, cracked = len(failing) > 0, len(cracks) > 0
    for slab in range(first, last, 2):
        stored, bent, dissipated, bending = 0.0, 0.0, 0.0, 0.0
        for block in range(slabs[slab], slabs[slab + 1]):
            width = 0
            for e in range(LANES):
                if corners[block, e, 0] < 0:
                    break
                width += 1
                for a in range(8):
                    n = corners[block, e, a]
                    for c in range(3):
                        s[(8 * c + a) * LANES + e] = x[n, c]
            # empty lanes hold a brick at rest
            for e in range(width, LANES):
                for a in range(8):
                    for c in range(3):
                        s[(8 * c + a) * LANES + e] = 1.0 - ((a >> c) & 1)
            own = state[block]
            for row in range(STATE):
                for e in range(LANES):
                    s[(PLASTIC + row) * LANES + e] = own[row, e]
            phase = phases[block]
            _transform(s)
            _bend(s, table[phase, 0], table[phase, 1])
            yield_stresses(s, table, phase)
            if cracked:
                # what has cracked flows no more: else plastic flow would hold its effective stress
                for e in range(LANES):
                    if cracks[block, 2, e] > 0:
                        s[YIELD * LANES + e] *= 1e30
            if fails:
                for e in range(LANES):
                    s[_BOUND * LANES + e] = s[ALPHA * LANES + e]
            stresses(s, table, phase)
            if fails:
                # flow dissipates by the mean of the stresses before and after; in a voxel that fails they differ
                for e in range(LANES):
                    flow = s[ALPHA * LANES + e] - s[_BOUND * LANES + e]
                    s[DISSIPATED * LANES + e] -= 0.5 * s[HARDENING * LANES + e] * flow * flow
            if cracked:
                for e in range(LANES):
                    if cracks[block, 2, e] > 0:
                        s[YIELD * LANES + e] *= 1e-30
                _crack(s, cracks[block], failing[phase, 0], failing[phase, 1], failing[phase, 2])
            _push(s, table[phase, 1])
            _transform(s)
            for row in range(STATE):
                for e in range(LANES):
                    own[row, e] = s[(PLASTIC + row) * LANES + e]
            for e in range(width):
                bent += s[_BENT * LANES + e] * s[_SHARE * LANES + e]
                stored += s[STORED * LANES + e]
                dissipated += s[DISSIPATED * LANES + e]
                bending += s[_WORK * LANES + e]
                for a in range(8):
                    n = corners[block, e, a]
                    for c in range(3):
                        f[n, c] -= s[(8 * c + a) * LANES + e]
                at = surface[block, e]
                if at >= 0 and pushed[at]:
                    for a in range(8):
                        n = corners[block, e, a]
                        for c in range(3):
                            f[n, c] += push[at, a, c]
        sums[slab, 0] = stored
        sums[slab, 1] = bent
        sums[slab, 2] += dissipated
        sums[slab, 3] += bending
