"""``tune.tensor``: one cell whose own stiffness tensor, all 21 constants of it, is the one asked for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple, cast

import numpy as np

from sppm_pipeline import Context, Headline, Palette, Recipe, RecipeSize, ScalarField, Size, Stage, option, options
from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.stiffness.numerics.sensitivity import brick_stiffness
from sppm_pipeline.features.stiffness.stages.homogenize_voxel import HomogenizeVoxel
from sppm_pipeline.features.stiffness.waved_field import WavedField, wave_values, waves_up_to
from sppm_pipeline.method.families.homogenizer import Quiet, VoxelCell
from sppm_pipeline.method.families.tuner import HIGH, LOW, options_at, periodic_cell, varied_option
from sppm_pipeline.method.fields.scalar_field import WrappedField
from sppm_pipeline.method.nouns.stiffness import StiffnessReport
from sppm_pipeline.method.nouns.stiffness_design import StiffnessDesign
from sppm_pipeline.method.porosity.level import cut_for_porosity
from sppm_pipeline.services.arrays import F32, F64
from sppm_pipeline.services.elastic.refinement import POWERS, power_weights
from sppm_pipeline.services.elastic.voigt import isotropic, mandel, rotated
from sppm_pipeline.services.grid import Grid, cell_centers

FINER = 1.5
"""Voxels along an edge of the grid on which the result is measured, over those of the search."""

MIN_TRUST = 0.005
"""Step, in the same units, at which the search ends: errors of the derivatives are larger than what it would gain."""

CORRECTIONS = 2
"""How often the search goes on with what that grid says."""

DRAWS, FAR = 2, 3
"""Draws of which the search starts at most, the next one if a result is this many times `accuracy` off: of eight bones
one was, in a local minimum of its first draw."""

TRUST = 0.2
"""Largest step at first, in the same units: with twice as much the first steps were taken back."""

WAVES, DIALS = 0.03, 0.02
"""Weights of a step of the waves, over the level that would remove the solid, and of the dials, over their range, where
that of the distance is 1: with 0.1 for both, steps were three times smaller than they could be."""

PULL = 0.03
"""Weight of the waves themselves."""

STEP = 0.1
"""Step of the differences by dials, over their range."""

LEVELINGS = 2
"""Corrections of the level to the porosity that is kept; the second leaves less than a thousandth."""

SLOPE = 0.02
"""Step of the differences by the level, over that which would remove the solid."""

LOOSE = 0.05
"""Tolerance of the displacements, whose error counts in its second order: C then differs by 5e-4 at most."""


@dataclass(frozen=True, kw_only=True)
class TuneTensor(Stage):
    """Make a cell whose own stiffness tensor is a target, by walls and struts that are thicker here and thinner there.

    The stiffness of a cell drawn at random differs from the mean of all draws by up to a third, and is less symmetric.
    This stage takes one draw and lets the level of its field vary smoothly over the cell, by a sum of waves of which
    up to `periods` fit along an edge. Derivatives of all 21 constants by the waves follow from the displacements of the
    six load cases, which are known once the cell is homogenized; damped Gauss-Newton steps lead to the target,
    at the same porosity. An extension of the paper, whose cells are what was drawn.

    After `design.stiffness` the target is the design's, and the cell that of its dials: stretched and turned by
    `warp.affine` as the design says, it has the stiffness that was asked for. Without a design the target is the
    isotropic stiffness nearest to what the cell has, so that the cell becomes isotropic.

    The stiffness is that of fine grids, extrapolated as by `homogenize.voxel`. What comes out is homogenized again on
    a grid of 1.5 times as many voxels, by whose stiffness the search is corrected, up to twice; the distance to the
    target that is reported is the one there, with its error bar. If the nearest of the `trials` ends far from the
    target, the next one is tried.
    """

    name: ClassVar[str] = "tune.tensor"
    version: ClassVar[int] = 2
    headline: ClassVar[tuple[Headline, ...]] = (
        Headline("distance", "distance to the target", error="grid_error"), Headline("distance_before", "before"),
        Headline("variation", "variation of the level"), Headline("porosity"),
    )  # fmt: skip
    reported: ClassVar[tuple[str, ...]] = (
        "distance", "distance_before", "grid_error", "variation", "porosity", "draw",
        "homogenizations", "stiffness.#6.#6",
    )  # fmt: skip
    advice: ClassVar[str] = "lower `resolution`"
    returns: ClassVar[type] = ScalarField

    young: float | None = options.young(None, note="of the solid; that of the design if omitted, else 1", above=None,
                                        minimum=1e-9, maximum=1e9)  # fmt: skip
    poisson: float | None = options.poisson(
        None, note="of the solid; that of the design if omitted, else 0.3", above=None, below=None, minimum=-0.9,
        maximum=0.49,
    )  # fmt: skip
    low: tuple[float, ...] = option((0.0,), help=f"{LOW}; of each dial", minimum=-1e15, maximum=1e15)
    high: tuple[float, ...] = option((0.9,), help=f"{HIGH}; of each dial", minimum=-1e15, maximum=1e15)
    periods: int = option(3, help="waves along an edge of the cell at most", minimum=1, maximum=4)
    accuracy: float = options.accuracy(0.02, note="the norm of the target, at which the search ends")
    max_distance: float = option(
        0.1, help="distance over the norm of the target from which on it is refused", above=0, maximum=1
    )
    evaluations: int = options.evaluations(14, note="cells homogenized")
    trials: int = options.trials(3, note="of the recipe, of which the nearest one is changed")
    resolution: int = options.resolution(48, note="of the search", minimum=24, maximum=192)

    @property
    def rated_as(self) -> str:
        return "homogenize.voxel"

    def estimate(self, palette: Palette, recipe: RecipeSize, design: Size | None = None) -> Size:
        made = recipe(palette, 1)
        searched: Size = self._solver(None, self.resolution).solving(made, 12 + FINER**3)
        return replace(searched, result=made)

    def _solid(self, design: StiffnessDesign | None) -> tuple[float, float]:
        """Young's modulus and Poisson's ratio of the solid."""
        young, poisson = (1.0, 0.3) if design is None else (design.young, design.poisson)
        return self.young or young, poisson if self.poisson is None else self.poisson

    def _solver(self, design: StiffnessDesign | None, resolution: int) -> HomogenizeVoxel:
        stretch = None if design is None else cast(tuple[float, float, float], tuple(map(float, design.stretch)))
        return HomogenizeVoxel(
            resolution=resolution, poisson=self._solid(design)[1], stretch=stretch, solver_tolerance=1e-3,
            iterations=3000,
        )  # fmt: skip

    def run(self, context: Context, recipe: Recipe, design: StiffnessDesign | None = None) -> ScalarField:
        """Draw, search, measure on a finer grid."""
        young, poisson = self._solid(design)
        target = None if design is None else rotated(design.target / young, design.rotation.T)
        solver = self._solver(design, self.resolution)
        searches = [
            Search(self, solver, self._cells(context, recipe, design, draw), target, poisson, context)
            for draw in range(self.trials)
        ]
        started = [search.start(design) for search in searches]
        best: Measured | None = None
        for draw in sorted(range(self.trials), key=lambda k: started[k].distance)[:DRAWS]:
            found = searches[draw].run(started[draw], self.accuracy, self.evaluations)
            latest = self._measured(context, design, found, searches[draw], draw)
            best = min(best or latest, latest, key=lambda one: one.distance)
            if best.distance <= FAR * self.accuracy:
                break
        assert best is not None
        search, draw, latest = searches[best.draw], best.draw, best
        for _ in range(CORRECTIONS):
            if latest.distance <= self.accuracy:
                break
            found = search.corrected(latest.state, latest.report.stiffness)
            found = search.run(found, self.accuracy, search.solved + self.evaluations // 3)
            latest = self._measured(context, design, found, search, draw)
            best = min(best, latest, key=lambda one: one.distance)
        solved = sum(one.solved for one in searches)
        if best.distance > self.max_distance:
            raise DesignError(
                f"the cell came within {best.distance:.2g} of the norm of the target, and not within "
                f"`max_distance: {self.max_distance:g}`",
                hint="more `periods` give more freedom, more `evaluations` more time; the target may be far "
                "from what the recipe has in the mean",
            )
        if best.distance > self.accuracy:
            context.warn(
                f"after {solved} cells the stiffness is {best.distance:.2g} of its norm away from the target, "
                f"more than `accuracy: {self.accuracy:g}`: raise `evaluations`, `periods` or `resolution`"
            )
        bar = float(np.linalg.norm(mandel(cast(F64, best.report.error)))) / best.state.norm
        stiffness = young * best.report.stiffness
        context.report(
            distance=best.distance, distance_before=search.first, grid_error=bar,
            variation=search.variation(best.state), porosity=1 - search.counted(best.field), draw=draw,
            homogenizations=solved, stiffness=rotated(stiffness, design.rotation) if design else stiffness,
        )  # fmt: skip
        return best.field

    def _measured(
        self, context: Context, design: StiffnessDesign | None, found: State, search: Search, draw: int
    ) -> Measured:
        """A result on the finer grid, at the porosity that is kept as samples have it."""
        made = search.cut(replace(found.field, base=cast(_KeptField, found.field.base).base))
        report = self._solver(design, round(FINER * self.resolution)).stiffness_of(cast(Context, Quiet(context)), made)
        return Measured(draw, found, made, report, float(np.linalg.norm(search.off(report.stiffness)[0])))

    def _cells(
        self, context: Context, recipe: Recipe, design: StiffnessDesign | None, draw: int
    ) -> Callable[[Sequence[float]], ScalarField]:
        """Makes the cell of a draw at values of the design's dials."""
        if design is not None and design.recipe != recipe.name:
            raise ConfigError(
                f"the design is one of the recipe {design.recipe!r}, and this one is {recipe.name!r}",
                hint="give the recipe of `design.stiffness`",
            )
        varied = [varied_option(recipe, name) for name, _ in design.options] if design is not None else []
        if len({len(varied), len(self.low), len(self.high)}) > 1 and varied:
            raise ConfigError(
                f"the design has {len(varied)} dials, `low` {len(self.low)} values and `high` {len(self.high)}",
                hint="give those of `design.stiffness`",
            )

        return lambda dials: periodic_cell(context, recipe, draw, options_at(varied, dials))


