"""Errors of stiffness on voxels: cells at 32 and 64 voxels along the edge against the limit of finer grids.

    python -m benchmarks.partial_voxels [--held-out] [KEPT.json]

The two weights of the extrapolation and the constants of the error bar were fitted to the 20 cells of `CELLS`;
`--held-out` takes twelve that had no part in that. The truth is Young's modulus by a ramp of the solid fraction on 96
and 144 voxels, extrapolated with an error that falls with the square of the voxel, and so by another rule than that of
the stage. Each set takes about ten minutes of one core; what was computed is kept in KEPT.json, if that is given, so
that a run that was stopped goes on where it was.
Needs the structures: pip install ./plugins/sppm-structures
"""

from __future__ import annotations

import argparse
import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import sppm_pipeline as sppm
from sppm_pipeline.features.stiffness.numerics.elasticity import stiffness
from sppm_pipeline.features.stiffness.stages.homogenize_voxel import HomogenizeVoxel
from sppm_pipeline.method.porosity.fractions import stiff_share
from sppm_pipeline.services.elastic.isotropy import nearest_isotropic
from sppm_pipeline.services.elastic.voigt import lame
from sppm_pipeline.testing.plain_context import PlainContext

WIDE = [
    {"stage": "sample.mirrored_faces", "total": 95, "share": 0.5},
    {"stage": "sample.dart_throwing", "total": 95},
    {"stage": "connect.mbdst", "degree": [3, 5], "mode": "greedy"},
    {"stage": "field.gaussian", "pore_radius": 0.1075, "tunnel_radius": 0.0658},
]
"""Wide tunnels between 95 pores, which the level makes small."""

RECIPES: dict[str, Any] = {
    "paper": "paper",
    "stiff": "stiff",
    "wide": WIDE,
    "gyroid": [{"stage": "field.tpms", "surface": "gyroid", "form": "sheet"}],
    "openfoam": [{"stage": "field.voronoi_foam", "form": "open"}],
    "spinodoid": [{"stage": "field.spinodoid"}],
    **{name: [{"stage": "field.struts", "lattice": name}] for name in ("octet", "kelvin")},
    "diamond": [{"stage": "field.tpms", "surface": "diamond", "form": "sheet"}],
    "iwp": [{"stage": "field.tpms", "surface": "iwp"}],
}
#: Recipe, porosity, seed, Young's modulus of what fills the void.
CELLS = (
    *((name, porosity, 1, 0.0) for name in ("paper", "stiff", "wide", "gyroid") for porosity in (0.3, 0.5, 0.7)),
    ("paper", 0.7, 2, 0.0),
    *((name, porosity, 1, 0.0) for name in ("openfoam", "spinodoid") for porosity in (0.5, 0.7)),
    *((name, 0.5, 1, 1e-3) for name in ("paper", "gyroid", "spinodoid")),
)
#: Other draws, porosities, structures and contrasts.
HELD_OUT = (
    ("stiff", 0.6, 3, 0.0),
    ("paper", 0.6, 4, 0.0),
    ("octet", 0.7, 1, 0.0),
    ("wide", 0.6, 3, 0.0),
    ("paper", 0.4, 3, 0.01),
    ("kelvin", 0.6, 1, 0.0),
    ("spinodoid", 0.6, 2, 0.0),
    ("diamond", 0.6, 1, 0.0),
    ("stiff", 0.4, 5, 0.0),
    ("iwp", 0.4, 1, 0.0),
    ("wide", 0.4, 2, 0.0),
    ("openfoam", 0.6, 3, 0.0),
)


def modulus(share: NDArray[np.float32], filling: float) -> float:
    """Young's modulus of the nearest isotropic material, for shares of the stiffness of the solid."""
    lam, mu = lame(1.0, 0.3)
    young = (filling + (1 - filling) * share).astype(np.float32)
    return nearest_isotropic(stiffness(np.float32(lam) * young, np.float32(mu) * young, tolerance=1e-3).stiffness).young


