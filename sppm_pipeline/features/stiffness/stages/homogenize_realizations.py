"""``homogenize.realizations``: mean and spread of stiffness over draws and sizes of assemblies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from sppm_pipeline import Context, Palette, Recipe, RecipeSize, ScalarField, Size, Table, option, options
from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.stiffness.stages.homogenize_voxel import ElasticHomogenizer

NUMBERS = ("porosity", "E_x", "E_y", "E_z", "E_fit", "nu_xy", "nu_fit", "xi", "xi_relative", "universal_anisotropy")


@dataclass(frozen=True, kw_only=True)
class HomogenizeRealizations(ElasticHomogenizer):
    """Homogenize many draws of a recipe, and assemblies of several sizes (paper, Fig. "different sizes").

    Each draw has random numbers of its own. For an assembly of k x k x k cells the tile stage of the recipe lays
    ``cells: [k, k, k]`` that repeat. The table has one row a draw; the summary holds for each size the mean, the
    standard deviation and the half-width of the 95 % confidence interval of the mean (Student's t), which shrink as
    an assembly grows into a representative volume element.
    """

    name: ClassVar[str] = "homogenize.realizations"
    version: ClassVar[int] = 4

    draws: int = options.draws(10, note="for each size", maximum=100_000, formerly="samples")
    assemblies: tuple[int, ...] = option((1,), help="cells along the edge of each assembly", minimum=1, maximum=64)

    def estimate(self, palette: Palette, recipe: RecipeSize) -> Size:
        made = recipe(palette, self.draws * len(self.assemblies))
        boxes = [made if not made.cells else made.in_box((size,) * 3) for size in self.assemblies]
        found = [self.solving(box, self.draws) for box in boxes]
        return Size(
            samples=sum(s.samples for s in found), sums=sum(s.sums for s in found),
            voxels=sum(s.voxels for s in found), resident=max(s.resident for s in found),
        )  # fmt: skip

    def run(self, context: Context, recipe: Recipe) -> Table:
        """Draw and homogenize."""
        tiler = _tile_stage(recipe)
        if tiler is None and set(self.assemblies) != {1}:
            raise ConfigError(
                f"the recipe {recipe.name!r} lays no cells, so that there are no assemblies of {list(self.assemblies)}",
                hint="end the recipe with a tile stage, such as `tile.wang_3color` with `cells: [2, 2, 2]`",
            )
        rows: list[dict[str, float | None]] = []
        total = self.draws * len(self.assemblies)
        for size in self.assemblies:
            changes = {} if tiler is None else {tiler: {"cells": [size] * 3, "periodic": True}}
            for sample in range(self.draws):
                made = recipe.run(context, palette=context.palette, attempt=1 + len(rows), options=changes)
                if not isinstance(made, ScalarField):
                    raise ConfigError(f"the recipe {recipe.name!r} makes a {type(made).__name__}, no field")
                summary = self.stiffness_of(context, made).summary()
                rows.append({"cells": size, "sample": sample, **_numbers(summary)})
                context.progress(len(rows), total, "realizations")
        sizes = {str(size): _statistics([row for row in rows if row["cells"] == size]) for size in self.assemblies}
        context.report(samples=self.draws, sizes=sizes)
        return Table({name: tuple(row[name] for row in rows) for name in rows[0]})


def _tile_stage(recipe: Recipe) -> str | None:
    """The stage of the recipe that lays boxes of cells."""
    found = [id_ for id_, options in recipe.options().items() if {"cells", "periodic"} <= set(options)]
    if len(found) > 1:
        raise DesignError(f"the recipe {recipe.name!r} lays cells more than once: {', '.join(found)}")
    return found[0] if found else None


def _numbers(summary: Mapping[str, Any]) -> dict[str, float | None]:
    """The columns of the table; None where a structure without stiffness has no such number."""
    young, fit = summary["E"], summary["isotropic"]
    values = {
        "porosity": summary["porosity"], "E_x": young[0], "E_y": young[1], "E_z": young[2], "E_fit": fit["E"],
        "nu_xy": summary["nu"]["xy"], "nu_fit": fit["nu"], "xi": summary["xi"], "xi_relative": summary["xi_relative"],
        "universal_anisotropy": summary["universal_anisotropy"],
    }  # fmt: skip
    return {name: float(value) if np.isfinite(value) else None for name, value in values.items()}


def _statistics(rows: list[dict[str, float | None]]) -> dict[str, Any]:
    """Mean, standard deviation and confidence of each number over the draws that have it."""
    from scipy.special import stdtrit

    found: dict[str, Any] = {}
    for name in NUMBERS:
        values = np.array([row[name] for row in rows if row[name] is not None], np.float64)
        spread = float(values.std(ddof=1)) if len(values) > 1 else None
        half = None if spread is None else float(stdtrit(len(values) - 1, 0.975)) * spread / len(values) ** 0.5
        found[name] = {
            "mean": float(values.mean()) if len(values) else None, "deviation": spread, "confidence_95": half,
            "count": len(values),
        }  # fmt: skip
    return found
