"""Sheets between two random networks beside other open structures: stiffness, permeability and surface.

    python -m benchmarks.sheets [NAMES ...] [--draws 10] [--resolution 64] [--porosity 0.7]
    python -m benchmarks.sheets --waves [--draws 10]

Stiffness is that of the limit of fine grids (`homogenize.voxel`, two grids), permeability k and surface S are those of
the field on the grid. k S^2 has no scale: it says how open a structure is for its surface.
"""

from __future__ import annotations

import argparse

import numpy as np
from numpy.typing import NDArray

import sppm_pipeline as sppm
from sppm_pipeline.features.flow.stages.homogenize_permeability import HomogenizePermeability
from sppm_pipeline.features.sheet.numerics.waves import Waves
from sppm_pipeline.features.sheet.stages.field_sheet import SheetField, SheetStage
from sppm_pipeline.features.stiffness.stages.homogenize_voxel import HomogenizeVoxel
from sppm_pipeline.method.fields.scalar_field import ScalarField
from sppm_pipeline.method.porosity.level import cut_for_porosity
from sppm_pipeline.method.stages.sample_dart_throwing import DartThrowing
from sppm_pipeline.testing.plain_context import PlainContext, recipe_of

SAMPLER = {"stage": "sample.dart_throwing", "total": 95}
RECIPES: dict[str, list[dict[str, object]]] = {
    "preset `open`": [{"preset": "open"}],
    "sheet, equal shares": [SAMPLER, {"stage": "field.sheet"}],
    "sheet, equal shares, 100 steps": [SAMPLER, {"stage": "field.sheet", "relaxation": 100}],
    "sheet, equal shares, not relaxed": [SAMPLER, {"stage": "field.sheet", "relaxation": 0}],
    "sheet, scattered pores": [SAMPLER, {"stage": "field.sheet"}],
    "gyroid sheet": [],
    "preset `stiff`": [{"preset": "stiff"}],
    "preset `paper`": [{"preset": "paper"}],
}
"""Structures of the table by name."""

DIGITS = (3, 2, 3, 4, 3)
"""Digits of the means."""


def gyroid() -> SheetField:
    """A gyroid sheet of one period, as the sum of six waves."""
    real, imaginary = np.zeros((2, 3, 3)), np.zeros((2, 3, 3))
    for kx, ky, kz, sign in ((1, 1, 0, 1), (1, -1, 0, 1), (0, 1, 1, 1), (0, 1, -1, 1), (1, 0, 1, 1), (1, 0, -1, -1)):
        imaginary[kx, ky + 1, kz + 1] = -0.5 * sign
    return SheetField(waves=Waves(real, imaginary), middle=0.0, half_width=0.5, slope=1.0)


def drawn(name: str, seed: int, porosity: float) -> ScalarField:
    """A draw of a structure at a porosity."""
    if name == "gyroid sheet":
        field = gyroid()
        return field.cut_at(cut_for_porosity(field.sample(96), porosity).level)
    recipe, stages = RECIPES[name], [{"stage": "tune.porosity", "id": "made", "recipe": "cell", "target": porosity}]
    if name == "sheet, scattered pores":
        stages = [{"stage": "tile.scattered", "id": "made", "recipe": "cell", "cells": [1, 1, 1], "periodic": True,
                   "porosity": porosity, "resolution": 96}]  # fmt: skip
    cell = recipe[0] if "preset" in recipe[0] else recipe
    return sppm.Pipeline(stages, recipes={"cell": cell}, seed=seed).run()["made"]


def measured(field: ScalarField, resolution: int) -> list[float]:
    """E, universal anisotropy, k, S, k S^2."""
    stiff = HomogenizeVoxel(resolution=resolution).run(PlainContext(0), field).summary()
    flow = HomogenizePermeability(resolution=resolution, grids=1).run(PlainContext(0), field)
    open_ = flow.k_mean * flow.surface**2 if flow.surface is not None else np.nan
    return [stiff["isotropic"]["E"], stiff["universal_anisotropy"], flow.k_mean, flow.surface or np.nan, open_]


def row(name: str, found: NDArray[np.float64]) -> str:
    """A row of the table: means, standard deviations, and the least or largest of a draw; found (draws, 5)."""
    mean, draws = found.mean(0), len(found)
    spread = found.std(0, ddof=1) if draws > 1 else np.zeros(5)
    values = [f"{m:.{d}g}" + (f" ± {s:.1g}" if draws > 1 else "") for m, s, d in zip(mean, spread, DIGITS, strict=True)]
    stiff, alike, k, surface, through = values
    return (
        f"| {name} | {draws} | {stiff} | {found[:, 0].min():.4f} | {alike} | {found[:, 1].max():.3f} | {k} "
        f"| {surface} | {through} | {found[:, 4].min():.4f} |"
    )


def print_waves(draws: int) -> None:
    """Print the effective number of waves, one over the sum of their squared shares of the power, mean of draws."""
    steps = (0, 10, 20, 40, 80, 160)
    print(
        "| pores, band | " + " | ".join(f"{n} steps" for n in steps) + " |\n|---" + "|---" * len(steps) + "|",
        flush=True,
    )
    for pores, band in ((95, 0.2), (95, 0.12), (225, 0.2)):
        means = []
        for n in steps:
            cell = recipe_of(DartThrowing(total=pores), SheetStage(band=band, relaxation=n))
            waves = [cell.run(PlainContext(1 + i)).waves for i in range(draws)]
            power = [(w.real**2 + w.imaginary**2) for w in waves]
            means.append(float(np.mean([p.sum() ** 2 / (p**2).sum() for p in power])))
        print(f"| {pores}, {band:g} | " + " | ".join(f"{m:.1f}" for m in means) + " |", flush=True)


def main() -> None:
    """Print a row of a table for each structure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", default=list(RECIPES))
    parser.add_argument("--draws", type=int, default=10)
    parser.add_argument("--resolution", type=int, default=64)
    parser.add_argument("--porosity", type=float, default=0.7)
    parser.add_argument("--waves", action="store_true", help="print how many waves share the power instead")
    args = parser.parse_args()
    if args.waves:
        print_waves(args.draws)
        return
    print("| structure | draws | E / E_s | least | A^U | largest | k / L^2 | S L | k S^2 | least |")
    print("|---|---|---|---|---|---|---|---|---|---|", flush=True)
    for name in args.names:
        seeds = range(1, 2 if name == "gyroid sheet" else 1 + args.draws)
        found = [measured(drawn(name, seed, args.porosity), args.resolution) for seed in seeds]
        print(row(name, np.array(found)), flush=True)


if __name__ == "__main__":
    main()
