"""What stages that lay graded cells share: the curve of a recipe, and kernels with sizes that follow maps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.grading.grading import Grading
from sppm_pipeline.features.grading.local_porosity import error_summary
from sppm_pipeline.features.grading.numerics.curve import PorosityCurve, porosity_curve
from sppm_pipeline.method.assembly.contents import TilingArrays
from sppm_pipeline.method.families.interiors import MIN_PORES
from sppm_pipeline.method.families.tiler import TRIAL_BLOCKS, without_faces
from sppm_pipeline.method.fields.microstructure import Microstructure
from sppm_pipeline.method.fields.tiling import Tiling
from sppm_pipeline.method.nouns.pores import PoreSet
from sppm_pipeline.nouns.artifact import frozen
from sppm_pipeline.nouns.palette import Blocks, KeptPores, Palette
from sppm_pipeline.stage import Context, Recipe

Wanted = TypeVar("Wanted")
Made = TypeVar("Made")
Cells = TypeVar("Cells", bound=Blocks)

STEP = 1.35
"""Factor between the numbers of pores of a curve: a choice, five of them from a porosity of .2 to one of .5."""

LONGEST = 20
"""Numbers of pores that are tried for a curve at the most."""

WIDER = 0.02
"""A curve goes on beyond the porosities that are asked for by this much, so that rounds have room."""


_AT_A_TIME = 1 << 18
"""Kernels whose places are looked at together."""

DIRECTION = ("direction_x", "direction_y", "direction_z")
"""Maps of the vector along which pores are stretched, of any length."""


def check_round(grading: Grading, stage: str) -> None:
    """Check that no map asks for what only scattered cells have.

    Raises
    ------
    ConfigError
        Naming the map.
    """
    for name in ("stretch", "spacing"):
        if name in grading:
            raise ConfigError(
                f"`{stage}` lays cells whose faces fit each other, and can't follow the map {name!r}",
                hint="scatter the pores by `tile.scattered`, or leave the map out",
            )


def metric_at(grading: Grading, points: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Metrics (n, 6) by the maps `stretch` and `direction_x`, `_y`, `_z` at points (n, 3) mm; None without them.

    A component of the direction that has no map is 0. Where all are 0 nothing is stretched.

    Raises
    ------
    ConfigError
        If there is a stretch without a direction, or a direction without a stretch.
    """
    from sppm_pipeline.services.metric import stretched_metric

    given = [name in grading for name in DIRECTION]
    if "stretch" not in grading:
        if any(given):
            raise ConfigError("there is a direction, but no map `stretch`", hint="give it by a `grade` stage")
        return None
    if not any(given):
        raise ConfigError(
            "there is a map `stretch`, but no direction",
            hint="give one of the maps direction_x, direction_y, direction_z, or more, by `grade` stages",
        )
    parts = [
        grading[n].at(points) if there else np.zeros(len(points)) for n, there in zip(DIRECTION, given, strict=True)
    ]
    direction = np.stack(parts, axis=1)
    return stretched_metric(grading["stretch"].at(points), direction)


def recipe_total(recipe: Recipe) -> int:
    """The number of pores of a cell that a recipe states.

    Raises
    ------
    ConfigError
        If no stage of it has the option `total`.
    """
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
    """A cell of a recipe with another number of pores.

    Raises
    ------
    ConfigError
        If the recipe makes no microstructure.
    """
    stages = [i for i, values in recipe.options().items() if values.get("total") is not None]
    options = {} if total is None else {stage: {"total": total} for stage in stages}
    micro = recipe.run(context, palette=palette or Palette(), attempt=attempt, options=options)
    if not isinstance(micro, Microstructure):
        raise ConfigError(
            f"the recipe {recipe.name!r} makes a {type(micro).__name__}; graded cells need a Microstructure",
            hint="end the recipe with `field.gaussian`",
        )
    return micro


