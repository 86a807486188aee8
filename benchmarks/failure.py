"""The paper's eight structures of a solid that fails: onset of yield, strength, flatness and energy of each.

    python -m benchmarks.failure onset [DRAWS]               # stress at which 1 % of the solid yields; all axes
    python -m benchmarks.failure bar                         # work of a bar with one weak voxel over that of a crack
    python -m benchmarks.failure disk                        # load that splits a disk, over the closed form
    python -m benchmarks.failure crush ENERGY [CELLS [VOXELS [DRAWS [STRUCTURE...]]]]

`crush` compresses blocks of CELLS^3 cells with VOXELS voxels along a cell and a fracture energy of ENERGY kJ/m2;
stochastic structures by DRAWS seeds along all axes (one seed along z if DRAWS is 0). Structures and material are those
of configs/crush_structures.yaml; numbers beside them are the paper's. Each row is printed when it is known.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from sppm_crushing.numerics.body import body_of
from sppm_crushing.numerics.failing_march import FailingMarch
from sppm_crushing.numerics.march import Load
from sppm_crushing.numerics.material import Material
from sppm_crushing.stages.crush_voxel import CrushVoxel

import sppm_pipeline as sppm
from sppm_pipeline.features.stiffness.stages.measure_onset import MeasureOnset
from sppm_pipeline.testing.plain_context import PlainContext

CONFIG = Path(__file__).parent.parent / "configs" / "crush_structures.yaml"

PAPER = {
    "tpms_p": (1.78, 0.06, 0.067), "tpms_l": (1.49, 0.12, 0.177), "kelvin": (1.65, 0.05, 0.092),
    "octet": (1.55, 0.09, 0.136), "et_1": (2.17, 0.06, 0.096), "et_2": (1.18, 0.15, 0.068),
    "sppm_1": (0.55, 0.45, 0.230), "sppm_2": (0.44, 0.45, 0.184),
}  # fmt: skip
"""Strength in MPa, strain there and work per volume up to there in MJ/m3 (table 1)."""

RESIN: dict[str, Any] = {"young": 1404.0, "poisson": 0.45, "yield_stress": 29.0, "stress_unit": "MPa"}


def field_of(structure: str, cells: int, seed: int) -> Any:
    """The block of a structure, a field."""
    params = {"structure": structure, "cells": [cells] * 3}
    return sppm.run(CONFIG, params, seed=seed, until="tile.periodic")["tile.periodic"]


def is_stochastic(structure: str) -> bool:
    """Whether draws differ."""
    return structure.startswith("sppm")


def spread(values: Sequence[float], digits: int = 2) -> str:
    """Mean and standard deviation, or the value if it is one."""
    mean = f"{np.mean(values):.{digits}f}"
    return mean if len(values) == 1 else f"{mean} ± {np.std(values, ddof=1):.{digits}f}"


def onset(draws: int) -> None:
    """A table of the stress at which 1 % of the solid yields, over axes and draws."""
    print("| structure | draws | onset / MPa | x, y, z of the first draw | paper's strength / MPa | over onset |")
    print("|---|---:|---:|---|---:|---:|")
    for structure, (strength, _, _) in PAPER.items():
        values, first = [], ""
        count = draws if is_stochastic(structure) else 1
        for seed in range(1, count + 1):
            context = PlainContext()
            MeasureOnset(resolution=40, **RESIN).run(context, field_of(structure, 1, seed))
            axes = [context.reported[axis] for axis in "xyz"]
            values += axes
            first = first or ", ".join(f"{value:.2f}" for value in axes)
        over = f"{strength:.2f} | {strength / np.mean(values):.2f}"
        print(f"| {structure} | {count} | {spread(values)} | {first} | {over} |", flush=True)


def bar() -> None:
    """Work to failure, over section and fracture energy, of compressed bars one voxel wide with a weak one."""
    print("| voxels | work over section and fracture energy | unbalanced |\n|---:|---:|---:|")
    for n in (4, 8, 16, 32):
        fracture = 1e-4 * n  # fracture energy 1e-4, height of the bar 1
        weak, strong = (Material(1.0, 0.0, ((0.0, stress),), fracture) for stress in (0.02, 0.021))
        image = np.ones((n, 1, 1), np.uint8)
        image[n // 2] = 2
        march = FailingMarch(body_of(image), (strong, weak), Load(0.06, 0.002))
        march.to(1)
        share = march.shares()["unbalanced"]
        print(f"| {n} | {march.history().work[-1] / fracture:.2f} | {share:.4f} |", flush=True)


def disk() -> None:
    """Load of a brittle disk between plates over pi / 2 times strength, diameter and thickness (the Brazilian test)."""
    print("| voxels along the diameter | load over closed form | unbalanced |\n|---:|---:|---:|")
    for n in (16, 24, 32, 48):
        z, _, x = np.indices((n, 2, n)) + 0.5
        image = (np.hypot(x - n / 2, z - n / 2) < n / 2).astype(np.uint8)
        march = FailingMarch(body_of(image), (Material(1.0, 0.2, (), 3e-5 * n, 0.01),), Load(0.046, 0.002, -1.0))
        march.to(1)
        load = march.history().top.max() / (2 * n) / (np.pi / 2 * 0.01)
        print(f"| {n} | {load:.2f} | {march.shares()['unbalanced']:.4f} |", flush=True)


def crush(energy: float, cells: int = 3, voxels: int = 16, draws: int = 0, *only: str, **options: Any) -> None:
    """A table of strengths and energies."""
    failing = {"failure": "j2", "fracture_energy": energy} if energy > 0 else {}
    print(f"{cells}^3 cells of {voxels}^3 voxels, fracture energy {energy} kJ/m2, {options}")
    print(
        "| structure | runs | density | highest up to 20 % / MPa | at strain | paper "
        "| stress at 5 / 10 / 20 / 30 / 40 % | lowest, highest over mean, 5-40 % | W to 25 % / MJ/m3 | to 40 % "
        "| released | failed | damping | unbalanced | CPU-s |"
    )
    print("|---|---:|---:|---:|---:|---:|---|---|---:|---:|---:|---:|---:|---:|---:|")
    for structure, (strength, _, _) in PAPER.items():
        if only and structure not in only:
            continue
        several = is_stochastic(structure) and draws > 0
        started, bodies = time.process_time(), []
        for seed in range(1, (draws if several else 1) + 1):
            field = field_of(structure, cells, seed)
            for axis in "xyz" if several else "z":
                stage = CrushVoxel(
                    resolution=voxels, axis=axis, strain=0.45, least_strain=0.02, frames=(), plates="friction",
                    **{"rate": 0.01, **RESIN, **failing, **options},
                )  # fmt: skip
                bodies.append(stage.run(PlainContext(), field))
        print(row(structure, bodies, strength, time.process_time() - started), flush=True)


def row(structure: str, bodies: Sequence[Any], strength: float, seconds: float) -> str:
    """A row of the table: means over runs with their standard deviation."""
    peaks, where, levels, flat, work = [], [], [], [], []
    for body in bodies:
        # means over a strain of 0.5 %: single spikes are waves of the march
        grid = np.arange(0.0, 0.4001, 0.001)
        around = np.interp(grid[:, None] + np.linspace(-0.0025, 0.0025, 6), body.strain, body.stress)
        stress = around.mean(axis=1)
        early, later = grid <= 0.2, grid >= 0.05
        peaks.append(float(stress[early].max()))
        where.append(float(grid[early][np.argmax(stress[early])]))
        flat.append((stress[later].min() / stress[later].mean(), stress[later].max() / stress[later].mean()))
        levels.append([float(np.interp(at, grid, stress)) for at in (0.05, 0.1, 0.2, 0.3, 0.4)])
        work.append([float(np.interp(at, body.strain, body.energies["external"])) for at in (0.25, 0.4)])
    numbers = [body.numbers for body in bodies]
    means = {
        name: float(np.mean([one.get(name, 0.0) for one in numbers]))
        for name in ("relative_density", "released", "failed", "damping", "unbalanced")
    }
    low, high = np.mean(flat, axis=0)
    return (
        f"| {structure} | {len(bodies)} | {means['relative_density']:.3f} | {spread(peaks)} | {spread(where, 3)} "
        f"| {strength:.2f} | {' / '.join(f'{value:.2f}' for value in np.mean(levels, axis=0))} | {low:.2f}, {high:.2f} "
        f"| {spread([w[0] for w in work], 3)} | {spread([w[1] for w in work], 3)} | {means['released']:.3f} "
        f"| {means['failed']:.3f} | {means['damping']:.3f} | {means['unbalanced']:.4f} | {seconds:.0f} |"
    )


if __name__ == "__main__":
    what, *more = sys.argv[1:] or ["onset"]
    if what == "onset":
        onset(int(more[0]) if more else 5)
    elif what in ("bar", "disk"):
        {"bar": bar, "disk": disk}[what]()
    else:
        crush(float(more[0]), *map(int, more[1:4]), *more[4:])
