"""``design.stiffness``: the structure whose stiffness tensor is nearest to one asked for, at a given porosity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, cast

import numpy as np

from sppm_pipeline import Context, Microstructure, Palette, Recipe, RecipeSize, ScalarField, Stage, option, options
from sppm_pipeline.built_in import stage_class
from sppm_pipeline.errors import ConfigError, DesignError, InputError
from sppm_pipeline.features.design.atlas import FAMILIES, POROSITY, PROPERTIES, Atlas, scaled
from sppm_pipeline.features.design.numerics.tensor_fit import Design, Fit, interval, orthotropic, stretch_of
from sppm_pipeline.method.families.homogenizer import Quiet, per_phase
from sppm_pipeline.method.families.tuner import HIGH, LOW, VARY, Varied, options_at, periodic_cell, varied_option
from sppm_pipeline.method.nouns.stiffness import StiffnessReport
from sppm_pipeline.method.nouns.stiffness_design import StiffnessDesign
from sppm_pipeline.method.porosity.level import cut_for_porosity, level_for_porosity
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.nouns.size import Size, sum_of
from sppm_pipeline.services.arrays import F64
from sppm_pipeline.services.elastic.voigt import isotropic, mandel, rotated
from sppm_pipeline.services.grid import cell_centers
from sppm_pipeline.services.local_thickness import limit_sizes, local_thickness

SCANNED = (0.0, 0.5, 1.0)
"""Shares of the range of the first dial at which unstretched cells are homogenized to begin with."""

LIGHTEST = 0.93
"""Largest porosity that is tried where only `max_density` is given."""

MIN_SIZE = 1e-6
"""Norm of a target over Young's modulus of the solid, below which, and above its inverse, units are confused."""

MIN_VOXELS = 3
"""Voxels that struts measure in the mean where `min_strut` is asked for: below, two grids were off by a third."""

EVALUATIONS = 12
"""Stiffnesses that a search with one dial usually takes, each the mean of `draws` cells."""