@dataclass(frozen=True, eq=False)
class _KeptField(WrappedField):
    """A field whose samples on the few grids of a search are computed once."""

    kept: dict[Any, F32]

    def sample_layers(self, grid: Grid, start: int, stop: int, threads: int = 1) -> F32:
        key = grid, start, stop
        if key not in self.kept:
            self.kept[key] = self.base.sample_layers(grid, start, stop, threads)
        return self.kept[key]


class Solved(NamedTuple):
    """A cell of the search with one power of the solid fractions on one grid."""

    stiffness: F64  # (6, 6)
    energies: Callable[[Any], F64]  # mutual energies of voxels, see `brick_stiffness`


class State(NamedTuple):
    """A cell of the search."""

    field: WavedField
    dials: F64
    solid: float  # its share, as partial voxels of this grid have it where the porosity is right
    solved: tuple[Solved, ...]  # by `POWERS`
    stiffness: F64  # (6, 6)
    off: F64  # difference to the target over its norm, (36,)
    norm: float  # of the target

    @property
    def distance(self) -> float:
        """Norm of the difference to the target over that of the target."""
        return float(np.linalg.norm(self.off))


class Measured(NamedTuple):
    """A result of the search, measured on the finer grid."""

    draw: int
    state: State
    field: ScalarField
    report: StiffnessReport
    distance: float