def curve_of(
    context: Context,
    porosity: Callable[[int, int], float],
    total: int,
    targets: NDArray[np.float64],
    trials: int,
) -> PorosityCurve:
    """The porosity of a recipe over the number of pores of a cell, wide enough for all targets.

    Parameters
    ----------
    context : Context
    porosity : callable of a number of pores and an attempt
        Porosity of a trial.
    total : int
        Number of pores to begin with.
    targets : (m,) float64
    trials : int
        For each number of pores.

    Raises
    ------
    DesignError
        If a target is out of reach.
    """
    low, high = float(targets.min()) - WIDER, float(targets.max()) + WIDER
    counts: list[int] = []
    porosities: list[float] = []

    def probe(n: int) -> float:
        found = [porosity(n, 1 + sample) for sample in range(trials)]
        counts.extend([n] * trials)
        porosities.extend(found)
        context.progress(len(counts), LONGEST * trials, "trial cells")
        return float(np.mean(found))

    def widened(n: int, factor: float, enough: Callable[[float], bool]) -> str:
        """Go from n on by a factor until the porosity is enough; why it went no further."""
        try:
            found = probe(n) if n not in counts else float(np.mean(porosities[: counts.count(n)]))
            while not enough(found) and 0.01 < found < 0.99 and n > MIN_PORES and len(counts) < LONGEST * trials:
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
    errors: Callable[[int, Made], NDArray[np.float64]],
    again: Callable[[int, Made, NDArray[np.float64]], Wanted | None],
) -> tuple[Made, dict[str, object]]:
    """Draw cells, measure them, and draw them again with more or fewer pores, in rounds.

    Parameters
    ----------
    first : object
        What is to be drawn: numbers of pores, blocks.
    draw : callable
    errors : callable of the number of the round and what was drawn in it
        Porosity less its target of each cell; NaN of those that are not measured.
    again : callable of the number of the round, what was drawn in it, and errors
        What is to be drawn next; None to let it be.

    Returns
    -------
    made : object
        What was drawn last.
    report : dict
        Summary of the last errors, and the rms of all rounds; empty if no cell was measured.
    """
    rms: list[float] = []
    report: dict[str, object] = {}
    number, made = 0, draw(first)
    while True:
        found = errors(number, made)
        if (known := np.isfinite(found)).any():
            summary = error_summary(found[known])
            rms.append(summary["error_rms"])
            report = {**summary, "error_rms_of_rounds": rms}
        wanted = again(number, made, found)
        if wanted is None:
            return made, report
        del made  # there may be millions of pores, which are not held twice
        number, made = number + 1, draw(wanted)


def corrected(
    context: Context,
    number: int,
    blocks: Cells,
    pores: PoreSet,
    cell: NDArray[np.integer],
    excess: NDArray[np.float64],
) -> Cells:
    """Scattered blocks whose pores are kept, but for some at random in cells of too many, and added to in others.

    Parameters
    ----------
    context : Context
    number : int
        Of the round.
    blocks : Blocks
        As they were drawn first.
    pores : PoreSet
        What is in them.
    cell : (n,) int
        The cell of each pore, -1 for none: a block, or whatever has a quota.
    excess : (m,) float64
        How many pores each cell has too many; NaN where that is not known. No cell falls below `MIN_PORES`.
    """
    change = -np.rint(np.nan_to_num(excess)).astype(np.int64)
    order = np.argsort(cell, kind="stable")
    first = np.searchsorted(cell[order], np.arange(len(change) + 1))
    keep = np.ones(len(cell), bool)
    for own in np.flatnonzero(change < 0).tolist():
        begin, end = int(first[own]), int(first[own + 1])
        fewer = min(-int(change[own]), max(0, end - begin - MIN_PORES))
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
        tiling = without_faces(scattered(context, recipe, n, attempt, blocks), blocks, 0, None, (0.0, 0.0, 0.0))
        return float((tiling.solid(resolution, context.threads) == 0).mean())

    return porosity


def sites_of(arrays: TilingArrays) -> NDArray[np.int64]:
    """The cell of each interior, (interiors, 3), counted from that of the box; that within the box, if in many."""
    interior = arrays.interior
    sites = np.zeros((int(interior.max()) + 1, 3), np.int64)
    place = np.argwhere(interior >= 0)
    inside = ((place >= arrays.halo) & (place < np.array(interior.shape) - arrays.halo)).all(1)
    for some in (place[~inside], place[inside]):
        sites[interior[tuple(some.T)]] = some - arrays.halo
    return sites