def truth(field: sppm.ScalarField, filling: float) -> tuple[float, float]:
    """Limit of the ramp on 96 and 144 voxels, and how far that of 64 and 96 voxels lies from it."""
    values = []
    for count in (64, 96, 144):
        fraction = HomogenizeVoxel(resolution=count).sampled(field, 1).fraction
        assert fraction is not None
        values.append(modulus(np.ascontiguousarray(stiff_share(fraction).T), filling))
    coarser, finer = (fine - (coarse - fine) / (1.5**2 - 1) for coarse, fine in itertools.pairwise(values))
    return finer, abs(coarser / finer - 1)


def errors_of(field: sppm.ScalarField, filling: float, count: int, limit: float) -> list[float]:
    """Errors on a grid in percent, of the default, ramp on two grids and one, fraction, whole voxels; and the bar."""
    fillings: dict[str, Any] = {"filling_young": filling} if filling else {}
    stage = HomogenizeVoxel(resolution=count, **fillings)
    summary = stage.run(PlainContext(), field).summary()
    fine, half = (HomogenizeVoxel(resolution=n).sampled(field, 1).fraction for n in (count, count // 2))
    assert fine is not None
    assert half is not None
    coarse, ramp, *others = (
        modulus(np.ascontiguousarray(share.T), filling)
        for share in (stiff_share(half), stiff_share(fine), fine, (fine > 0.5).astype(np.float32))
    )
    values = (summary["E_relative"], ramp - (coarse - ramp) / 3, ramp, *others)
    return [100 * (value / limit - 1) for value in values] + [100 * summary["E_relative_error"] / limit]


def main() -> None:
    """Print the errors of the default, of four other rules, and how often bars cover."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--held-out", action="store_true", help="cells on which nothing was calibrated")
    parser.add_argument("kept", type=Path, nargs="?", help="file that keeps limits of fine grids, and errors")
    given = parser.parse_args()
    kept: Path | None = given.kept
    known: dict[str, Any] = json.loads(kept.read_text()) if kept and kept.is_file() else {}

    def keep(**found: Any) -> None:
        known.update(found)
        if kept:
            kept.write_text(json.dumps(known, indent=1))

    doubts = []
    found: dict[int, list[list[float]]] = {32: [], 64: []}
    print("| cell | voxels | error | error bar | ramp, two grids | ramp, one grid | in proportion | whole voxels |")
    print("|---" * 8 + "|")
    for name, porosity, seed, filling in HELD_OUT if given.held_out else CELLS:
        key = f"{name} {porosity} {seed} {filling:g}"
        field = sppm.tune.porosity(recipe=RECIPES[name], target=porosity, seed=seed)
        if key not in known:
            limit, doubt = truth(field, filling)
            keep(**{key: limit, f"{key} doubt": doubt})
        doubts.append(100 * known[f"{key} doubt"])
        for count, rows in found.items():
            if f"{key} {count}" not in known:
                keep(**{f"{key} {count}": errors_of(field, filling, count, known[key])})
            rows.append(known[f"{key} {count}"])
            *errors, bar = rows[-1]
            words = " | ".join(f"{value:+.1f}" for value in errors[1:])
            print(f"| {key} | {count} | {errors[0]:+.1f} | {bar:.1f} | {words} |", flush=True)
    for count, rows in found.items():
        *rules, bars = np.abs(np.array(rows)).T
        print(f"{count} voxels, mean and largest error in percent: ", end="")
        print(", ".join(f"{errors.mean():.1f} {errors.max():.1f}" for errors in rules), end="; ")
        default = rules[0]
        print(f"{int((default <= 3).sum())} within 3, {int((default <= 1).sum())} within 1 %; ", end="")
        print(f"{int((default <= bars).sum())} of {len(bars)} bars cover, {bars.mean():.1f} % in the mean")
    print(f"limits of 64 and 96 voxels differ by {np.mean(doubts):.2f} % in the mean, {max(doubts):.2f} % at most")


if __name__ == "__main__":
    main()
