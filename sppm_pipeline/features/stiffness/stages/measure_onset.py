"""``measure.onset``: the stress at which a share of the solid begins to yield."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import ConfigError, Context, DesignError, Headline, ScalarField, Table, Voxels, option, options
from sppm_pipeline.features.stiffness.numerics.elasticity import Homogenized
from sppm_pipeline.features.stiffness.stages.homogenize_voxel import ElasticCell
from sppm_pipeline.method.families.homogenizer import per_phase
from sppm_pipeline.services.arrays import F32, F64
from sppm_pipeline.services.elastic.loaded import brick_strains
from sppm_pipeline.services.jit.compiled import jit

_LOADED = 1e-3
"""Stress that may be left over, over that applied, where a cell bears it: else it has no load path."""


def uniaxial_strain(stiffness: F64, axis: int) -> F64 | None:
    """Mean strain (6,) of a mean stress of 1 along `axis` alone; None if the cell has no load path along it."""
    stress = np.eye(6)[axis]
    strain = np.linalg.lstsq(stiffness, stress, rcond=1e-9)[0]
    left = float(np.abs(stiffness @ strain - stress).max())
    return np.asarray(strain) if left < _LOADED else None


def stress_ratios(found: Homogenized, strain: F64, modulus: NDArray[Any], edges: tuple[float, float, float]) -> F32:
    """Von Mises stress over yield stress at the eight Gauss points of each solid voxel (solid voxels, 8).

    Of the fields of `found` under a mean `strain` (6,), engineering shear; `modulus` (nz, ny, nx) is the shear modulus
    of the solid of each voxel over its yield stress, 0 where nothing yields, and `edges` (hx, hy, hz) are a voxel's.
    """
    u = np.zeros((3, *modulus.shape), np.float32)
    for part, (packed, step) in zip(strain, found.fields, strict=True):
        u += np.float32(part * step) * packed.reshape(u.shape)
    # displacements are in the unit of the longest edge
    h = np.array(edges, np.float64) / max(edges)
    x, y, z = np.array([(i, j, k) for k in (-1, 1) for j in (-1, 1) for i in (-1, 1)]).T / np.sqrt(3)
    monomials = np.stack([np.ones(8), x, y, z, x * y, x * z, y * z])
    strains = np.einsum("mg,mrn->grn", monomials, brick_strains((h[0], h[1], h[2]))[0])
    out = np.empty((np.count_nonzero(modulus), 8), np.float32)
    _stresses(u, strain, np.ascontiguousarray(modulus, np.float64), strains, out)
    return out


@jit
def _stresses(
    u: NDArray[Any], strain: NDArray[Any], modulus: NDArray[Any], strains: NDArray[Any], out: NDArray[Any]
) -> None:
    """Write von Mises stresses; `strains` (8, 6, 24) are those at each Gauss point of the displacements of corners."""
    nz, ny, nx = modulus.shape
    v, e = np.empty(24), np.empty(6)
    at = 0
    for k in range(nz):
        for j in range(ny):
            for i in range(nx):
                mu = modulus[k, j, i]
                if mu == 0.0:
                    continue
                for a in range(8):
                    z, y, x = (k + (a >> 2)) % nz, (j + (a >> 1 & 1)) % ny, (i + (a & 1)) % nx
                    for c in range(3):
                        v[3 * a + c] = u[c, z, y, x]
                for g in range(8):
                    for r in range(6):
                        e[r] = strain[r]
                        for n in range(24):
                            e[r] += strains[g, r, n] * v[n]
                    shear = 0.75 * (e[3] ** 2 + e[4] ** 2 + e[5] ** 2)
                    normal = 0.5 * ((e[0] - e[1]) ** 2 + (e[1] - e[2]) ** 2 + (e[2] - e[0]) ** 2)
                    # the square of von Mises stress is 3 J2, with deviatoric stress 2 mu times deviatoric strain
                    out[at, g] = 2 * mu * np.sqrt(normal + shear)
                at += 1


def onsets(ratios: F32, weights: F64, shares: Sequence[float]) -> tuple[float, ...]:
    """Mean stresses at which these shares of the solid yield, from stress ratios (n, 8) at a mean stress of 1.

    `weights` (n,) are the volumes of solid of the voxels. Stresses are linear: nothing has yielded before.
    """
    flat = ratios.reshape(-1)
    order = np.argsort(-flat, kind="stable")
    above = np.cumsum(np.repeat(weights, 8)[order])
    places = np.searchsorted(above, np.array(shares) * above[-1] * (1 - 1e-12))
    return tuple(float(1 / flat[order[place]]) for place in np.minimum(places, len(flat) - 1))


def shares_above(ratios: F32, weights: F64, multiples: Sequence[float]) -> list[float]:
    """Shares of the solid whose stress ratio (n, 8) is more than these multiples of its mean over the solid."""
    total = 8 * float(weights.sum())
    mean = float((ratios.sum(axis=1, dtype=np.float64) * weights).sum()) / total
    return [float(((ratios > m * mean).sum(axis=1) * weights).sum()) / total for m in multiples]


AXES = "xyz"
MULTIPLES = (2.0, 3.0, 5.0)
"""Multiples of the mean stress of the solid for which the share of it beyond them is reported."""


@dataclass(frozen=True, kw_only=True)
class MeasureOnset(ElasticCell):
    """Compute the stress at which a share of the solid of a periodic cell reaches its yield stress.

    The quick estimate of a strength: linear elasticity, so nothing is redistributed and nothing is fitted. The cell is
    loaded by a mean stress along x, y and z, one after the other, its sides free in the mean. Von Mises stress over
    yield stress is taken at the eight Gauss points of each solid voxel; the onset is the mean stress at which the
    largest of these, over a share of the solid's volume, are 1 or more. One point alone would be that of the sharpest
    corner of the staircase, and depend on the grid.

    An ideally plastic solid bears more than this; a brittle one fails near it. The solid of a partial voxel has the
    voxel's strain, and counts by its volume. What fills the void never yields. The table has a row for each axis and
    share; `concentration` there is the least stress of that share over the mean stress of the cell, where one yield
    stress holds. `above` says which share of the solid bears more than two, three and five times its own mean stress,
    in the mean of the axes. The spread over draws is that of a sweep over seeds.

    With `basquin` fatigue is estimated: amplitudes of the mean stress, fully reversed, after which the share `yielded`
    of the solid has failed by ``amplitude / yield stress = A (2 N)^b`` (Basquin 1910) in `cycles` N. Notches, the
    finish of surfaces and cracks that grow are left out, and what yields at once has no such life: an estimate.
    """

    name: ClassVar[str] = "measure.onset"
    version: ClassVar[int] = 2
    reported: ClassVar[tuple[str, ...]] = (
        "onset", "deviation", "x", "y", "z", "share", "unit", "relative_density", "above.#3", "fatigue.*", "cycles.*",
        "iterations.*",
    )  # fmt: skip
    headline: ClassVar[tuple[Headline, ...]] = (
        Headline("onset", "onset of yield", "{unit}"), Headline("deviation", "its deviation over axes", "{unit}"),
    )  # fmt: skip

    yield_stress: float | tuple[float, ...] = option(
        1.0, help=f"yield stress, {options.EACH_PHASE}; 1: results are relative to it", above=0, maximum=1e15
    )
    yielded: float = option(0.01, help="share of the solid that yields, of the numbers reported", above=0, maximum=1)
    shares: tuple[float, ...] = option((0.001, 0.01, 0.05), help="shares of the table", above=0, maximum=1)
    basquin: tuple[float, float] | None = option(
        None, help="coefficient A over the yield stress and exponent b, below 0, of the solid's life in fatigue: an "
        "estimate of that of the cell", minimum=-1, maximum=100,
    )  # fmt: skip
    cycles: tuple[float, ...] = option((1e4, 1e5, 1e6, 1e7), help="numbers of cycles", minimum=1, maximum=1e12)

    def check_options(self) -> None:
        """As many yield stresses as materials, or one."""
        super().check_options()
        phases, given = len(self._materials()[0]), len(per_phase(self.yield_stress))
        if given not in (1, phases):
            raise ConfigError(
                f"`yield_stress` has {given} values, and `young` {phases}", hint="give one, or one for every phase"
            )
        if self.basquin is not None and not (self.basquin[0] > 0 > self.basquin[1]):
            raise ConfigError(
                f"`basquin` is {list(self.basquin)}", hint="a coefficient above 0 and an exponent below 0: [1.5, -0.1]"
            )

    def bytes_of_a_voxel(self, threads: int) -> int:
        """As for stiffness; all six fields are kept, and then superposed."""
        return super().bytes_of_a_voxel(threads) + 6

    def run(self, context: Context, source: ScalarField | Voxels) -> Table:
        """Solve, superpose, and sort the stresses."""
        from sppm_pipeline.services.elastic.voigt import lame

        self.check_image(context, source)
        cell = self.cell_of(context, source)
        young, poisson = self._materials()
        cell.check_materials(context, len(young), "`young`, `poisson` and `yield_stress`")
        if not cell.occupied().any():
            raise DesignError("the cell is empty: there is nothing to yield", hint="lower the porosity")
        options = self.solver_options(context.threads)
        del options["precision"]  # which the body has
        found = self._body(cell, ())[0].stiffness(fields=True, **options)
        for warning in self.solver_warnings(found.solved, found.precision):
            context.warn(warning)
        strengths = per_phase(self.yield_stress) * (len(young) if len(per_phase(self.yield_stress)) == 1 else 1)
        ratios = tuple(lame(e, v)[1] / y for e, v, y in zip(young, poisson, strengths, strict=True))
        if cell.fraction is None:
            modulus = cell.of_voxels((0.0, *ratios), np.float64)
            weights = np.ones(np.count_nonzero(modulus))
        else:
            share = cell.fraction.T
            modulus, weights = ratios[0] * (share > 0), share[share > 0].astype(np.float64)
        wanted = (self.yielded, *self.shares)
        rows: list[tuple[str, float, float | None]] = []
        means: list[float | None] = []
        above: list[list[float]] = []
        for axis, name in enumerate(AXES):
            strain = uniaxial_strain(found.stiffness, axis)
            values: tuple[float | None, ...] = (None,) * len(wanted)
            if strain is None:
                context.warn(f"the solid has no load path along {name}")
            else:
                stresses = stress_ratios(found, strain, modulus, cell.edges)
                values = onsets(stresses, weights, wanted)
                above.append(shares_above(stresses, weights, MULTIPLES))
            means.append(values[0])
            rows += [(name, share, value) for share, value in zip(self.shares, values[1:], strict=True)]
        borne = [value for value in means if value is not None]
        context.report(
            onset=float(np.mean(borne)) if borne else None, deviation=float(np.std(borne)) if borne else None,
            **dict(zip(AXES, means, strict=True)), share=self.yielded, unit=self.stress_unit,
            relative_density=1 - cell.porosity, above=np.mean(above, axis=0).tolist() if above else [None] * 3,
            **self._fatigue(float(np.mean(borne)) if borne else None),
            iterations=[case.iterations for case in found.solved],
        )  # fmt: skip
        columns = zip(*rows, strict=True) if rows else ((), (), ())
        table = dict(zip(("axis", "share", "onset"), columns, strict=True))
        if len(set(strengths)) == 1:
            table["concentration"] = tuple(strengths[0] / value if value else None for value in table["onset"])
        return Table(table)

    def _fatigue(self, onset: float | None) -> dict[str, Any]:
        """Amplitudes for all numbers of cycles, None where the solid would yield at once."""
        if self.basquin is None or onset is None:
            return {}
        lives = [self.basquin[0] * (2 * n) ** self.basquin[1] for n in self.cycles]
        return {"fatigue": [onset * life if life < 1 else None for life in lives], "cycles": list(self.cycles)}
