"""``optimize.density``: the porosity that makes a part as stiff as its mass allows, or as light as it may bend."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import Context, Headline, Length, Palette, Recipe, RecipeSize, Size, SurfaceMesh, option, options
from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.parts.bodies import SharedBody
from sppm_pipeline.features.parts.density_law import DensityLaw
from sppm_pipeline.features.parts.material import (
    LoadedPart,
    Prepared,
    checked_move,
    middles_of,
    prepared,
    solved,
    works,
)
from sppm_pipeline.method.nouns.conditions import LoadCases, region_of
from sppm_pipeline.method.nouns.maps import Grading, ImageLaw
from sppm_pipeline.numerics import node_sums
from sppm_pipeline.services.arrays import F64, Bools
from sppm_pipeline.services.elastic.loaded import HeldBody, strains_of, unpacked

EVERY = 10
"""Steps between pictures."""

CHANGE = 0.01
"""Change of densities that ends the search."""

SETTLED, GAIN = 5, 1e-3
"""The search ends, too, when so many steps lower the compliance by no more than this part."""

MOVE = 0.2
"""Largest change of a density in a step."""

HALVINGS = 60
"""Of the multiplier: to the last bit."""

DIRECTION = ("direction_x", "direction_y", "direction_z")

Bounds = tuple[F64, F64]


class State(NamedTuple):
    """Densities, and what follows from them."""

    density: F64
    compliance: float
    gain: F64  # of densities, (m,)


@dataclass(frozen=True, kw_only=True)
class OptimizeDensity(LoadedPart):
    """Find the porosity of every place of a part: the least compliance at a mass, or the least mass at a deflection.

    Elements of half a cell have the stiffness of the recipe's trial cells, measured in this run; densities stay between
    the bounds `density`, which the printer and the recipe allow. The compliance is that of all load cases, weighted.
    Densities are means over a cone of at least the cell, and change by optimality criteria until they change by less
    than 0.01, or five steps gain less than a thousandth. The result is the map `porosity` that `tile.scattered` and
    `tile.graded` follow. With `max_stretch`, maps of it and of its direction stretch the pores of `tile.scattered`
    along the largest principal stress, by the root of its size over that of the second one; the densities are those
    found without.

    `deflection` is the displacement of the loads along themselves, in the mean over the loads: the compliance over the
    total force, of all cases weighted.
    """

    name: ClassVar[str] = "optimize.density"
    version: ClassVar[int] = 2
    reported: ClassVar[tuple[str, ...]] = (
        *LoadedPart.reported, "steps", "gain", "compliance", "mass", "relative_density", "maps.*",
    )  # fmt: skip
    headline: ClassVar[tuple[Headline, ...]] = (
        Headline("gain", "stiffer than the uniform part, times"), Headline("compliance", "compliance", "N mm"),
        Headline("mass", "mass", "g"), Headline("steps"),
    )  # fmt: skip
    advice: ClassVar[str] = "give larger elements, or fewer `updates`"

    mass: float | None = option(
        None, help="mass of the part, skin included; needs `solid_density`", unit="g", above=0, maximum=1e9
    )
    mean_density: float | None = option(
        None, help="mean relative density of the part, skin included, in place of a mass", above=0, below=1
    )
    deflection: Length | None = option(
        None, help="largest deflection, in place of a mass: the part is then made as light as that allows", unit="mm",
        above=0, maximum=1e6,
    )  # fmt: skip
    filter: float = option(
        1.0, help="radius of the cone over which densities are averaged; homogenization asks for a cell at least",
        unit="cell size", minimum=1, maximum=20,
    )  # fmt: skip
    max_stretch: float = option(
        1.0, help="largest stretch of pores along the largest principal stress; 1: none", minimum=1, maximum=5
    )
    solid: tuple[str, ...] = option((), help="regions kept at the largest density, as in `load.case`: 'box ...'")
    empty: tuple[str, ...] = option((), help="regions kept at the smallest density")
    updates: int = option(60, help="maximum number of updates of the densities", minimum=1, maximum=500)
    history: str | None = options.write_path(None, note="a picture of the densities every ten steps", suffixes=("/",))

    def check_options(self) -> None:
        """One target."""
        super().check_options()
        given = [name for name in ("mass", "mean_density", "deflection") if getattr(self, name) is not None]
        if len(given) != 1:
            raise ConfigError(
                f"one of `mass`, `mean_density` and `deflection` is the target, not {', '.join(given) or 'none'}"
            )
        if self.mass is not None and self.solid_density is None:
            raise ConfigError("a `mass` needs the density of the solid", hint="give `solid_density: 1.18`")
        for text in (*self.solid, *self.empty):
            region_of(text, None)

    def estimate(self, palette: Palette, cases: Size, part: Size, grading: Size | None, recipe: RecipeSize) -> Size:
        return self.solving(recipe, part, cases.cells * self.updates / 2)  # it usually settles before

    def run(
        self, context: Context, cases: LoadCases, part: SurfaceMesh, grading: Grading | None, recipe: Recipe
    ) -> Grading:
        """Measure the law, search, and make the map."""
        before = Grading() if grading is None else grading
        law, cell = self.law_of(context, recipe)
        shared = self.elements_of(part, cell)
        skin = self.skin_share(part, shared)
        problem = Problem(self, law, shared, skin, cases)
        cone = ConeFilter(shared.body.solid, shared.body.edges, self.filter * cell)
        design, history = self._search(context, problem, self._bounds(part, shared), cone)
        context.report(
            steps=len(history), gain=history[0] / history[-1], compliance=history[-1],
            mass=problem.mass(design) if self.solid_density else None,
            relative_density=problem.mass(design) / problem.full,
        )  # fmt: skip
        found = before.added(_map(shared, "porosity", 1 - design))
        if self.max_stretch > 1:
            stretch, direction = principal(problem.squared_stresses(), cone, self.max_stretch)
            for name, values in zip(("stretch", *DIRECTION), (stretch, *direction.T), strict=True):
                found = found.added(_map(shared, name, values))
        return found

    def _bounds(self, part: SurfaceMesh, shared: SharedBody) -> Bounds:
        """Bounds of the design variables (m,), with regions that are kept."""
        middles = middles_of(shared)
        low, high = (np.full(len(middles), bound) for bound in self.density)
        kept = list[tuple[str, int, Bools]]()
        for texts, side in ((self.solid, 1), (self.empty, 0)):
            for text in texts:
                region = region_of(text, part)
                thin = region.kind in ("plane", "triangles")
                inside = region.distances(middles) <= (0.5 * max(shared.body.edges) if thin else 0)
                if not inside.any():
                    raise DesignError(f"no element lies in {text!r}", hint="is it in the same place and unit?")
                for other, its, there in kept:
                    if its != side and (both := np.flatnonzero(inside & there)).size:
                        x, y, z = middles[both[0]]
                        raise DesignError(
                            f"{other!r} is kept solid and {text!r} empty, and both are at ({x:g}, {y:g}, {z:g}) mm",
                            hint="give regions that do not meet",
                        )
                kept.append((text, side, inside))
                low[inside] = high[inside] = self.density[side]
        return low, high

    def _search(self, context: Context, problem: Problem, bounds: Bounds, cone: ConeFilter) -> tuple[F64, list[float]]:
        """Densities (m,), and the compliance of every step."""
        target = self._mass_target(problem, bounds, cone)
        design = self._uniform(problem, bounds, cone, target)
        history = list[float]()
        for step in range(self.updates + 1):
            state = problem.solved(context, cone.mean(design))
            history.append(state.compliance)
            if step == 0:
                problem.check_moves(context)
            context.progress(step, self.updates, f"steps; compliance {state.compliance:.4g} N mm")
            if self.history is not None and step % EVERY == 0:
                self._draw(context, problem.shared, state.density, step)
            if step == self.updates:
                break
            gain, cost = cone.back(state.gain), cone.back(problem.masses)
            enough = self._enough(problem, cone, state, design, gain, target)
            before, design = design, updated(design, gain, cost, bounds, enough)
            settled = len(history) > SETTLED and history[-1 - SETTLED] < (1 + GAIN) * history[-1] and target is not None
            if np.abs(design - before).max() < CHANGE or settled:
                state = problem.solved(context, cone.mean(design))
                history.append(state.compliance)
                break
        if target is None and history[-1] > 1.02 * self._compliance_target(problem):
            raise DesignError(
                f"the part bends by {history[-1] / problem.force:.4g} mm at the largest densities that are allowed",
                hint="allow a larger `deflection`, denser cells, more `updates`, or a skin",
            )
        return cone.mean(design), history

    def _enough(
        self, problem: Problem, cone: ConeFilter, state: State, here: F64, gain: F64, target: float | None
    ) -> Callable[[F64], bool]:
        """Whether a design has the mass wanted, or is stiff enough, for `updated`."""
        if target is not None:
            return lambda made: problem.mass(cone.mean(made)) >= target
        most = self._compliance_target(problem)
        # reciprocal variables: the compliance of a bar scales with one over its section
        return lambda made: state.compliance + float(gain @ (here**2 / made - here)) <= most

    def _mass_target(self, problem: Problem, bounds: Bounds, cone: ConeFilter) -> float | None:
        """The mass that is wanted; `DesignError` if no density that is allowed gives it."""
        if self.deflection is not None:
            return None
        wanted = self.mass if self.mass is not None else float(self.mean_density or 0) * problem.full
        low, high = (problem.mass(cone.mean(bound)) for bound in bounds)
        if not low <= wanted <= high:
            unit = "g" if self.solid_density else "cm3 of solid"
            raise DesignError(
                f"the part weighs {low:.4g} to {high:.4g} {unit} with densities from {self.density[0]:g} to "
                f"{self.density[1]:g} and its skin, not {wanted:.4g}",
                hint="change the target, `density`, or the skin",
            )
        return wanted

    def _compliance_target(self, problem: Problem) -> float:
        assert self.deflection is not None
        return self.deflection.mm() * problem.force

    def _uniform(self, problem: Problem, bounds: Bounds, cone: ConeFilter, target: float | None) -> F64:
        """The design to begin with: one density wherever regions allow it."""
        low, high = self.density
        if target is None:
            return np.asarray(np.clip((low + high) / 2, *bounds))
        for _ in range(60):
            middle = (low + high) / 2
            enough = problem.mass(cone.mean(np.clip(middle, *bounds))) >= target
            low, high = (low, middle) if enough else (middle, high)
        return np.asarray(np.clip(high, *bounds))

    def _draw(self, context: Context, shared: SharedBody, density: F64, step: int) -> None:
        from PIL import Image

        from sppm_pipeline.features.parts.pictures import density_picture

        folder = context.output(str(self.history))
        folder.mkdir(parents=True, exist_ok=True)
        picture = density_picture(shared.body, density, self.density, f"step {step}")
        Image.fromarray(picture).save(folder / f"step_{step:03}.png")


class Problem:
    """A homogenized part under its cases, as a function of its densities; of elements (m,) a share is skin."""

    def __init__(
        self, stage: LoadedPart, law: DensityLaw, shared: SharedBody, skin: F64, cases: LoadCases,
        dtype: Any = np.float32,
    ) -> None:  # fmt: skip
        self.dtype = dtype
        self.stage, self.law, self.shared, self.skin, self.cases = stage, law, shared, skin, cases
        voxel = stage.voxel_mass(shared.body.edges)
        share = shared.share[shared.body.solid].astype(np.float64)
        self.masses = voxel * share * (1 - skin)
        self.full = float(voxel * share.sum())
        self._skin_mass = float(voxel * (share * skin).sum())
        self._slopes = share * (1 - skin)
        self._starts: dict[str, NDArray[Any]] = {}
        self._ready: list[Prepared] = []
        self._constants: NDArray[Any] = np.zeros((21, 0))
        self.force = 1.0

    def mass(self, density: F64) -> float:
        """Of densities (m,), skin included."""
        return float(self.masses @ density) + self._skin_mass

    def solved(self, context: Context, density: F64) -> State:
        """Compliance of densities (m,), and how much a unit of each lowers it."""
        stage = self.stage
        model = stage.model_of(self.shared, self.law, density, self.skin, 1.0, self.dtype)
        self._constants = model.moduli[:, self.shared.body.solid]
        weightless = not any(any(case.gravity) for case in self.cases.cases)
        if not self._ready or not weightless:
            self._ready = [prepared(model, case, drop=False) for case in self.cases.cases]
            forces = (one.case.weight * float(np.linalg.norm(one.applied.total)) for one in self._ready)
            self.force = sum(forces) or 1.0
        exact = self.dtype == np.float64  # forces themselves, of which the error of an energy is of second order
        slope = self._slopes * self.law.slope_at(density)
        compliance, gain = 0.0, np.zeros(len(density))
        solver: HeldBody | None = None
        for one in self._ready:
            fixed = one.applied.fixed
            if solver is None or not np.array_equal(fixed, solver.fixed):
                solver = model.held(one.body.solid, fixed, self.dtype)
            found = solved(
                solver, one.applied, self._starts.get(one.case.name),
                residual=stage.solver_tolerance if exact else 1e-6, energy=0.0 if exact else stage.solver_tolerance,
                iterations=stage.iterations,
            )  # fmt: skip
            u = found.displacement
            self._starts[one.case.name] = u
            _, second = strains_of(u, one.body.solid, one.body.edges)
            loads, given = works(one.applied, u, solver.forces(u))
            # a displacement that is given stores less energy in a softer part, a load more
            compliance += one.case.weight * (loads - given)
            gain += one.case.weight * (slope * second).sum(axis=0)
            if any(one.case.gravity):  # the work of its own weight, twice: it is load and displaced by it
                pulled = node_sums(np.tensordot(np.array(one.case.gravity), u, 1))[1:, 1:, 1:][one.body.solid] / 8
                gain -= one.case.weight * 2e-3 * self.masses * pulled
        return State(density, compliance, gain)

    def check_moves(self, context: Context) -> None:
        """Refuse displacements, when last solved, that no part can have."""
        for one in self._ready:
            checked_move(context, one.case, self._starts[one.case.name], one.body.used(), one.body)

    def squared_stresses(self) -> F64:
        """Squares of the mean stresses of the elements (m, 3, 3) when last solved, weighted over the cases."""
        total = np.zeros((len(self.skin), 3, 3))
        for one in self._ready:
            strain, _ = strains_of(self._starts[one.case.name], one.body.solid, one.body.edges)
            xx, yy, zz, yz, xz, xy = np.einsum("nij,jn->in", unpacked(self._constants), strain)
            stress = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=1).reshape(-1, 3, 3)
            total += one.case.weight * stress @ stress
        return total


class ConeFilter:
    """Means over the elements (nz, ny, nx) of a part, weighted by a cone of a radius in the unit of their edges.

    Design variables are averaged before they become densities (Bruns and Tortorelli 2001): homogenization needs
    densities that vary little over a cell, and patterns of single elements are stiff by an error of elements alone.
    """

    def __init__(self, solid: Bools, edges: tuple[float, float, float], radius: float) -> None:
        reach = [int(radius / h) for h in edges[::-1]]
        z, y, x = np.meshgrid(
            *(np.arange(-n, n + 1) * h for n, h in zip(reach, edges[::-1], strict=True)), indexing="ij"
        )
        self.kernel = np.maximum(radius - np.sqrt(x**2 + y**2 + z**2), 0.0)
        self.solid = solid
        self.total = self._summed(np.ones(np.count_nonzero(solid)))

    def _summed(self, values: F64) -> F64:
        from scipy.ndimage import convolve

        grid = np.zeros(self.solid.shape)
        grid[self.solid] = values
        return np.asarray(convolve(grid, self.kernel, mode="constant")[self.solid])

    def mean(self, values: F64) -> F64:
        """Densities (m,) of design variables (m,)."""
        return self._summed(values) / self.total

    def back(self, slopes: F64) -> F64:
        """Derivatives by design variables, from those by densities: the transpose, as the cone is symmetric."""
        return self._summed(slopes / self.total)


def updated(design: F64, gain: F64, cost: F64, bounds: tuple[F64, F64], enough: Callable[[F64], bool]) -> F64:
    """The next design: variables times the root of gain over cost, times a multiplier (Bendsoe and Sigmund 2003, 1.2).

    A unit of each (m,) gains so much of the compliance and costs so much mass; `enough` says whether a design has the
    mass wanted, or is stiff enough, and is true of larger ones, too.
    """
    low, high = np.maximum(bounds[0], design - MOVE), np.minimum(bounds[1], design + MOVE)
    ratio = np.sqrt(np.maximum(gain, 0) / np.maximum(cost, 1e-300))
    scale = float(ratio.max()) or 1.0
    ratio /= scale
    least, most = 1e-6, 1e6
    for _ in range(HALVINGS):
        middle = float(np.sqrt(least * most))
        if enough(np.clip(design * ratio * middle, low, high)):
            most = middle
        else:
            least = middle
    return np.clip(design * ratio * most, low, high)


def principal(squared: F64, cone: ConeFilter, most: float) -> tuple[F64, F64]:
    """Stretch (m,) and unit direction (m, 3) of elements from their squared stresses (m, 3, 3).

    The direction is that of the largest principal stress, pulled or pressed, of the squares averaged over the cone; the
    stretch is the root of its size over that of the second one, at most `most`. Directions have no sign: all point
    to the side of the longest mean, so that maps of them can be interpolated.
    """
    mean = np.stack([cone.mean(one) for one in squared.reshape(-1, 9).T], axis=1).reshape(-1, 3, 3)
    values, vectors = np.linalg.eigh(mean)
    sizes = np.sqrt(np.maximum(values, 1e-300))
    direction = vectors[:, :, 2]
    common = np.linalg.eigh(mean.sum(axis=0))[1][:, 2]
    direction = direction * np.where(direction @ common < 0, -1.0, 1.0)[:, None]
    return np.clip(np.sqrt(sizes[:, 2] / sizes[:, 1]), 1, most), direction


def _map(shared: SharedBody, name: str, of: F64) -> ImageLaw:
    """The map of values of the elements (m,); outside of the part it goes on as in the nearest element."""
    from scipy.ndimage import distance_transform_edt

    solid = shared.body.solid
    values = np.zeros(solid.shape)
    values[solid] = of
    nearest = distance_transform_edt(~solid, return_distances=False, return_indices=True)
    filled = np.ascontiguousarray(values[tuple(nearest)].T)
    return ImageLaw(name, "", "nearest", filled, shared.body.origin, shared.body.edges, 1.0)
