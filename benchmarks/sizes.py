"""Twenty random pairs of pore and strut: what `design.sizes` promises and what blocks laid by it have.

    python -m benchmarks.sizes [--pairs 20] [--seed 1] [--throat]

Ratios are drawn evenly from 0.35 to 1.2 (of struts to throats from 0.55 to 1.3), pores from 0.2 to 2 mm evenly in their
logarithm. Each block of 2 x 2 x 2 cells is laid by `tile.scattered` with pores of its own and measured by `check.sizes`
in the limit of fine grids. With ``--throat`` a pair is that of strut and throat; those of blocks are found by distances
and labels of SciPy.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy import ndimage

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
  - {{stage: design.sizes, recipe: cell, {word}: {pore} mm, strut: {strut} mm}}
  - {{stage: tile.scattered, recipe: cell, cells: [2, 2, 2], periodic: true}}
  - {{stage: check.sizes, resolution: 48}}
"""


def passes(mask: np.ndarray) -> bool:
    """Test whether a periodic phase runs through along each axis: in two periods, a component holds a voxel twice."""
    for axis in range(3):
        twice = np.concatenate([mask, mask], axis)
        labels, _ = ndimage.label(twice)
        first, second = np.split(labels, 2, axis)
        if not ((first == second) & (first > 0)).any():
            return False
    return True


def throat_of(tiling: sppm.Tiling, voxels: int) -> float:
    """Diameter in mm of the largest ball that passes through the void of a periodic block, on one grid."""
    solid = np.asarray(tiling.sample(voxels)) < 0
    n = solid.shape[0] // 4
    distance = ndimage.distance_transform_edt(np.pad(~solid, n, mode="wrap"))[n:-n, n:-n, n:-n]
    low, high = 0.0, float(distance.max())
    while high - low > 0.02:
        middle = (low + high) / 2
        low, high = (middle, high) if passes(distance >= middle) else (low, middle)
    return (2 * low - 1) * tiling.edge_mm / voxels


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
            path.write_text(BLOCK.format(word=word, recipe=RECIPE, pore=pore, strut=strut), encoding="utf-8")
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
            coarse, fine = (throat_of(run["tile.scattered"], voxels) for voxels in (48, 96))
            found[1] = 2 * fine - coarse
        errors = [100 * (a / b - 1) for a, b in zip(found, (strut, pore), strict=True)]
        worst = max(worst, *map(abs, errors))
        print(
            f"| {strut}, {pore} | {numbers['design.sizes.edge_mm']:.3g} | {numbers['design.sizes.porosity']:.3f} "
            f"| {found[0]:.3g}, {found[1]:.3g} | {errors[0]:+.1f}, {errors[1]:+.1f} | {seconds:.1f} |", flush=True,
        )  # fmt: skip
    print(f"worst: {worst:.1f} %")


if __name__ == "__main__":
    main()