@dataclass(frozen=True, kw_only=True)
class DesignStiffness(Stage):
    """Find the dials of a recipe, a stretch and a rotation that give a stiffness tensor at a given porosity.

    The recipe makes a cell. Its options named by `vary` are dials that make it softer or stiffer at one porosity, such
    as the share of struts of `field.walls`, which the preset `dialed` holds; the level keeps the porosity. The cell is
    stretched along its axes, which makes ratios of moduli, and turned. A structure that is turned has its stiffness
    turned exactly, so that only dials and stretches cost evaluations.

    The target is a CSV file of six rows of six numbers in Voigt order xx, yy, zz, yz, xz, xy with engineering shear,
    or Young's moduli `E`, Poisson's ratios `nu` and shear moduli `G` along the axes, or, where neither is given, the
    stiffness that a stage before it has measured, for instance that of a scan; then the solid is that of the measured
    structure, and so is the porosity unless one is given. The search starts where the atlas of
    measured designs says, if it has the recipe with `struts` as the dial, else by a scan of the first. Gauss-Newton
    steps bring the mean of a few draws, always the same ones, to it; then the mean of all `draws` on the grid of
    `resolution` is corrected by the same slopes and measured. Each stiffness is the limit of two grids, as of
    `homogenize.voxel`.

    What is obtained is that of a large sample: the mean over draws, with its 95 % interval and that in which one more
    cell lies. Mirrored draws are as likely, so that along the recipe's axes entries that mirrors change have the mean
    0; what a target has of them is out of reach, the `floor` of the distance. A target farther than `max_distance` is
    refused, with the nearest design.

    Stiffness has no scale. With `min_strut` the design has a size of the cell as well, at which struts are that thick
    in the mean or thicker: their local thickness in unstretched draws times the least stretch, as a stretched ball
    holds one of this size.

    `tile` rules lay plain cells; `warp.affine` after them stretches and turns what they lay, by this design.
    """

    name: ClassVar[str] = "design.stiffness"
    version: ClassVar[int] = 2
    advice: ClassVar[str] = "lower `resolution` or `draws`"

    target: Path | None = options.target(None, note="a CSV file of a 6 x 6 stiffness", above=None)
    E: float | tuple[float, ...] | None = option(
        None, help="Young's moduli along x, y and z in place of a file; one for all", minimum=1e-9, maximum=1e9
    )
    nu: float | tuple[float, ...] | None = option(
        None, help="Poisson's ratios yz, xz and xy, contraction along the second when pulled along the first; one for "
        "all", above=-1, below=1,
    )  # fmt: skip
    G: float | tuple[float, ...] | None = option(
        None, help="shear moduli yz, xz and xy; if omitted, of a single E and nu those of an isotropic material",
        minimum=1e-9, maximum=1e9,
    )  # fmt: skip
    young: float = options.young(1.0, note="of the solid, in the unit of the target", above=None, minimum=1e-9,
                                 maximum=1e9)  # fmt: skip
    poisson: float = options.poisson(0.3, note="of the solid", above=None, below=None, minimum=-0.9, maximum=0.49)
    porosity: float | None = options.porosity(None, note="that is kept; found too if omitted, within `max_density`")
    max_density: float | None = option(None, help="largest share of the solid, where no porosity is given", above=0,
                                       below=1)  # fmt: skip
    min_strut: Length | None = option(
        None, help="least mean thickness of struts; sets the size of the cell, on which stiffness does not depend",
        unit="mm", minimum=1e-4, maximum=1e4,
    )  # fmt: skip
    vary: tuple[str, ...] = option(("struts",), help=f"{VARY}; any number of dials, or none")
    low: tuple[float, ...] = option((0.0,), help=f"{LOW}; of each dial", minimum=-1e15, maximum=1e15)
    high: tuple[float, ...] = option((0.9,), help=f"{HIGH}; of each dial", minimum=-1e15, maximum=1e15)
    row_weights: tuple[float, ...] = option(
        (1.0,) * 6, help="weights of the rows of the tensor; an entry counts by the product of two", minimum=0,
        maximum=1e3,
    )  # fmt: skip
    max_distance: float = option(
        0.15, help="distance over the norm of the target from which on it is refused", above=0, maximum=1
    )
    search_draws: int = option(2, help="draws whose mean is brought to the target at first", minimum=1, maximum=50)
    draws: int = options.draws(8, note="whose mean is the result", maximum=1000)
    resolution: int = options.resolution(56, note="of the result; the search takes three quarters", minimum=24,
                                         maximum=256)  # fmt: skip

    def check_options(self) -> None:
        """A target, a porosity, as many bounds as dials, and weights."""
        if self.target is not None and self.E is not None:
            raise ConfigError("the target is either a file, `target`, or moduli, `E`, `nu` and `G`; both are given")
        if self.E is not None:
            self.wanted()
        elif self.nu is not None or self.G is not None:
            raise ConfigError("`nu` and `G` belong to `E`, which is not given", hint="give `E`, or leave them out")
        without = self.porosity is None and self.max_density is None
        if (without and not self._measures) or (self.porosity is not None and self.max_density is not None):
            raise ConfigError("give either `porosity` or `max_density`", hint="for example `porosity: 0.72`")
        if self.max_density is not None and 1 - self.max_density >= LIGHTEST:
            raise ConfigError(f"`max_density` is {self.max_density:g}; it should be above {1 - LIGHTEST:.3g}")
        if self.draws < 3:
            raise ConfigError(f"`draws` is {self.draws}; an interval takes 3 or more")
        for name in ("low", "high"):
            if len(getattr(self, name)) != len(self.vary):
                raise ConfigError(f"`vary` names {len(self.vary)} dials, and `{name}` has {len(getattr(self, name))}")
        if any(a >= b for a, b in zip(self.low, self.high, strict=True)):
            raise ConfigError(f"`low` is {self.low} and `high` {self.high}; they should rise")
        if len(self.row_weights) != 6 or not any(self.row_weights):
            raise ConfigError(f"`row_weights` has {len(self.row_weights)} numbers; it takes six, not all 0")

    @property
    def _measures(self) -> bool:
        """Whether the target is what a stage before this one has measured."""
        return self.target is None and self.E is None

    def _like(self, measured: StiffnessReport | None) -> tuple[DesignStiffness, F64]:
        """The stage with the porosity and the solid of a measured structure, and its stiffness over Young's modulus."""
        if measured is None:
            raise ConfigError(
                "there is no target: neither `target` nor `E` is given, and no stage before has measured a stiffness",
                hint="give `E`, `nu` and `G`, or a file, `target`, or homogenize a structure before",
            )
        solid = [(young, poisson) for _, young, poisson in measured.phases if young > 0]
        if len(solid) != 1:
            raise ConfigError(
                f"the structure measured before has {len(solid)} solid phases, and a recipe makes one",
                hint="give the target as a file, `target`, or by moduli, `E`, `nu` and `G`",
            )
        (young, poisson), found = solid[0], measured.stiffness
        if np.linalg.eigvalsh(found)[0] <= 0:
            raise DesignError(
                "the structure measured before has no stiffness in some direction: no recipe can follow it",
                hint="does it run through from side to side? A finer grid, or a larger piece, may have a stiffness",
            )
        porosity = measured.porosity if self.porosity is None and self.max_density is None else self.porosity
        return replace(self, porosity=porosity, young=young, poisson=poisson), np.asarray(found / young)

    def _of_constants(self) -> F64:
        """The target from moduli, over Young's modulus of the solid."""
        given = [per_phase(value) for value in (self.E, self.nu, self.G)]
        if not all(len(values) in (1, 3) for values in given[: 2 if self.G is None else 3]):
            raise ConfigError("`E`, `nu` and `G` have one number or three each, and `E` needs `nu`")
        e, v = (np.broadcast_to(np.array(values, float), 3) for values in given[:2])
        if self.G is None and (np.ptp(e) or np.ptp(v)):
            raise ConfigError("`G` is missing", hint="give shear moduli yz, xz and xy: `G: [0.02, 0.02, 0.03]`")
        g = e / (2 * (1 + v)) if self.G is None else np.broadcast_to(np.array(given[2], float), 3)
        s = np.diag(np.concatenate([1 / e, 1 / g]))
        for k, (i, j) in enumerate(((1, 2), (0, 2), (0, 1))):
            s[i, j] = s[j, i] = -v[k] / e[i]
        if np.linalg.eigvalsh(s)[0] <= 0:
            raise ConfigError("no material has these moduli: its energy would be negative", hint="lower `nu`")
        return np.asarray(np.linalg.inv(s)) / self.young

    def wanted(self) -> F64:
        """The target, over Young's modulus of the solid."""
        found = self._of_constants() if self.target is None else self._of_file(self.target)
        if not MIN_SIZE < (size := float(np.linalg.norm(found))) < 1 / MIN_SIZE:
            raise ConfigError(
                f"the target has a norm of {size:.3g} times `young: {self.young:g}`, so far off that they have not the "
                "same unit", hint="give `young` in the unit of the target",
            )  # fmt: skip
        return found

    def _of_file(self, path: Path) -> F64:
        try:
            found = np.loadtxt(path, delimiter=",", ndmin=2)
        except (OSError, ValueError) as error:
            raise InputError(f"{path} is no table of numbers: {error}", hint="six rows of six, with commas") from None
        square = found.shape == (6, 6) and bool(np.isfinite(found).all())
        if not square or np.abs(found - found.T).max() > 1e-3 * np.abs(found).max():
            raise InputError(f"{path} holds no symmetric 6 x 6 matrix")
        found = (found + found.T) / 2
        if np.linalg.eigvalsh(found)[0] <= 0:
            raise InputError(f"{path} has an eigenvalue of 0 or less: no structure has this stiffness")
        return np.asarray(found / self.young)

    def estimate(self, palette: Palette, recipe: RecipeSize, measured: Size | None = None) -> Size:
        calls = EVALUATIONS + 2 * len(self.vary)
        made = recipe(palette, self.search_draws * calls + 2 * self.draws)
        searched: Size = self._solver(None, self._coarse).solving(made, self.search_draws * calls)
        found: Size = self._solver(None, self.resolution).solving(made, 2.0 * self.draws)
        return replace(sum_of([searched, found]), resident=found.resident)

    @property
    def _coarse(self) -> int:
        return max(24, round(0.75 * self.resolution))

    @property
    def rated_as(self) -> str:
        return "homogenize.voxel"

    def _solver(self, stretch: F64 | None, resolution: int) -> Any:
        found = None if stretch is None else tuple(map(float, stretch))
        return stage_class("homogenize.voxel")(
            resolution=resolution, poisson=self.poisson, stretch=found, solver_tolerance=1e-3, iterations=3000
        )

    def run(self, context: Context, recipe: Recipe, measured: StiffnessReport | None = None) -> StiffnessDesign:
        """Start by the atlas or a scan of the first dial, search on a few draws, correct and measure on all."""
        self, target = self._like(measured) if self._measures else (self, self.wanted())
        varied = [varied_option(recipe, name) for name in self.vary]
        free = self.porosity is None
        low = (*self.low, *([1 - self.max_density] if self.max_density is not None else []))
        high = (*self.high, *([LIGHTEST] if free else []))
        fit = Fit(target, np.array(self.row_weights), low, high)
        cells = _Cells(self, context, recipe, varied)

        def searched(x: F64) -> F64:
            return cells.mean(x[:-2], stretch_of(x[-2:]), self.search_draws, self._coarse)

        middle = [(a + b) / 2 for a, b in zip(low, high, strict=True)]
        scan = [(a + share * (b - a), *middle[1:]) for share in SCANNED for a, b in zip(low[:1], high[:1], strict=True)]
        scanned = self._known(recipe, low, high) or [
            (at, cells.mean(at, np.ones(3), self.search_draws, self._coarse)) for at in (scan or [()])
        ]
        x, c = fit.run(searched, fit.first(scanned))
        near = fit.design(x, c)
        if near.distance <= 2 * self.max_distance:  # else the search of few draws says enough
            x, near, draws, bar = self._corrected(fit, cells, x)
        if near.distance > self.max_distance:
            raise self._unreachable(near, fit)
        strut = 0.0 if self.min_strut is None else cells.strut(x[:-2])
        return self._report(recipe, fit, x, near, draws, bar, target, strut)

    def _known(
        self, recipe: Recipe, low: tuple[float, ...], high: tuple[float, ...]
    ) -> list[tuple[tuple[float, ...], F64]]:
        """Dials and stiffnesses by the atlas, if the share of struts is the dial of a recipe that it has."""
        if self.porosity is None or len(self.vary) != 1 or self.vary[0].rpartition(".")[2] != "struts":
            return []
        rows = stiffness_over_struts(recipe.options(), self.porosity)
        return [((share,), isotropic(e, v)) for share, e, v in rows if low[0] <= share <= high[0]]

    def _corrected(self, fit: Fit, cells: _Cells, x: F64) -> tuple[F64, Design, F64, float]:
        """The better one of what was found and of a step from it by the slopes known, each measured on all draws."""
        best: tuple[F64, Design, F64, float] | None = None
        for _ in range(2):
            draws, bars = cells.each(x[:-2], stretch_of(x[-2:]), self.draws, self.resolution)
            mean = orthotropic(draws.mean(0))
            found = x, fit.design(x, mean), draws, float(np.mean(bars))
            if best is None or found[1].distance < best[1].distance:
                best = found
            x = fit.corrected(x, mean)
        assert best is not None
        return best

    def _report(
        self, recipe: Recipe, fit: Fit, x: F64, near: Design, draws: F64, bar: float, target: F64, strut: float
    ) -> StiffnessDesign:
        turned = np.array([rotated(c, near.rotation) for c in draws])
        _, of_mean, of_draw = interval(turned)
        own = rotated(target, near.rotation.T)
        floor = float(np.linalg.norm(mandel(own - orthotropic(own))) / np.linalg.norm(mandel(own)))
        y = self.young
        return StiffnessDesign(
            recipe=recipe.name, options=tuple(zip(self.vary, near.dials[: len(self.vary)], strict=True)),
            porosity=near.dials[-1] if self.porosity is None else self.porosity, stretch=near.stretch,
            rotation=near.rotation, stiffness=y * rotated(orthotropic(draws.mean(0)), near.rotation), target=y * target,
            mean_error=y * of_mean, draw_error=y * of_draw, distance=near.distance, floor=floor, grid_error=bar,
            draws=len(draws), edge_mm=self.min_strut.mm() / (strut * near.stretch.min()) if self.min_strut else None,
            young=y, poisson=self.poisson,
        )  # fmt: skip

    def _unreachable(self, near: Design, fit: Fit) -> DesignError:
        names = [*self.vary, *(["porosity"] if self.porosity is None else [])]
        dials = ", ".join(f"{name} {value:.3g}" for name, value in zip(names, near.dials, strict=True))
        ends = [n for n, v, a, b in zip(names, near.dials, fit.low, fit.high, strict=False) if min(v - a, b - v) < 1e-6]
        return DesignError(
            f"the target is {near.distance:.0%} of its norm away from what the recipe reaches, more than "
            f"`max_distance: {self.max_distance:g}`; nearest is {dials or 'no dial'} with the stretch "
            + ", ".join(f"{s:.3g}" for s in near.stretch),
            hint=f"the dial {ends[0]!r} ends there: change the porosity or the target"
            if ends
            else "no dial ends there: another recipe or porosity may come nearer, or raise `max_distance`",
        )


