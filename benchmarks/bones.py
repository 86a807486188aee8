"""Structures with the stiffness of measured bones, at their own density: distances, intervals, time.

    python -m benchmarks.bones BONES.csv [--rows 8] [--first 0] [--every 6] [--further 8] [--csv FOUND.csv]
    python -m benchmarks.bones --page docs/howto/reach-a-stiffness-tensor.md --csv FOUND.csv [FOUND.csv ...]
    python -m benchmarks.bones --page docs/howto/reach-a-stiffness-tensor.md --made --csv MADE.csv [MADE.csv ...]

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
from benchmarks.measure import between_marks
from sppm_pipeline.features.design.numerics.tensor_fit import stretch_of, turned
from sppm_pipeline.services.elastic.voigt import isotropic, mandel, rotated

Row = dict[str, str | float]

UPPER = np.triu_indices(6)
SEED = 1
CHECKED = 72
NEAR = 0.04
"""Distance within which a member of the family should be met."""
MARK = "<!-- benchmarks.bones -->"
MADE = "<!-- benchmarks.bones made -->"
"""Marks of the page, around the table of samples and around the sentences on targets that were made."""


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


def of_a_cell(design: sppm.nouns.StiffnessDesign, target: np.ndarray, args: argparse.Namespace) -> Row:
    """Distance of one cell of the design, its error bar, its porosity, and CPU seconds."""
    started = time.process_time()
    try:
        cell = sppm.tune.tensor(recipe="dialed", design=design, seed=SEED, resolution=args.resolution, max_distance=1.0)
    except sppm.SppmError as error:
        return {"refused": error.message}
    seconds = time.process_time() - started
    found = sppm.homogenize.voxel(cell, resolution=CHECKED, stretch=tuple(map(float, design.stretch)))
    return {
        "cell": distance(rotated(found.stiffness, design.rotation), target),
        "cell_bar": float(np.linalg.norm(mandel(found.error)) / np.linalg.norm(mandel(found.stiffness))),
        "cell_porosity": float(1 - cell.to_numpy(96).mean()), "cell_seconds": seconds,
    }  # fmt: skip


def measured(name: str, target: np.ndarray, porosity: float, args: argparse.Namespace, more: Row) -> Row:
    """All numbers of a target."""
    made, seconds = designed(target, porosity, args)
    row: Row = {"name": name, "porosity": porosity, "design_seconds": seconds, **more}
    if isinstance(made, sppm.SppmError):
        return {**row, "refused": made.message}
    row |= {"design": made.distance, "floor": made.floor, "struts": made.options[0][1]}
    row |= {f"stretch_{axis}": float(s) for axis, s in zip("xyz", made.stretch, strict=True)}
    inside = []
    for draw in range(args.further):
        c = cell_stiffness(made.options[0][1], porosity, made.stretch, 1000 + draw, args.resolution)
        inside.append(np.abs(rotated(c, made.rotation) - made.stiffness)[UPPER] <= made.draw_error[UPPER])
    if inside:
        row["inside"] = float(np.mean(inside))
    return {**row, **of_a_cell(made, target, args)} if args.cells else row


COLUMNS = (
    "name", "porosity", "made_with", "design", "floor", "struts", "stretch_x", "stretch_y", "stretch_z",
    "design_seconds", "inside", "cell", "cell_bar", "cell_porosity", "cell_seconds", "twin", "twin_density", "refused",
)  # fmt: skip


def added(path: Path, row: Row) -> None:
    """Append a row to the CSV file, which begins with the names of the columns."""
    new = not path.exists()
    with path.open("a", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        if new:
            writer.writeheader()
        writer.writerow({key: f"{value:.4g}" if isinstance(value, float) else value for key, value in row.items()})
    print(", ".join(f"{key} {value:.3g}" if isinstance(value, float) else str(value) for key, value in row.items()))


def words_of(paths: list[Path]) -> str:
    """The table of the page, sorted by density, and the sentence below it."""
    rows = [row for path in paths for row in csv.DictReader(path.open(encoding="utf-8")) if row["twin"]]
    rows.sort(key=lambda row: -float(row["porosity"]))
    found = [
        "| density | design | floor | CPU-s | cell | CPU-s | distance of the twin, at its density |",
        "|---" * 7 + "|",
    ]
    found += [
        f"| {1 - float(r['porosity']):.3f} | {float(r['design']):.3f} | {float(r['floor']):.3f} "
        f"| {float(r['design_seconds']):.0f} | {float(r['cell']):.3f} ± {float(r['cell_bar']):.3f} "
        f"| {float(r['cell_seconds']):.0f} | {float(r['twin']):.3f} at {float(r['twin_density']):.3f} |" for r in rows
    ]  # fmt: skip
    of = {key: np.array([float(row[key]) for row in rows]) for key in ("design", "cell", "twin", "cell_seconds")}
    words = [f"{len(rows)} samples"]
    words += [
        f"{name}: median {np.median(of[key]):.3f}, worst {of[key].max():.3f}"
        for name, key in (("designs", "design"), ("cells", "cell"), ("published twins", "twin"))
    ]
    heavier = np.median([float(r["twin_density"]) / (1 - float(r["porosity"])) for r in rows])
    off = np.abs([float(r["cell_porosity"]) - float(r["porosity"]) for r in rows])
    words[-1] += (
        f". Cells differ from the density of their sample by at most {100 * off.max():.2f} % of the volume; twins are "
        f"{heavier:.2f} times as dense in the median. A cell takes {np.median(of['cell_seconds']):.0f} CPU-s in the "
        f"median and {of['cell_seconds'].max():.0f} at most."
    )
    found += ["", "; ".join(words)]
    return "\n".join(found)


def words_of_made(paths: list[Path]) -> str:
    """What came of members of the family, and of tensors beyond it."""
    rows = [row for path in paths for row in csv.DictReader(path.open(encoding="utf-8"))]
    members = [row for row in rows if row["cell"] and row["made_with"]]
    beyond = [row for row in rows if row["name"].startswith("beyond")]
    refused = sum(bool(row["refused"]) for row in beyond)

    def of(key: str, among: list[dict[str, str]] = members) -> np.ndarray:
        return np.array([float(row[key]) for row in among])

    def spread(key: str) -> str:
        return f"median {np.median(of(key)):.3f}, worst {of(key).max():.3f}"

    off = np.abs(of("cell_porosity") - of("porosity")).max()
    inside = of("inside")
    near = np.mean(of("cell") <= NEAR)
    late = of("design_seconds", beyond)
    return (
        f"{len(members)} random members of the family (`--reachable`), each the mean of other draws, stretched and "
        f"turned: distances of designs, on which draws scatter on either side: {spread('design')}; of one cell of "
        f"`tune.tensor`: {spread('cell')}, {100 * near:.0f} % of them within {NEAR}, at densities that are at most "
        f"{100 * off:.2f} % of the volume off, in {np.median(of('cell_seconds')):.0f} CPU-s in the median and "
        f"{of('cell_seconds').max():.0f} at most.\nOf the constants of further single cells "
        f"{100 * inside.mean():.1f} ± {100 * inside.std(ddof=1) / len(inside) ** 0.5:.1f} % lay in the stated "
        "intervals.\n"
        f"Of {len(beyond)} tensors with twice the solid's share of its modulus, or with a Poisson's ratio of -0.4 "
        f"(`--unreachable`), {refused} were refused with the nearest design, in {late.min():.0f} to "
        f"{late.max():.0f} CPU-s."
    )


def main() -> None:
    """Design for each row, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("table", type=Path, nargs="?")
    parser.add_argument("--csv", type=Path, nargs="*", default=[Path("bones-found.csv")])
    parser.add_argument("--page", type=Path)
    parser.add_argument("--made", action="store_true")
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
    if args.page:
        mark, words = (MADE, words_of_made) if args.made else (MARK, words_of)
        between_marks(args.page, mark, words(args.csv))
        return
    warnings.simplefilter("ignore")
    rng = np.random.default_rng(7)
    for number in range(args.reachable):
        struts, porosity, logs = rng.uniform(0, 0.8), rng.uniform(0.6, 0.8), rng.uniform(0, np.log(2.5), 2)
        rotation = turned(rng.normal(size=3))
        if number < args.first:
            continue
        cells = [
            cell_stiffness(struts, porosity, stretch_of(logs), 500 + d, args.resolution) for d in range(args.draws)
        ]
        target = rotated(np.mean(cells, 0), rotation)
        added(args.csv[0], measured(f"member {number}", target, porosity, args, {"made_with": struts}))
    for number in range(args.unreachable):
        # as stiff as twice the bound of Hashin and Shtrikman, or far more auxetic than any member
        porosity = rng.uniform(0.6, 0.8)
        target = isotropic(2 * (1 - porosity), 0.25) if number % 2 else isotropic(0.2 * (1 - porosity), -0.4)
        added(args.csv[0], measured(f"beyond {number}", target, porosity, args, {}))
    if args.table:
        rows = list(csv.DictReader(args.table.open(encoding="utf-8")))[args.first :: args.every][: args.rows]
        for row in rows:
            target = matrix(row)
            twin: Row = {"twin": distance(matrix(row, "twin_"), target), "twin_density": float(row["twin_density"])}
            added(args.csv[0], measured(row["name"], target, 1 - float(row["density"]), args, twin))


if __name__ == "__main__":
    main()
