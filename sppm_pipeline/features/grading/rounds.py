"""Graded cells in rounds: porosity over the number of pores from trial cells, then draw, measure and correct."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.grading.local_porosity import error_summary
from sppm_pipeline.features.grading.numerics.curve import PorosityCurve, porosity_curve
from sppm_pipeline.method.families.interiors import MIN_PORES
from sppm_pipeline.method.families.tiler import TRIAL_BLOCKS, without_faces
from sppm_pipeline.method.fields.microstructure import Microstructure, made_of_kernels
from sppm_pipeline.method.nouns.pores import PoreSet
from sppm_pipeline.nouns.palette import Blocks, KeptPores, Palette
from sppm_pipeline.services.arrays import F64
from sppm_pipeline.stage import Context, Recipe

Wanted = TypeVar("Wanted")
Made = TypeVar("Made")
Cells = TypeVar("Cells", bound=Blocks)

STEP = 1.35
"""Factor between successive numbers of pores of a curve, a heuristic: five of them cover porosities from 0.2 to 0.5.
Its square would leave three points, too few for a cubic; its root doubles the trial cells."""

MAX_COUNTS = 20
"""Maximum number of points of a curve."""

MARGIN = 0.02
"""Porosity by which a curve extends beyond the targets, so that rounds can overshoot."""


def recipe_total(recipe: Recipe) -> int:
    """The number of pores of a cell that a recipe states; `ConfigError` if no stage of it has the option `total`."""
    totals = [values["total"] for values in recipe.options().values() if values.get("total") is not None]
    if not totals:
        raise ConfigError(
            "graded cells need a recipe whose number of pores can be changed",
            hint="give its samplers `total: 66` and `share: 0.5` instead of `count`",
        )
    return int(totals[0])


def trial(
    context: Context, recipe: Recipe, total: int | None, attempt: int, palette: Palette | None = None
) -> Microstructure:
    """A cell of a recipe with another number of pores; `ConfigError` if the recipe makes no microstructure."""
    stages = [i for i, values in recipe.options().items() if values.get("total") is not None]
    options = {} if total is None else {stage: {"total": total} for stage in stages}
    made = recipe.run(context, palette=palette or Palette(), attempt=attempt, options=options)
    return made_of_kernels(made, recipe.name, "graded cells need")


def curve_of(
    context: Context, porosity: Callable[[int, int], float], total: int, targets: F64, trials: int
) -> PorosityCurve:
    """The porosity of a recipe over the number of pores of a cell, wide enough for all targets (m,), beginning with
    `total`.

    `porosity` gives that of a trial of a number of pores and an attempt, of which there are `trials` for each number.
    `DesignError` if a target is out of reach.
    """
    low, high = float(targets.min()) - MARGIN, float(targets.max()) + MARGIN
    counts: list[int] = []
    porosities: list[float] = []

    def probe(n: int) -> float:
        found = [porosity(n, 1 + sample) for sample in range(trials)]
        counts.extend([n] * trials)
        porosities.extend(found)
        context.progress(len(counts), MAX_COUNTS * trials, "trial cells")
        return float(np.mean(found))

    def widened(n: int, factor: float, enough: Callable[[float], bool]) -> str:
        """Go from n on by a factor until the porosity is enough; why it went no further."""
        try:
            found = probe(n) if n not in counts else float(np.mean(porosities[: counts.count(n)]))
            # near 0 and 1 more or fewer pores hardly change the porosity, and the curve has no inverse
            while not enough(found) and 0.01 < found < 0.99 and n > MIN_PORES and len(counts) < MAX_COUNTS * trials:
                n = max(MIN_PORES, round(n * factor))
                found = probe(n)
        except DesignError as error:  # so many pores do not fit, or so few do not make faces
            return f": {error}"
        return ""

    more = widened(total, STEP, lambda found: found >= high)
    fewer = widened(total, 1 / STEP, lambda found: found <= low)
    curve = porosity_curve(counts, porosities)
    for worst, out, why in (
        (float(targets.max()), targets.max() > curve.porosities[-1], more),
        (float(targets.min()), targets.min() < curve.porosities[0], fewer),
    ):
        if out:
            raise DesignError(
                f"the map asks for a porosity of {worst:.4g}, but with {curve.counts[0]:g} to {curve.counts[-1]:g} "
                f"pores a cell the recipe gives {curve.porosities[0]:.4g} to {curve.porosities[-1]:.4g}{why}",
                hint="bound the map by clip(), or change the radii of the recipe",
            )
    return curve


def of_periodic_cells(context: Context, recipe: Recipe, resolution: int) -> Callable[[int, int], float]:
    """For `curve_of`: the porosity of one cell that repeats."""

    def porosity(n: int, attempt: int) -> float:
        cell = trial(context, recipe, n, attempt)
        return float((cell.sample(resolution, context.threads) >= 0).mean())

    return porosity


def in_rounds(
    first: Wanted,
    draw: Callable[[Wanted], Made],
    errors: Callable[[int, Made], F64],
    again: Callable[[int, Made, F64], Wanted | None],
) -> tuple[Made, dict[str, object]]:
    """Draw cells, measure them, and draw them again with more or fewer pores, in rounds.

    `first` is what is to be drawn: numbers of pores, or blocks. `errors` gives for the number of the round and what
    was drawn in it the porosity less its target of each cell, NaN of those that are not measured; `again` gives for
    these what is to be drawn next, None to let it be. Returned are what was drawn last, and a summary of the last
    errors with the rms of all rounds, empty if no cell was measured.
    """
    rms: list[float] = []
    report: dict[str, object] = {}
    number, made = 0, draw(first)
    while True:
        found = errors(number, made)
        if (known := np.isfinite(found)).any():
            summary = error_summary(found[known])
            # the rms of each round shows whether more of them would help
            rms.append(summary["error_rms"])
            report = {**summary, "error_rms_of_rounds": rms}
        wanted = again(number, made, found)
        if wanted is None:
            return made, report
        del made  # there may be millions of pores, which are not held twice
        number, made = number + 1, draw(wanted)


def corrected(
    context: Context, number: int, blocks: Cells, pores: PoreSet, cell: NDArray[np.integer], excess: F64
) -> Cells:
    """Scattered blocks whose pores are kept, but for some at random in cells of too many, and added to in others.

    `cell` (n,) is the cell of each pore, -1 for none: a block, or whatever has a quota. `excess` (m,) is the number of
    pores that each cell has too many, NaN where it is unknown; no cell falls below `MIN_PORES`.
    """
    change = -np.rint(np.nan_to_num(excess)).astype(np.int64)
    order = np.argsort(cell, kind="stable")
    first = np.searchsorted(cell[order], np.arange(len(change) + 1))
    keep = np.ones(len(cell), bool)
    for own in np.flatnonzero(change < 0).tolist():
        begin, end = int(first[own]), int(first[own + 1])
        fewer = min(-int(change[own]), max(0, end - begin - MIN_PORES))
        # at random, so that what is left is as irregular as before
        keep[order[begin + context.rng(number, own).permutation(end - begin)[:fewer]]] = False
    kept = KeptPores(pores.centers[keep], pores.piece[keep])
    return replace(blocks, kept=kept, added=np.maximum(change, 0))


def scattered(context: Context, recipe: Recipe, total: int | None, attempt: int, blocks: Blocks) -> Microstructure:
    """A `trial` in blocks without faces."""
    return trial(context, recipe, total, attempt, Palette(int(blocks.mask.sum()), (0, 0, 0), blocks=blocks))


def of_scattered_boxes(context: Context, recipe: Recipe, resolution: int) -> Callable[[int, int], float]:
    """For `curve_of`: the porosity of a box of scattered blocks that repeats."""
    blocks = Blocks(np.ones((TRIAL_BLOCKS,) * 3, bool), True)

    def porosity(n: int, attempt: int) -> float:
        micro = scattered(context, recipe, n, attempt, blocks)
        if not micro.counted:
            raise ConfigError(
                f"the porosity of what the recipe {recipe.name!r} makes does not follow from its number of pores",
                hint="leave it to `tune.local_porosity` after the tiling, with the map made in between",
            )
        tiling = without_faces(micro, blocks, 0, None, (0.0, 0.0, 0.0))
        return float((tiling.solid(resolution, context.threads) == 0).mean())

    return porosity