def stiffness_over_struts(
    options: Mapping[str, Mapping[str, Any]], porosity: float
) -> list[tuple[float, float, float]]:
    """Shares of struts with Young's modulus and Poisson's ratio that the atlas has for walls of a recipe.

    Empty if the atlas has no such recipe, porosity or holes.

    Parameters
    ----------
    options : mapping of stage to options
        As of `Recipe.options`.
    porosity : float
    """
    family = {"sample.dart_throwing": "thrown_walls", "sample.hyperuniform": "walls"}.get(next(iter(options), ""), "")
    radius = options.get("field.walls", {}).get("tunnel_radius")
    total = next(iter(options.values()), {}).get("total")
    if list(options)[1:] != ["connect.mbdst", "field.walls"] or not (family and radius and total):
        return []
    hole = (radius.in_cells(None) if isinstance(radius, Length) else float(radius)) * total ** (1 / 3)
    ranges = FAMILIES[family].ranges
    values = {POROSITY: porosity, "hole": hole}
    if any(not ranges[name][0] <= value <= ranges[name][1] for name, value in values.items()):
        return []
    low, high = ranges["struts"]
    shares = [low + k / 8 * (high - low) for k in range(9)]
    at = np.concatenate([scaled(family, {**values, "struts": share}) for share in shares])
    found = np.exp(Atlas.read().logs(family, at)[0])
    young, poisson = (found[:, PROPERTIES.index(name)] for name in ("E_relative", "poisson"))
    return [(s, float(e), float(v)) for s, e, v in zip(shares, young, poisson, strict=True)]


