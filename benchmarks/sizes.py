"""Twenty random pairs of pore and strut: what `design.sizes` promises and what blocks laid by it have.

    python -m benchmarks.sizes [--pairs 20] [--seed 1] [--throat]

Ratios are drawn evenly from 0.35 to 1.2 (of struts to throats from 0.55 to 1.3), pores from 0.2 to 2 mm evenly in their
logarithm. Each block of 2 x 2 x 2 cells is laid by `tile.scattered` with pores of its own and measured by `check.sizes`
in the limit of fine grids. With ``--throat`` a pair is that of strut and throat, which is measured in one
further cell on grids of 112 and 224.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

import sppm_pipeline as sppm
from sppm_pipeline.features.design.stages.design_sizes import TOO_NARROW, throat

RECIPE = """
    - {stage: sample.mirrored_faces, total: 95, share: 0.5}
    - {stage: sample.hyperuniform, total: 95}
    - {stage: connect.mbdst, degree: [3, 5], mode: greedy}
    - {stage: field.gaussian, pore_radius: 0.1075, tunnel_radius: 0.0231}
"""

BLOCK = """
sppm: 1
name: block
recipes:
  cell:{recipe}
pipeline:
  - {{stage: design.sizes, recipe: cell, {word}: {pore} mm, strut: {strut} mm}}
  - {{stage: tile.scattered, recipe: cell, cells: [{cells}, {cells}, {cells}], periodic: true}}
  - {{stage: check.sizes, resolution: {voxels}}}
"""


def throat_of(tiling: sppm.Tiling) -> float:
    """Diameter in mm of the largest ball that passes the void of a periodic cell, in the limit of fine grids."""
    found = []
    for voxels in (112, 224):  # twice as fine as designs see it, so that the limit is known to 2 %
        values = np.ascontiguousarray(tiling.sample(voxels)).astype(np.float32)
        found.append((throat([values], float((values >= 0).mean())) - TOO_NARROW) / voxels)
    return (2 * found[1] - found[0]) * tiling.edge_mm


def main() -> None:
    """Print a row of a table for each pair."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--throat", action="store_true", help="pairs of strut and throat")
    args = parser.parse_args()
    word, ends = ("throat", (0.55, 1.3)) if args.throat else ("pore", (0.35, 1.2))
    rng = np.random.default_rng(args.seed)
    print(f"| strut, {word} asked (mm) | cell (mm) | porosity | strut, {word} of the block (mm) | errors (%) | CPU-s |")
    print("|---|---|---|---|---|---|", flush=True)
    worst = 0.0
    for number in range(args.pairs):
        pore = round(float(np.exp(rng.uniform(np.log(0.2), np.log(2.0)))), 3)
        strut = round(pore * float(rng.uniform(*ends)), 3)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "block.yaml"
            path.write_text(
                BLOCK.format(
                    word=word,
                    voxels=96 if args.throat else 48,
                    cells=1 if args.throat else 2,
                    recipe=RECIPE,
                    pore=pore,
                    strut=strut,
                ),
                encoding="utf-8",
            )
            started = time.process_time()
            try:
                run = sppm.run(str(path), seed=100 + number, output=str(Path(folder) / "run"))
            except sppm.SppmError as error:
                print(f"| {strut}, {pore} | refused: {error} | | | | {time.process_time() - started:.1f} |", flush=True)
                continue
            numbers = run.numbers
            seconds = numbers.get("design.sizes.seconds", time.process_time() - started)
        found = [numbers[f"check.sizes.{name}.mean"] for name in ("strut", "pore")]
        if args.throat:
            found[1] = throat_of(run["tile.scattered"])
        errors = [100 * (a / b - 1) for a, b in zip(found, (strut, pore), strict=True)]
        worst = max(worst, *map(abs, errors))
        print(
            f"| {strut}, {pore} | {numbers['design.sizes.edge_mm']:.3g} | {numbers['design.sizes.porosity']:.3f} "
            f"| {found[0]:.3g}, {found[1]:.3g} | {errors[0]:+.1f}, {errors[1]:+.1f} | {seconds:.1f} |", flush=True,
        )  # fmt: skip
    print(f"worst: {worst:.1f} %")


if __name__ == "__main__":
    main()
