"""A part of voxels under its load cases, solved one after the other."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import Context, DesignError
from sppm_pipeline.features.parts.numerics.voxel_body import Applied, VoxelBody, applied, held_solid
from sppm_pipeline.features.parts.part_result import TOP, PartResult
from sppm_pipeline.features.parts.pictures import Shell
from sppm_pipeline.method.nouns.conditions import LoadCase, LoadCases
from sppm_pipeline.services.elastic.elastic_level import Moduli
from sppm_pipeline.services.elastic.loaded import HeldBody, Loaded, strains_of, unpacked, von_mises

LARGE = 0.1
"""Displacement, over the longest side of the part, from which on linear elasticity is doubtful; ten times as much is no
result at all but a mistake of units."""


class Model(NamedTuple):
    """What is solved: all arrays are those of voxels (nz, ny, nx)."""

    body: VoxelBody
    moduli: NDArray[Any]  # shear moduli of one Poisson's ratio, or all constants (21, nz, ny, nx), MPa; 0 in the void
    ratio: float  # of both Lamé constants, with shear moduli
    mass: NDArray[np.float32]  # of the voxels, g; their volume in cm3 where the density is not known
    walls: NDArray[np.float32] | None = None  # relative density of the walls in a homogenized voxel

    def held(self, solid: NDArray[np.bool_], fixed: NDArray[np.bool_], dtype: Any) -> HeldBody:
        """The solver of what is solid, with nodes held."""
        moduli = self.moduli if solid is self.body.solid else np.where(solid, self.moduli, self.moduli.dtype.type(0))
        given = moduli if self.moduli.ndim == 4 else Moduli(moduli, None, self.ratio)
        return HeldBody(given, self.body.edges, fixed, dtype)


class Prepared(NamedTuple):
    """A case on what of the body is held."""

    case: LoadCase
    body: VoxelBody
    applied: Applied
    loose: float


def prepared(model: Model, case: LoadCase, *, drop: bool) -> Prepared:
    """Put a case on the pieces of the body that it holds; `DesignError` as `applied` and `held_solid`."""
    found = applied(model.body, case, model.mass)
    solid, loose = held_solid(model.body, case, found.fixed, drop=drop)
    if not loose:
        return Prepared(case, model.body, found, 0.0)
    body = model.body._replace(solid=solid)
    return Prepared(case, body, applied(body, case, np.where(solid, model.mass, 0)), loose)


def simulated(
    context: Context, model: Model, cases: LoadCases, *, drop: bool, tolerance: float, iterations: int,
    yield_stress: float | None, has_mass: bool, keep: bool = False,
) -> tuple[PartResult, Mapping[str, dict[str, NDArray[Any]]]]:  # fmt: skip
    """Solve all cases: the result, and with `keep` displacements and stresses on all voxels of each, for files."""
    numbers: dict[str, Any] = {}
    compliance, worst_move, worst_stress, loose = 0.0, 0.0, 0.0, 0.0
    surface, solver, last = None, None, None
    moved, stresses, full = [], [], dict[str, dict[str, NDArray[Any]]]()
    for number, case in enumerate(cases.cases):
        ready = prepared(model, case, drop=drop)
        one, solid = ready.applied, ready.body.solid
        if solver is None or last is None or not np.array_equal(one.fixed, last):
            solver, last = model.held(solid, one.fixed, np.float32), one.fixed
        found = solved(solver, one, None, residual=1e-6, energy=tolerance, iterations=iterations)
        if not found.solved.converged:
            context.warn(
                f"case {case.name!r}: after {found.solved.iterations} iterations an estimated error of "
                f"{min(found.solved.error, 1):.1g} is left; allow more `iterations`"
            )
        u = found.displacement
        used = ready.body.used()
        u *= used
        forces = solver.forces(u)
        energy = sum(works(one, u, forces))
        # what is held carries the forces there, less the loads that act on it
        own = one.fixed.reshape(-1)[one.pulled.at]
        direct = np.bincount(one.pulled.at[own] // (u.size // 3), one.pulled.values[own], 3)
        reaction = [float(forces[k][one.fixed[k]].sum(dtype=np.float64) - direct[k]) for k in range(3)]
        del forces
        # of pieces that hang by an edge of a voxel the movement says nothing
        move = float(np.sqrt(np.percentile(np.einsum("c...,c...->...", u, u)[used], TOP)))
        _check_move(context, case, move, ready.body)
        stress = _stress(model, solid, u)
        top = float(np.percentile(stress[solid], TOP))
        numbers[case.name] = {
            "compliance": energy, "deflection": move, "stress": top, "reaction": [float(f"{v:.6g}") for v in reaction],
            "iterations": found.solved.iterations,
        }  # fmt: skip
        compliance += case.weight * energy
        worst_move, worst_stress, loose = max(worst_move, move), max(worst_stress, top), max(loose, ready.loose)
        if surface is None:
            surface = Shell.of(ready.body)
        moved.append(surface.moved(u))
        stresses.append(surface.stresses(stress))
        if keep:
            full[case.name] = {"displacement": u, "stress": stress}
        context.progress(number + 1, len(cases.cases), "load cases")
    assert surface is not None
    if loose:
        context.warn(f"{loose:.2g} of the solid is not held by anything, and left out")
    result = PartResult(
        "resolved" if model.walls is None else "homogenized", compliance, worst_move, worst_stress,
        safety=yield_stress / worst_stress if yield_stress and worst_stress else None,
        mass=float(model.mass.sum(dtype=np.float64)) if has_mass else None, loose=loose,
        elements=int(np.count_nonzero(model.body.solid)), cases=numbers,
        points=surface.points, triangles=surface.triangles,
        moved=np.stack(moved).astype(np.float32), stresses=np.stack(stresses).astype(np.float32),
    )  # fmt: skip
    return result, full


def solved(solver: HeldBody, one: Applied, start: NDArray[Any] | None, **stop: Any) -> Loaded:
    """`HeldBody.solve`; `DesignError` where it breaks down."""
    try:
        return solver.solve(one.pulled, one.moved, start, **stop)
    except ArithmeticError as error:
        raise DesignError(
            f"the part can't be solved: {error}",
            hint="look at the picture of the conditions; is what is held joined to what is loaded?",
        ) from None


def works(one: Applied, u: NDArray[Any], forces: NDArray[Any]) -> tuple[float, float]:
    """Twice the work of the loads, and of what moves the displacements that are given, from forces of displacements."""
    pulled, moved = one.pulled, one.moved
    loads = float(pulled.values @ u.reshape(-1)[pulled.at].astype(np.float64))
    if not len(moved.at):
        return loads, 0.0
    there = np.isin(pulled.at, moved.at)
    direct = float(pulled.values[there] @ u.reshape(-1)[pulled.at[there]].astype(np.float64))
    return loads, float(moved.values @ forces.reshape(-1)[moved.at].astype(np.float64)) - direct


def _check_move(context: Context, case: LoadCase, move: float, body: VoxelBody) -> None:
    """Refuse displacements that no part can have, and warn of those that are not small."""
    longest = float((np.array(body.edges) * body.solid.shape[::-1]).max())
    if move > 10 * LARGE * longest:
        raise DesignError(
            f"case {case.name!r}: the part would move by {move:.3g} mm, and is {longest:.4g} mm long",
            hint="are forces in N, `young` in MPa and the mesh in mm?",
        )
    if move > LARGE * longest:
        context.warn(
            f"case {case.name!r}: the part moves by {move / longest:.0%} of its length; linear elasticity, which "
            "assumes small displacements, is not reliable"
        )


def _stress(model: Model, solid: NDArray[np.bool_], u: NDArray[Any]) -> NDArray[np.float32]:
    """Von Mises stress of each voxel; of homogenized ones, the mean over their walls."""
    out = np.zeros(solid.shape, np.float32)
    if model.walls is None:
        von_mises(u, model.moduli, np.array(model.body.edges), out)
        # a voxel that is partly solid has the share of the modulus, and its solid the stress of the whole
        full = float(model.moduli.max())
        np.divide(out * np.float32(full), model.moduli, out=out, where=solid, casting="same_kind")
        out[~solid] = 0
        return out
    mean, _ = strains_of(u, solid, model.body.edges)
    matrices = unpacked(model.moduli[:, solid])
    xx, yy, zz, yz, xz, xy = np.einsum("nij,jn->in", matrices, mean)
    mises = np.sqrt(((xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2) / 2 + 3 * (yz**2 + xz**2 + xy**2))
    out[solid] = mises / model.walls[solid]
    return out