class _Cells:
    """Cells of a recipe at any dials, each draw always the same pores, and their stiffness at any stretch."""

    def __init__(self, stage: DesignStiffness, context: Context, recipe: Recipe, varied: Sequence[Varied]) -> None:
        self._stage, self._context, self._recipe, self._varied = stage, context, recipe, varied
        self._made: dict[tuple[Any, ...], ScalarField] = {}
        self._solved = 0

    def mean(self, dials: Sequence[float] | F64, stretch: F64, draws: int, resolution: int) -> F64:
        """Mean stiffness along the axes of the recipe, without what mirrored draws would cancel."""
        return orthotropic(self.each(dials, stretch, draws, resolution)[0].mean(0))

    def each(self, dials: Sequence[float] | F64, stretch: F64, draws: int, resolution: int) -> tuple[F64, list[float]]:
        """Stiffness of each draw, (draws, 6, 6), and the relative error bars of their grids."""
        solver = self._stage._solver(stretch, resolution)
        found, bars = [], []
        for draw in range(draws):
            field = self._cell(tuple(map(float, dials)), draw)
            report = solver.stiffness_of(cast(Context, Quiet(self._context)), field)
            if not (size := float(np.linalg.norm(report.stiffness))):
                raise DesignError(
                    f"a cell of the recipe {self._recipe.name!r} carries no load at the porosity that is tried",
                    hint="lower the porosity, or raise `resolution` or the number of pores",
                )
            found.append(report.stiffness)
            bars.append(float(np.linalg.norm(report.error)) / size)
            self._solved += 1
            total = self._stage.search_draws * EVALUATIONS + 2 * self._stage.draws
            self._context.progress(min(self._solved, total), total, "cells homogenized")
        return np.array(found), bars

    def strut(self, dials: F64) -> float:
        """Mean thickness of the solid of unstretched draws in the limit of fine grids, in cell sizes."""
        n, both = 2 * self._stage.resolution, []  # twice that of stiffness, as thin walls need it
        fields = [self._cell(tuple(map(float, dials)), draw) for draw in range(3)]
        for edge in (n, n // 2):
            solids = [one.sample(cell_centers(edge, one.cells), self._context.threads) < 0 for one in fields]
            both.append(np.concatenate([local_thickness(np.ascontiguousarray(one.T).view(np.uint8)) for one in solids]))
        found = limit_sizes(both[0], both[1], (1 / n, 1 / (n // 2))).mean
        if found * n < MIN_VOXELS:
            raise DesignError(
                f"struts of the design measure {found * n:.2g} voxels, too few to find a cell for `min_strut`",
                hint=f"raise `resolution: {n // 2}`, or leave `min_strut` out",
            )
        return found

    def _cell(self, dials: tuple[float, ...], draw: int) -> ScalarField:
        key = (dials, draw)
        if (known := self._made.get(key)) is not None:
            return known
        values = dials[: len(self._varied)]
        porosity = dials[-1] if self._stage.porosity is None else self._stage.porosity
        made = periodic_cell(self._context, self._recipe, draw, options_at(self._varied, values))
        grid = cell_centers(self._stage.resolution, made.cells)
        threads = self._context.threads
        if isinstance(made, Microstructure):
            made = made.with_level(level_for_porosity(made.sums(grid, threads), porosity).level)
        else:
            made = made.cut_at(cut_for_porosity(made.sample(grid, threads), porosity).level)
        if len(self._made) > 4 * self._stage.draws:
            self._made.pop(next(iter(self._made)))
        return self._made.setdefault(key, made)
