"""How right stiffness is on voxels: 20 cells at 32 and 64 voxels along the edge against the limit of finer grids.

    python -m benchmarks.partial_voxels [TRUTH.json]

The truth is the mean of two extrapolations of Young's modulus from 64 and 128 voxels, one with voxels at the surface in
proportion to their solid fraction, one with a narrow ramp; both err by the power 1.5 of the voxel there, and differ by
0.3 % in the mean and 0.8 % at most on cells of pores, walls and sheets. It takes about ten minutes of one core and is
kept in TRUTH.json, if that is given. Needs the structures: pip install ./plugins/sppm-structures
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import sppm_pipeline as sppm
from sppm_pipeline.features.stiffness.numerics.elasticity import stiffness
from sppm_pipeline.features.stiffness.numerics.refinement import stiff_share
from sppm_pipeline.features.stiffness.stages.homogenize_voxel import HomogenizeVoxel
from sppm_pipeline.services.elastic.isotropy import nearest_isotropic
from sppm_pipeline.services.elastic.voigt import lame
from sppm_pipeline.testing.plain_context import PlainContext

RECIPES: dict[str, Any] = {
    "paper": "paper",
    "stiff": "stiff",
    "permeable": "permeable",
    "gyroid": [{"stage": "field.tpms", "surface": "gyroid", "form": "sheet"}],
    "openfoam": [{"stage": "field.voronoi_foam", "form": "open"}],
    "spinodoid": [{"stage": "field.spinodoid"}],
}
#: Recipe, porosity, seed, Young's modulus of what fills the void.
CELLS = (
    *((name, porosity, 1, 0.0) for name in ("paper", "stiff", "permeable", "gyroid") for porosity in (0.3, 0.5, 0.7)),
    ("paper", 0.7, 2, 0.0),
    *((name, porosity, 1, 0.0) for name in ("openfoam", "spinodoid") for porosity in (0.5, 0.7)),
    *((name, 0.5, 1, 1e-3) for name in ("paper", "gyroid", "spinodoid")),
)


def modulus(share: NDArray[np.float32], filling: float) -> float:
    """Young's modulus of the nearest isotropic material, for shares of the stiffness of the solid."""
    lam, mu = lame(1.0, 0.3)
    young = (filling + (1 - filling) * share).astype(np.float32)
    return nearest_isotropic(stiffness(np.float32(lam) * young, np.float32(mu) * young, tolerance=1e-3).stiffness).young


def truth(field: sppm.ScalarField, filling: float) -> float:
    """Limit of fine grids by two rules."""
    values = []
    for count in (64, 128):
        cell = HomogenizeVoxel(resolution=count).sampled(field, 1)
        assert cell.fraction is not None
        linear = cell.fraction.T
        narrow = np.clip((linear - np.float32(0.35)) / np.float32(0.3), 0, 1)
        values.append([modulus(np.ascontiguousarray(share), filling) for share in (linear, narrow)])
    coarse, fine = np.array(values)
    return float(np.mean(fine - (coarse - fine) / (2**1.5 - 1)))


def main() -> None:
    """Print the errors of the default, of the finest grid alone and of whole voxels, and how often bars cover."""
    kept = Path(sys.argv[1]) if len(sys.argv) > 1 else None
    known: dict[str, float] = json.loads(kept.read_text()) if kept and kept.is_file() else {}
    found: dict[int, list[tuple[float, float]]] = {32: [], 64: []}
    print("| cell | voxels | error | error bar | finest grid alone | in proportion to the fraction | whole voxels |")
    print("|---" * 7 + "|")
    for name, porosity, seed, filling in CELLS:
        key = f"{name} {porosity} {seed} {filling:g}"
        field = sppm.tune.porosity(recipe=RECIPES[name], target=porosity, seed=seed)
        if key not in known:
            known[key] = truth(field, filling)
            if kept:
                kept.write_text(json.dumps(known, indent=1))
        fillings = {"filling_young": filling} if filling else {}
        for count in found:
            stage = HomogenizeVoxel(resolution=count, **fillings)
            summary = stage.run(PlainContext(), field).summary()
            fraction = stage.sampled(field, 1).fraction
            assert fraction is not None
            others = [
                modulus(np.ascontiguousarray(share.T), filling)
                for share in (stiff_share(fraction), fraction, (fraction > 0.5).astype(np.float32))
            ]
            error, *rest = (100 * (value / known[key] - 1) for value in (summary["E_relative"], *others))
            bar = 100 * summary["E_relative_error"] / known[key]
            found[count].append((error, bar))
            words = " | ".join(f"{value:+.1f}" for value in rest)
            print(f"| {key} | {count} | {error:+.1f} | {bar:.1f} | {words} |", flush=True)
    for count, pairs in found.items():
        errors, bars = np.abs(np.array(pairs)).T
        print(
            f"{count} voxels: mean of errors {errors.mean():.2f} %, rms {np.sqrt((errors**2).mean()):.2f} %, largest "
            f"{errors.max():.1f} %; {int((errors <= bars).sum())} of {len(bars)} bars cover"
        )


if __name__ == "__main__":
    main()
