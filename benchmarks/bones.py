"""Structures with the stiffness of measured bones, at their own density: distances, intervals, time.

    python -m benchmarks.bones BONES.csv [--rows 8] [--first 0] [--every 6] [--further 8]

The CSV has a row for each sample, with the columns name, density, C11 ... C66 (the 21 constants over Young's modulus of
the solid, Voigt order 11, 22, 33, 23, 13, 12) and twin_density, twin_C11 ... of a published twin, which is reported
beside. No such data are part of this project. Distances are Frobenius norms in Mandel's basis over that of the target.
`--cells` makes a cell of each design with the tensor itself by `tune.tensor`, and measures it on `CHECKED` voxels along
an edge, which its search has not seen. `--further` draws of each design are made afresh: how many of their 21 constants
lie in the stated interval.
With `--reachable 10` or `--unreachable 5` the targets are made instead: random members of the family, measured on eight
draws of their own, or tensors beyond it.
"""

from __future__ import annotations

import argparse
import csv
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np

import sppm_pipeline as sppm
from sppm_pipeline.features.design.numerics.tensor_fit import stretch_of, turned
from sppm_pipeline.services.elastic.voigt import isotropic, mandel, rotated

UPPER = np.triu_indices(6)
SEED = 1
CHECKED = 72


def matrix(row: dict[str, str], prefix: str = "") -> np.ndarray:
    """The tensor of a row."""
    found = np.zeros((6, 6))
    for i, j in zip(*UPPER, strict=True):
        found[i, j] = found[j, i] = float(row[f"{prefix}C{i + 1}{j + 1}"])
    return found


def distance(found: np.ndarray, target: np.ndarray) -> float:
    """Relative Frobenius distance of tensors."""
    return float(np.linalg.norm(mandel(found - target)) / np.linalg.norm(mandel(target)))


def cell_stiffness(struts: float, porosity: float, stretch: np.ndarray, seed: int, resolution: int) -> np.ndarray:
    """Stiffness of one stretched cell of the preset, along its own axes."""
    cell = sppm.cell("dialed", seed=seed, porosity=porosity, struts=struts)
    return sppm.homogenize.voxel(cell, resolution=resolution, stretch=tuple(map(float, stretch))).stiffness


def designed(target: np.ndarray, porosity: float, args: argparse.Namespace) -> tuple[object, float]:
    """The design, or the error, and CPU seconds."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "target.csv"
        np.savetxt(path, target, delimiter=",")
        started = time.process_time()
        try:
            made = sppm.design.stiffness(
                recipe="dialed", target=path, porosity=porosity, seed=SEED, max_distance=args.max_distance,
                resolution=args.resolution, draws=args.draws,
            )  # fmt: skip
        except sppm.SppmError as error:
            made = error
        return made, time.process_time() - started


def of_a_cell(design: sppm.nouns.StiffnessDesign, target: np.ndarray, args: argparse.Namespace) -> str:
    """Distance of one cell of the design, its error bar, its porosity, and CPU seconds."""
    started = time.process_time()
    try:
        cell = sppm.tune.tensor(recipe="dialed", design=design, seed=SEED, resolution=args.resolution, max_distance=1.0)
    except sppm.SppmError as error:
        return error.message
    seconds = time.process_time() - started
    found = sppm.homogenize.voxel(cell, resolution=CHECKED, stretch=tuple(map(float, design.stretch)))
    off = distance(rotated(found.stiffness, design.rotation), target)
    bar = float(np.linalg.norm(mandel(found.error)) / np.linalg.norm(mandel(found.stiffness)))
    return f"{off:.3f} ± {bar:.3f}, porosity {float(1 - cell.to_numpy(96).mean()):.4f}, {seconds:.0f} s"


def reported(name: str, target: np.ndarray, porosity: float, args: argparse.Namespace, more: str = "") -> float | None:
    """Print a row of the table; the distance."""
    made, seconds = designed(target, porosity, args)
    if isinstance(made, sppm.SppmError):
        print(f"| {name} | {porosity:.4f} | refused: {made.message} | {more} | {seconds:.0f} |", flush=True)
        return None
    inside = []
    for draw in range(args.further):
        c = cell_stiffness(made.options[0][1], porosity, made.stretch, 1000 + draw, args.resolution)
        inside.append(np.abs(rotated(c, made.rotation) - made.stiffness)[UPPER] <= made.draw_error[UPPER])
    share = f"{np.mean(inside):.3f}" if inside else "-"
    more = f"{more} | {of_a_cell(made, target, args)}" if args.cells else more
    print(
        f"| {name} | {porosity:.4f} | {made.distance:.3f} (floor {made.floor:.3f}) | struts {made.options[0][1]:.2f}, "
        f"stretch {', '.join(f'{s:.2f}' for s in made.stretch)} | {share} | {more} | {seconds:.0f} |", flush=True,
    )  # fmt: skip
    return made.distance


def main() -> None:
    """Design for each row, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("table", type=Path, nargs="?")
    parser.add_argument("--rows", type=int, default=8)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--every", type=int, default=6)
    parser.add_argument("--further", type=int, default=0)
    parser.add_argument("--draws", type=int, default=8)
    parser.add_argument("--resolution", type=int, default=56)
    parser.add_argument("--cells", action="store_true")
    parser.add_argument("--max-distance", type=float, default=0.5)
    parser.add_argument("--reachable", type=int, default=0)
    parser.add_argument("--unreachable", type=int, default=0)
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    rng = np.random.default_rng(7)
    found = []
    for number in range(args.reachable):
        struts, porosity, logs = rng.uniform(0, 0.8), rng.uniform(0.6, 0.8), rng.uniform(0, np.log(2.5), 2)
        cells = [
            cell_stiffness(struts, porosity, stretch_of(logs), 500 + d, args.resolution) for d in range(args.draws)
        ]
        target = rotated(np.mean(cells, 0), turned(rng.normal(size=3)))
        found.append(reported(f"member {number}", target, porosity, args, f"made with struts {struts:.2f}"))
    for number in range(args.unreachable):
        # as stiff as twice the bound of Hashin and Shtrikman, or far more auxetic than any member
        porosity = rng.uniform(0.6, 0.8)
        target = isotropic(2 * (1 - porosity), 0.25) if number % 2 else isotropic(0.2 * (1 - porosity), -0.4)
        found.append(reported(f"beyond {number}", rotated(target, np.eye(3)), porosity, args))
    if args.table:
        rows = list(csv.DictReader(args.table.open(encoding="utf-8")))[args.first :: args.every][: args.rows]
        for row in rows:
            target = matrix(row)
            twin = f"{distance(matrix(row, 'twin_'), target):.3f} at density {float(row['twin_density']):.3f}"
            found.append(reported(row["name"], target, 1 - float(row["density"]), args, twin))
    kept = [value for value in found if value is not None]
    if kept:
        print(f"median {np.median(kept):.3f}, worst {max(kept):.3f} of {len(kept)}; {len(found) - len(kept)} refused")


if __name__ == "__main__":
    main()