def graded_radii(tiling: Tiling, grading: Grading, *, faces_differ: bool) -> Tiling:
    """The tiling with pores and tunnels of the sizes and shapes that maps say.

    These are `pore_radius`, `tunnel_radius`, `scale`, and `stretch` with its direction: a kernel measures distances in
    the metric at its center or, if it is that of a tunnel, in the middle between its ends. Radii are those across the
    direction.

    Parameters
    ----------
    tiling : Tiling
        Every interior in one place.
    grading : Grading
    faces_differ : bool
        Whether every face pattern is in one place, too; otherwise those keep their sizes.

    Raises
    ------
    ConfigError
        If walls are to be stretched.
    """
    from sppm_pipeline.method.kernels.profiles import PORE_PROFILE, TUNNEL_PROFILES
    from sppm_pipeline.services.metric import PLAIN

    maps = [name for name in ("pore_radius", "tunnel_radius", "scale", "stretch", *DIRECTION) if name in grading]
    if not maps or tiling.edge is None:
        return tiling
    grading, edge = grading.in_cells(tiling.edge, tiling.origin), tiling.edge
    micro, arrays = tiling.tileset.micro, tiling.arrays
    pieces, kernels = micro.pieces, micro.pieces.kernels
    sites = np.full((len(pieces), 3), np.nan)
    sites[: pieces.interiors] = sites_of(arrays)
    if faces_differ:
        for axis, faces in enumerate(arrays.faces):
            place = np.argwhere(faces >= 0)
            sites[pieces.interiors + axis * pieces.colors + faces[tuple(place.T)]] = place - arrays.halo
    sites[pieces.interiors + 3 * pieces.colors :] = sites[pieces.codes // (6 * pieces.colors)] if pieces.colors else 0
    box = np.array(arrays.shape, np.float64)

    def shaped(
        first: NDArray[np.int64], ends: tuple[NDArray[np.float64], ...], name: str, usual: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
        """Factors of the radii of kernels in the middle of `ends`, and metrics; 1 and plain where no place is known."""
        n = len(ends[0])
        factor, metric = np.ones(n), np.tile(PLAIN, (n, 1)) if "stretch" in grading else None
        for begin in range(0, n, _AT_A_TIME):  # there may be millions
            part = slice(begin, min(begin + _AT_A_TIME, n))
            piece = np.searchsorted(first, np.arange(n)[part], side="right") - 1
            place = np.mean([end[part] for end in ends], axis=0) + sites[piece]
            known = begin + np.flatnonzero(np.isfinite(place[:, 0]))
            # what lies beyond the box is like its border
            at = np.clip(place[known - begin], 0.0, box) * edge + np.array(tiling.origin)
            if "scale" in grading:
                factor[known] = grading["scale"].at(at)
            if name in grading:
                factor[known] = grading[name].at(at) / (usual * edge)
            found = metric_at(grading, at)
            if metric is not None and found is not None:
                metric[known] = found
        return factor, None if metric is None else frozen(metric)

    if not micro.additive and "stretch" in grading:
        raise ConfigError("walls can't be stretched", hint="stretch structures that end with `field.gaussian`")
    profile = TUNNEL_PROFILES[kernels.profile]
    usual = PORE_PROFILE.radius(float(np.median(kernels.omega)), micro.level) if len(kernels.omega) else 1.0
    factor, metric = shaped(pieces.first_pore, (kernels.centers,), "pore_radius", usual)
    kernels = kernels._replace(omega=frozen(kernels.omega * PORE_PROFILE.scaled_radius(factor)), pore_metric=metric)
    usual = profile.radius(float(np.median(kernels.mu)), micro.level) if len(kernels.mu) else 1.0
    factor, metric = shaped(pieces.first_tunnel, (kernels.starts, kernels.ends), "tunnel_radius", usual)
    kernels = kernels._replace(mu=frozen(kernels.mu * profile.scaled_radius(factor)), tunnel_metric=metric)
    changed = replace(pieces, kernels=kernels)
    return replace(tiling, tileset=replace(tiling.tileset, micro=replace(micro, pieces=changed)))