class Search:
    """Search of the waves that bring the stiffness of a cell to a target (6, 6), or to an isotropic one without it."""

    def __init__(
        self, stage: TuneTensor, solver: HomogenizeVoxel, cells: Callable[[Sequence[float]], ScalarField],
        target: F64 | None, poisson: float, context: Context,
    ) -> None:  # fmt: skip
        self.solved, self.first = 0, 0.0
        self._solver, self._coarse = solver, replace(solver, resolution=solver.resolution // 2)
        self._cells, self._order, self._target, self._context = cells, stage.periods, target, context
        self._low, self._high = np.array(stage.low), np.array(stage.high)
        self._base, (self._weights, _) = isotropic(1.0, poisson), power_weights(2.0)
        self._porosity = self._unit = 0.0
        self._turned: F64 | None = None
        self._shift = np.zeros((6, 6))

    def start(self, design: StiffnessDesign | None) -> State:
        """The cell as it was drawn, at the design's dials and porosity or at its own."""
        dials = np.array([value for _, value in design.options] if design is not None else [])
        field = self._plain(dials)
        if design is None:
            self._porosity = 1 - self.counted(field)
        else:
            self._porosity = design.porosity
            field = self.cut(field)
        solid = self._share(field)
        if not 0 < solid < 1:
            raise DesignError("the cell is empty or full: it has no structure to change", hint="change the porosity")
        step = 1e-3 * float(np.ptp(field.sample(self._solver.resolution, self._context.threads)))
        high, low = (float(self._sampled(field.cut_at(sign * step), self._solver).mean()) for sign in (1, -1))
        # the level that would remove the solid if its surface stayed as large
        self._unit = solid * 2 * step / max(high - low, 1e-9)
        state = self._state(field, dials, solid)
        if not state.solved[0].stiffness.any():
            raise DesignError("the cell is empty: it has no stiffness", hint="lower the porosity")
        self.first = state.distance
        return state

    def _prepare(self, state: State) -> None:
        """What the dials change."""
        columns = []
        for k, value in enumerate(state.dials):
            width = STEP * (self._high[k] - self._low[k])
            there = state.dials.copy()
            there[k] += width if value + width <= self._high[k] else -width
            cell = self.cut(self._plain(there))
            columns.append((self._state(cell, there, self._share(cell)).off - state.off) / (there[k] - value))
        self._turned = np.array(columns).reshape(-1, 36).T

    def _plain(self, dials: F64) -> WavedField:
        return WavedField(
            _KeptField(self._cells(dials.tolist()), {}), 0.0, self._order, np.zeros(2 * len(waves_up_to(self._order)))
        )

    def variation(self, state: State) -> float:
        """Root mean square of the waves over the level that would remove the solid."""
        return float(np.linalg.norm(state.field.amplitudes)) / self._unit

    def off(self, stiffness: F64) -> tuple[F64, float]:
        """Difference of a stiffness to the target over the norm of that, (36,), and the norm."""
        to = _isotropic_part(mandel(stiffness)) if self._target is None else mandel(self._target)
        norm = max(float(np.linalg.norm(to)), 1e-12)
        return np.asarray((mandel(stiffness) - to).ravel() / norm), norm

    def corrected(self, state: State, finer: F64) -> State:
        """The same cell, and all that follow, with what a finer grid has and that of the search lacks."""
        self._shift = finer - state.stiffness
        off, norm = self.off(finer)
        return state._replace(off=off, norm=norm)

    def run(self, state: State, accuracy: float, evaluations: int) -> State:
        """Damped Gauss-Newton steps; those that do not come nearer are taken back and made smaller."""
        if state.distance > accuracy and self._turned is None:
            self._prepare(state)
        trust, dials = TRUST, len(state.dials)
        scale = np.concatenate([np.full(len(state.field.amplitudes), self._unit), (self._high - self._low)[:dials]])
        damping = np.append(np.full(len(scale) - dials, WAVES), np.full(dials, DIALS))
        while self.solved < evaluations and state.distance > accuracy and trust > MIN_TRUST:
            slopes = np.hstack([self._slopes(state), cast(F64, self._turned)]) * scale
            here = np.append(state.field.amplitudes / self._unit, np.zeros(dials))
            damped = np.vstack([slopes, np.diag(damping), PULL * np.diag(here != 0)])
            wanted = np.concatenate([-state.off, np.zeros(len(scale)), -PULL * here])
            step = np.linalg.lstsq(damped, wanted, rcond=None)[0]
            while self.solved < evaluations and trust > MIN_TRUST:
                step *= min(1.0, trust / float(np.linalg.norm(step)))
                expected = float(np.linalg.norm(state.off + slopes @ step))
                tried = self._moved(state, step * scale)
                self._context.progress(self.solved, evaluations, "cells homogenized")
                gained, hoped = state.distance - tried.distance, state.distance - expected
                size = float(np.linalg.norm(step))
                trust = 1.5 * trust if gained > 0.7 * hoped else trust if gained > 0.3 * hoped else 0.5 * size
                if gained > 0:
                    state = tried
                    break
        return state

    def _moved(self, state: State, step: F64) -> State:
        count = len(state.field.amplitudes)
        dials = np.clip(state.dials + step[count:], self._low[: len(state.dials)], self._high[: len(state.dials)])
        changed = (dials != state.dials).any()
        field = replace(
            self._plain(dials) if changed else state.field, amplitudes=state.field.amplitudes + step[:count]
        )
        if not changed:
            return self._state(field, dials, state.solid)
        field = self.cut(field)
        return self._state(field, dials, self._share(field))

    def _dense(self, field: ScalarField) -> F32:
        return field.sample(cell_centers(2 * self._solver.resolution, field.cells), self._context.threads)

    def counted(self, field: ScalarField) -> float:
        """The share of the solid, counted on a grid twice as fine as that of the search."""
        return float((self._dense(field) < 0).mean())

    def _share(self, field: ScalarField) -> float:
        """The share of the solid as partial voxels of the search have it: off by some tenths of a percent."""
        return float(self._sampled(field, self._solver).mean(dtype=np.float64))

    def cut(self, field: WavedField) -> WavedField:
        """The field at the porosity that is kept, as samples have it."""
        return field.cut_at(cut_for_porosity(self._dense(field), self._porosity).level)

    def _state(self, field: WavedField, dials: F64, solid: float) -> State:
        """The cell at the share of solid that is kept, and its stiffness on two grids, extrapolated."""
        fine = self._solver.sampled(field, self._context.threads)
        for _ in range(LEVELINGS):
            missing = solid - float(cast(F32, fine.fraction).mean(dtype=np.float64))
            field = field.cut_at(missing / solid * self._unit)
            fine = self._solver.sampled(field, self._context.threads)
        coarse = self._coarse.sampled(field, self._context.threads)
        solved = [self._homogenized(coarse if k else fine, power) for k, power in enumerate(POWERS)]
        self.solved += 1
        limit = np.tensordot(self._weights, [one.stiffness for one in solved], 1)
        return State(field, dials, solid, tuple(solved), limit, *self.off(limit + self._shift))

    def _homogenized(self, cell: VoxelCell, power: float) -> Solved:
        """The stiffness of a cell whose voxels have a power of their solid fraction, and how it changes."""
        solving = self._solver.solver_options(self._context.threads) | {"tolerance": LOOSE}
        del solving["precision"]
        found = self._solver._body(cell, (), power)[0].stiffness(fields=True, **solving)
        nx, ny, nz = cell.shape

        def energies(where: Any) -> F64:
            return brick_stiffness(found, (nz, ny, nx), cell.edges, self._base, where)

        return Solved(found.stiffness, energies)

    def _sampled(self, field: ScalarField, solver: HomogenizeVoxel) -> F32:
        """Solid fractions of voxels, (nz, ny, nx)."""
        return cast(F32, solver.sampled(field, self._context.threads).fraction).T

    def _slopes(self, state: State) -> F64:
        """Derivatives of the difference to the target by the amplitudes at constant porosity, (36, 2 n)."""
        step = SLOPE * self._unit
        stiffness, volume = np.zeros((1 + len(state.field.amplitudes), 36)), np.zeros(0)
        for first, last, solver in ((0, 1, self._solver), (1, len(POWERS), self._coarse)):
            high, low = (self._sampled(state.field.cut_at(sign * step), solver) for sign in (1, -1))
            where = np.flatnonzero(high != low)
            places = np.stack(np.unravel_index(where, high.shape)[::-1], -1)
            waves = np.vstack([np.ones(len(where)), wave_values(self._order, (places + 0.5) / high.shape[::-1])])
            up, down = (one.ravel()[where].astype(np.float64) for one in (high, low))
            if not first:
                volume = waves @ (up - down)
            for power, weight, solved in zip(POWERS[first:last], self._weights[first:last], state.solved[first:last],
                                             strict=True):  # fmt: skip
                grown = (up**power - down**power) / (2 * step * high.size)
                stiffness += weight * (waves * grown) @ solved.energies(where).reshape(len(where), 36)
        # what waves add to the solid, the level takes away
        stiffness = stiffness[1:] - np.outer(volume[1:] / volume[0], stiffness[0])
        whole = [mandel(one.reshape(6, 6)) for one in stiffness]
        parts = [one - _isotropic_part(one) for one in whole] if self._target is None else whole
        return np.array(parts).reshape(len(parts), 36).T / state.norm


def _isotropic_part(tensor: F64) -> F64:
    """The isotropic tensor nearest to one in Mandel's basis, (6, 6)."""
    volume = np.zeros((6, 6))
    volume[:3, :3] = 1 / 3
    shape = np.eye(6) - volume
    return np.asarray((tensor * volume).sum() * volume + (tensor * shape).sum() / 5 * shape)
