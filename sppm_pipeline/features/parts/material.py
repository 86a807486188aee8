"""What stages of parts share: the material, the law of a recipe, and homogenized models."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import Context, Length, Palette, Recipe, RecipeSize, Size, Stage, SurfaceMesh, option, options
from sppm_pipeline.built_in import stage_class
from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.parts.bodies import Applied, SharedBody, VoxelBody, applied, held_solid, mesh_body
from sppm_pipeline.features.parts.density_law import SHARES, DensityLaw, density_law, solid_constants, yield_factor
from sppm_pipeline.features.parts.part_result import TOP, PartResult
from sppm_pipeline.features.parts.pictures import Shell
from sppm_pipeline.method.families.homogenizer import Quiet
from sppm_pipeline.method.nouns.conditions import LoadCase, LoadCases
from sppm_pipeline.services.arrays import F32, F64, Bools
from sppm_pipeline.services.elastic.elastic_level import Moduli
from sppm_pipeline.services.elastic.loaded import HeldBody, Loaded, strains_of, unpacked, von_mises
from sppm_pipeline.services.mesh.box_tree import box_tree
from sppm_pipeline.services.monotone_cubic import monotone_cubic
from sppm_pipeline.services.multigrid.vectors import dot
from sppm_pipeline.services.nearest import surface_distances

MAX_ELEMENTS = 128
"""Elements along the longest side of a homogenized part, unless a size is given."""

RELIABLE = 0.3
"""Error bar, over the stiffness, of a trial cell, above which there is a warning (heuristic): those of single cells are
partly averaged."""

TRIED = 8
"""Numbers of pores that usually cover a range of densities."""


class Silent(Quiet):
    """A context that reports nothing either."""

    def report(self, **numbers: Any) -> None:
        """Drop numbers of a trial cell."""


@dataclass(frozen=True, kw_only=True)
class LoadedPart(Stage):
    """Base of stages that load a part: its material, and the law of a recipe that fills it."""

    reported: ClassVar[tuple[str, ...]] = ("law_cells", "law_density_min", "law_error")

    young: float = options.young(note="MPa", above=None, minimum=1e-3, maximum=1e9)
    poisson: float = options.poisson(0.35, above=None, below=None, minimum=-0.9, maximum=0.49)
    solid_density: float | None = option(None, help="density of the solid", unit="g/cm3", above=0, maximum=100)
    cell: Length | None = options.cell(None, note="of the recipe in the part; the recipe's `edge` if omitted")
    element: Length | None = option(
        None, help="edge of the elements of a homogenized part; half a cell if omitted, or a 128th of the longest side",
        unit="mm", minimum=1e-4, maximum=1e4,
    )  # fmt: skip
    skin: Length = options.skin(Length(0.0), note="of a homogenized part; a part made by `fill` has its own", minimum=0,
                                maximum=1e6)  # fmt: skip
    density: tuple[float, float] = option(
        (0.2, 0.7), help="relative densities over which the law of the recipe is measured", above=0, below=1
    )
    trials: int = options.trials(3)
    law_resolution: int = option(
        32, help="voxels along an edge of the trial cells", unit="voxels", minimum=8, maximum=128
    )
    law_symmetry: str = option(
        "cubic", help="cubic: the law is averaged over the symmetries of a cube, which stochastic cells have in the "
        "mean; none: as the trial cells are", choices=("cubic", "none"),
    )  # fmt: skip
    solver_tolerance: float = option(1e-5, help="relative error of the result left by the solver, estimated; of the "
                                     "compliance", minimum=1e-10, maximum=0.01)  # fmt: skip
    iterations: int = options.iterations(2000)

    def check_options(self) -> None:
        """Densities that rise."""
        if not self.density[0] < self.density[1]:
            raise ConfigError(f"`density` should rise, from {self.density[0]:g} to {self.density[1]:g}")

    def solving(self, recipe: RecipeSize, part: Size | None, solves: float) -> Size:
        """Cells of the law, homogenized, and the elements of a part (voxels), solved so many times."""
        cells = TRIED * self.trials
        solver: Any = stage_class("homogenize.voxel")(resolution=self.law_resolution)
        cell = recipe(Palette(), cells)
        law, body = solver.solving(cell, cells), part.geometry if part is not None else None
        count = 0.0
        if body is not None:
            mm = cell.cell.edge_mm or 1.0 if self.cell is None else self.cell.mm()
            count = math.prod(
                max(1.0, body.scale * side / self._edge(body.scale * max(body.box), mm)) for side in body.box
            )
        return Size(samples=law.samples, voxels=solves * count, resident=law.resident, nodes=count)

    def _edge(self, longest: float, cell: float) -> float:
        """Edge of the elements, mm."""
        return max(cell / 2, longest / MAX_ELEMENTS) if self.element is None else self.element.mm()

    def law_of(self, context: Context, recipe: Recipe, *, strength: bool = False) -> tuple[DensityLaw, float]:
        """The law of a recipe, MPa, with `strength` also that of its onset of yield; the edge of its cell, mm."""
        low, high = self.density
        cells = stage_class("grade.stiffness")(
            porosities=(1 - high, 1 - low), trials=self.trials, resolution=self.law_resolution, poisson=self.poisson
        ).cells_of(context, recipe, quiet=True)
        shape = (-1, self.trials)
        densities = np.array([1 - report.summary()["porosity"] for _, report in cells]).reshape(shape)
        matrices = np.array([report.stiffness for _, report in cells]).reshape(*shape, 6, 6)
        law = density_law(
            densities, self.young * matrices, self.young, self.poisson, cubic=self.law_symmetry == "cubic"
        )
        if strength:
            onsets = np.array([self._onset(context, cell) for cell, _ in cells]).reshape(*shape, len(SHARES))
            means = onsets.mean(axis=1)[np.argsort(densities.mean(axis=1))]
            law = law._replace(onset=np.column_stack([means.T, np.ones(len(SHARES))]))
        if self.cell is None and cells[0][0].edge_mm is None:
            raise ConfigError(
                "the cell of the recipe has no size in mm", hint="give the option `cell`, or `edge: 5 mm`"
            )
        error = max(float(report.summary().get("error_relative") or 0) for _, report in cells)
        if error > RELIABLE:
            context.warn(
                f"a trial cell has a stiffness with an error bar of {error:.0%}: raise `law_resolution`, or narrow "
                "`density`"
            )
        context.report(law_cells=len(cells), law_density_min=float(law.density[0]), law_error=error)
        return law, self.cell.mm() if self.cell is not None else float(cells[0][0].physical_edge())

    def _onset(self, context: Context, cell: Any) -> F64:
        """Mean stresses at which `SHARES` (s,) of a solid that yields at 1 do so, each the mean of the axes."""
        stage: Any = stage_class("measure.onset")(poisson=self.poisson, resolution=self.law_resolution, shares=SHARES)
        columns = stage.run(cast(Context, Silent(context)), cell).columns
        borne = [
            [v for v, one in zip(columns["onset"], columns["share"], strict=True) if one == s and v] for s in SHARES
        ]
        if not all(borne):
            raise DesignError("a trial cell has no load path", hint="narrow the range `density`")
        return np.array([np.mean(values) for values in borne])

    def elements_of(self, part: SurfaceMesh, cell: float) -> SharedBody:
        """The elements of a homogenized part."""
        longest = float((part.upper - part.lower).max())
        edge = self._edge(longest, cell)
        shared = mesh_body(part, edge)
        if not shared.body.solid.any():
            raise DesignError(
                f"the mesh {part.name!r} has no inside, or elements of {edge:.3g} mm are too large for it"
            )
        return shared

    def skin_share(self, part: SurfaceMesh, shared: SharedBody) -> F64:
        """Share of each element of the body (m,) that is skin."""
        thick = self.skin.mm()
        count = int(np.count_nonzero(shared.body.solid))
        if not thick:
            return np.zeros(count)
        return np.clip((thick - depths_of(part, shared)) / float(np.mean(shared.body.edges)) + 0.5, 0, 1)

    def model_of(
        self, shared: SharedBody, law: DensityLaw, density: F64, skin: F64,
        bearing: F64 | float, dtype: Any = np.float32,
    ) -> Model:  # fmt: skip
        """A homogenized part of densities (m,), of which a share is skin, and a share bears at all."""
        body, share = shared.body, shared.share[shared.body.solid].astype(np.float64)
        solid = solid_constants(self.young, self.poisson)[:, None]
        constants = np.zeros((21, *body.solid.shape), dtype)
        constants[:, body.solid] = share * ((1 - skin) * bearing * law.at(density) + skin * solid)
        walls, mass = (np.zeros(body.solid.shape, dtype) for _ in range(2))
        walls[body.solid] = (1 - skin) * density + skin
        mass[body.solid] = share * walls[body.solid] * self.voxel_mass(body.edges)
        onset = None
        if law.onset is not None:
            onset = np.stack([monotone_cubic(law.density, one).at(walls[body.solid]) for one in law.onset])
        return Model(body, constants, 1.0, mass, walls, onset)

    def voxel_mass(self, edges: tuple[float, float, float]) -> float:
        """Mass of a solid voxel, g; its volume in cm3 if the density is not known."""
        return float(np.prod(edges)) * 1e-3 * (self.solid_density or 1.0)


def depths_of(part: SurfaceMesh, shared: SharedBody) -> F64:
    """Distance of the middles of solid elements (m,) from the surface of the part, mm."""
    return surface_distances(box_tree(part.vertices[part.faces]), middles_of(shared))


def middles_of(shared: SharedBody) -> F64:
    """Middles of the solid elements (m, 3), mm, in C order of (z, y, x)."""
    z, y, x = np.nonzero(shared.body.solid)
    middles: Any = (np.stack([x, y, z], axis=1) + 0.5) * np.array(shared.body.edges) + np.array(shared.body.origin)
    return np.ascontiguousarray(middles, np.float64)


LARGE = 0.1
"""Displacement, over the longest side of the part, from which on linear elasticity is doubtful; ten times as much is no
result at all but a mistake of units."""


class Model(NamedTuple):
    """What is solved: all arrays are those of voxels (nz, ny, nx)."""

    body: VoxelBody
    moduli: NDArray[Any]  # shear moduli of one Poisson's ratio, or all constants (21, nz, ny, nx), MPa; 0 in the void
    ratio: float  # of both Lamé constants, with shear moduli
    mass: F32  # of the voxels, g; their volume in cm3 where the density is not known
    walls: F32 | None = None  # relative density of the walls in a homogenized voxel
    onset: F64 | None = None  # of the solid elements (s, m), as in the law, if measured

    def held(self, solid: Bools, fixed: Bools, dtype: Any) -> HeldBody:
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
    compliance, worst_move, worst_stress, worst_peak, loose = 0.0, 0.0, 0.0, 0.0, 0.0
    surface, solver = None, None
    moved, stresses, full = [], [], dict[str, dict[str, NDArray[Any]]]()
    for number, case in enumerate(cases.cases):
        ready = prepared(model, case, drop=drop)
        one, solid = ready.applied, ready.body.solid
        if solver is None or not np.array_equal(one.fixed, solver.fixed):
            solver = model.held(solid, one.fixed, np.float32)
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
        loads, moves = works(one, u, forces)
        energy = loads + moves
        # what is held carries the forces there, less the loads that act on it
        own = one.fixed.reshape(-1)[one.pulled.at]
        direct = np.bincount(one.pulled.at[own] // (u.size // 3), one.pulled.values[own], 3)
        reaction = [float(forces[k][one.fixed[k]].sum(dtype=np.float64) - direct[k]) for k in range(3)]
        del forces
        move = checked_move(context, case, u, used, ready.body)
        stress = _stress(model, solid, u)
        top = float(np.percentile(stress[solid], TOP))
        peak = top
        if model.onset is not None and model.walls is not None:
            walls = model.walls[solid].astype(np.float64)
            peak = 1 / yield_factor(stress[solid] * walls, model.onset[:, solid[model.body.solid]], walls)
        numbers[case.name] = {
            "compliance": energy, "deflection": move, "stress": top, "reaction": [float(f"{v:.6g}") for v in reaction],
            "iterations": found.solved.iterations,
        }  # fmt: skip
        compliance += case.weight * energy
        worst_move, worst_stress, loose = max(worst_move, move), max(worst_stress, top), max(loose, ready.loose)
        worst_peak = max(worst_peak, peak)
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
        safety=yield_stress / worst_peak if yield_stress and worst_peak else None,
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
    """Twice the work of the loads, and of what moves the displacements that are given, from forces of displacements.

    Where there is only one of both it is of second order in what the solver leaves, as the energy itself.
    """
    pulled, moved = one.pulled, one.moved
    loads = float(pulled.values @ u.reshape(-1)[pulled.at].astype(np.float64))
    there = np.isin(pulled.at, moved.at)
    direct = float(pulled.values[there] @ u.reshape(-1)[pulled.at[there]].astype(np.float64))
    given = float(moved.values @ forces.reshape(-1)[moved.at].astype(np.float64)) - direct
    if loads and given:
        return loads, given
    stored = dot(forces.reshape(-1), u.reshape(-1))
    return (2 * loads - stored, 0.0) if loads else (0.0, stored)


def checked_move(context: Context, case: LoadCase, u: NDArray[Any], used: Bools, body: VoxelBody) -> float:
    """The largest displacement; one that no part can have is refused, and there is a warning if it is not small."""
    # of pieces that hang by an edge of a voxel the movement says nothing
    move = float(np.sqrt(np.percentile(np.einsum("c...,c...->...", u, u)[used], TOP)))
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
    return move


def _stress(model: Model, solid: Bools, u: NDArray[Any]) -> F32:
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
