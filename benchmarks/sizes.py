"""Twenty random pairs of pore and strut: what `design.sizes` promises and what blocks laid by it have.

    python -m benchmarks.sizes [--pairs 20] [--seed 1]

Ratios are drawn evenly from 0.35 to 1.2, pores from 0.2 to 2 mm evenly in their logarithm. Each block of 2 x 2 x 2
cells is laid by `tile.scattered` with pores of its own and measured by `check.sizes` in the limit of fine grids.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

import sppm_pipeline as sppm

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
  - {{stage: design.sizes, recipe: cell, pore: {pore} mm, strut: {strut} mm}}
  - {{stage: tile.scattered, recipe: cell, cells: [2, 2, 2], periodic: true}}
  - {{stage: check.sizes, resolution: 48}}
"""


def main() -> None:
    """Print a row of a table for each pair."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    rng = np.random.default_rng(args.seed)
    print("| strut, pore asked (mm) | cell (mm) | porosity | strut, pore of the block (mm) | errors (%) | CPU-s |")
    print("|---|---|---|---|---|---|", flush=True)
    worst = 0.0
    for number in range(args.pairs):
        pore = round(float(np.exp(rng.uniform(np.log(0.2), np.log(2.0)))), 3)
        strut = round(pore * float(rng.uniform(0.35, 1.2)), 3)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "block.yaml"
            path.write_text(BLOCK.format(recipe=RECIPE, pore=pore, strut=strut), encoding="utf-8")
            started = time.process_time()
            try:
                run = sppm.run(str(path), seed=100 + number, output=str(Path(folder) / "run"))
            except sppm.SppmError as error:
                print(f"| {strut}, {pore} | refused: {error} | | | | {time.process_time() - started:.1f} |", flush=True)
                continue
            numbers = run.numbers
            seconds = numbers.get("design.sizes.seconds", time.process_time() - started)
        found = [numbers[f"check.sizes.{name}.mean"] for name in ("strut", "pore")]
        errors = [100 * (a / b - 1) for a, b in zip(found, (strut, pore), strict=True)]
        worst = max(worst, *map(abs, errors))
        print(
            f"| {strut}, {pore} | {numbers['design.sizes.edge_mm']:.3g} | {numbers['design.sizes.porosity']:.3f} "
            f"| {found[0]:.3g}, {found[1]:.3g} | {errors[0]:+.1f}, {errors[1]:+.1f} | {seconds:.1f} |", flush=True,
        )  # fmt: skip
    print(f"worst: {worst:.1f} %")


if __name__ == "__main__":
    main()
