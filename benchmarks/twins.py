"""Twins of scans: what `tune.match` finds for each, number by number, as a CSV table.

    python -m benchmarks.twins FILE.csv [SCAN[@THRESHOLD] ...] [--draws N] [--evaluations N] [--only WORD]
    python -m benchmarks.twins --page docs/features/scans.md FILE.csv [FILE.csv ...]

SCAN is a gray image, .npy or .npz with one array (x, y, z); Otsu's threshold is taken if none is given. Two images are
made here: a foam of overlapping balls and a cell of this program, both blurred and with noise. Of larger scans the
middle 72 voxels along each edge are taken; the cell of the twin has 48. The number of pores and the radii of pores and
tunnels are varied, DRAWS structures for each trial; of the structure of ours, for which "own" stands, the number
alone, and again with the radius of the tunnels. `wanted` is the goal of the row. Stiffness and permeability are not
matched. Beside the CSV file, a PNG file has the middle of the structures made here on the left, of their twins on the
right. With `--page` the table of a page is made of such files.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from sppm_pipeline.features.scans.image_field import ImageField
from sppm_pipeline.features.scans.stages.tune_match import TuneMatch
from sppm_pipeline.method.fields.scalar_field import ScalarField
from sppm_pipeline.method.stages.connect_mbdst import BoundedDegreeSubgraph
from sppm_pipeline.method.stages.field_gaussian import GaussianField
from sppm_pipeline.method.stages.sample_dart_throwing import DartThrowing
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.segmentation import otsu
from sppm_pipeline.testing.plain_context import PlainContext, recipe_of

OWN = {"sample.dart_throwing.total": 80.0, "field.gaussian.tunnel_radius": 0.03}
"""Options of the own structure, which the twin should find again."""

N, LARGEST = 48, 72
"""Voxels along the cell of a twin, which is 1 mm long, and those of a scan."""

VARIED = {
    "sample.dart_throwing.total": (20.0, 600.0),
    "field.gaussian.tunnel_radius": (0.008, 0.06),
    "field.gaussian.pore_radius": (0.008, 0.08),
}
WANTED = {"porosity": 0.001, "S2": 0.02, "chords": 0.05, "thickness": 0.05, "permeability": 0.15, "stiffness": 0.1}


def recipe(total: int = 100, tunnel: float = 0.03, pore: float = 0.03) -> Any:
    """Pores, tunnels and their field."""
    return recipe_of(
        DartThrowing(total=total, edge=Length(1.0, "mm")),
        BoundedDegreeSubgraph(degree=(3, 5), mode="greedy"),
        GaussianField(pore_radius=Length(pore), tunnel_radius=Length(tunnel)),
    )


def as_scanned(solid: NDArray[np.bool_], seed: int) -> NDArray[np.float32]:
    """Gray values of 0 to 1: blurred by 0.8 voxels, with noise of a tenth, and smoothed as one would before reading."""
    noise = np.random.default_rng(seed).normal(0, 0.1, solid.shape)
    gray = gaussian_filter(solid.astype(np.float32), 0.8, mode="wrap") + noise.astype(np.float32)
    return np.asarray(gaussian_filter(gray, 0.5, mode="wrap"), np.float32)


def foam(n: int = N, seed: int = 3) -> NDArray[np.float32]:
    """Solid between 60 overlapping balls of a tenth of the edge and more, which repeat."""
    rng = np.random.default_rng(seed)
    centers, radii = rng.random((60, 3)), 0.12 * (1 + 0.25 * rng.random(60))
    axis = (np.arange(n) + 0.5) / n
    solid = np.ones((n, n, n), bool)
    for center, radius in zip(centers, radii, strict=True):
        away = [np.minimum(abs(axis - c), 1 - abs(axis - c)) ** 2 for c in center]
        solid &= away[0][:, None, None] + away[1][:, None] + away[2] > radius**2
    return as_scanned(solid, seed)


def own(n: int = N) -> NDArray[np.float32]:
    """A cell of this program of another seed, 60 % void."""
    total, tunnel = OWN.values()
    values = recipe(int(total), tunnel).run(PlainContext(77)).sample(n)
    return as_scanned(values < np.quantile(values, 0.4), 0)


def read(path: str) -> tuple[NDArray[np.float32], float]:
    """Gray values of the middle of a scan, and their threshold."""
    name, _, level = path.partition("@")
    with open(name, "rb") as file:
        given = np.load(file)
        image = np.asarray(given if isinstance(given, np.ndarray) else given[given.files[0]], np.float32)
    image = image[tuple(slice(max(0, (n - LARGEST) // 2), (n + LARGEST) // 2) for n in image.shape)]
    return image, float(level) if level else otsu(image)


def scans(paths: list[str]) -> list[tuple[str, int, ScalarField]]:
    """All scans as fields."""
    found = [(name, own(), 0.5, True) for name in ("own, number", "own, number and radius")]
    found += [("foam of overlapping balls", foam(), 0.5, True)]
    found += [(Path(path.partition("@")[0]).stem, *read(path), False) for path in paths]
    return [
        (name, min(gray.shape), ImageField.through(
            np.asfortranarray(np.float32(level) - gray), (1 / N,) * 3, physical=True, periodic=repeats,
        )) for name, gray, level, repeats in found
    ]  # fmt: skip


def rows(
    name: str, scan: ScalarField, n: int, draws: int, evaluations: int
) -> tuple[ScalarField, list[dict[str, Any]]]:
    """The twin, and a row for each number."""
    context = PlainContext(1)
    # the level that meets the porosity makes up for radii that are all larger: of a structure of ours one is known
    ours = list(OWN)[: 1 + name.endswith("radius")] if name.startswith("own") else list(VARIED)
    varied = {option: VARIED[option] for option in ours}
    twin = TuneMatch(
        vary=tuple(varied), low=tuple(a for a, _ in varied.values()), high=tuple(b for _, b in varied.values()),
        starts=evaluations // 2, evaluations=evaluations, draws=draws, resolution=n,
    ).run(context, recipe(), scan)  # fmt: skip
    found = context.reported
    off = {
        "porosity": found["porosity"],
        "S2": found["S2"],
        **{f"{kind}, {phase}": found[kind][phase] for kind in ("chords", "thickness") for phase in ("solid", "void")},
        **{kind: found["held_out"][kind] for kind in ("permeability", "stiffness")},
    }
    made = []
    for quantity, value in off.items():
        wanted = WANTED[quantity.split(",")[0]]
        made.append({
            "scan": name, "quantity": quantity, "difference": value, "wanted": wanted,
            "met": value is not None and abs(value) <= wanted,
        })  # fmt: skip
    for option, value in zip(varied, found["values"], strict=True):
        truth = OWN.get(option) if name.startswith("own") else None
        off_truth = value if truth is None else value / truth - 1
        made.append({
            "scan": name, "quantity": option, "difference": off_truth, "wanted": "" if truth is None else 0.05,
            "met": "" if truth is None else abs(off_truth) <= 0.05,
        })  # fmt: skip
    return twin, made


def draw(scan: ScalarField, twin: ScalarField, path: Path) -> None:
    """Middle sections of a scan and its twin side by side, solid dark."""
    from PIL import Image

    from sppm_pipeline.services.grid import Grid

    n = 240
    grid = Grid((0.5 / n, 0.5 / n, 0.5), (1 / n, 1 / n, 1.0), (n, n, 1))
    parts = [np.where(field.sample(grid)[:, :, 0].T[::-1] < 0, 60, 255).astype(np.uint8) for field in (scan, twin)]
    between = np.full((n, 12), 160, np.uint8)
    Image.fromarray(np.concatenate([parts[0], between, parts[1]], axis=1)).save(path)


def write_page(page: Path, files: list[Path]) -> None:
    """Put a table of all files between the marks of a page."""
    columns: dict[str, dict[str, str]] = {}
    for path in files:
        with path.open(encoding="utf-8") as file:
            for row in csv.DictReader(file):
                quantity = row["quantity"].rpartition(".")[2].replace("_", " ")
                value = float(row["difference"])
                percent = f"{100 * value:+.1f} %" if row["wanted"] and quantity != "S2" else f"{value:.3g}"
                shown = percent if row["met"] != "False" else f"**{percent}**"
                columns.setdefault(row["scan"], {})[quantity] = shown
    names = list(dict.fromkeys(name for column in columns.values() for name in column))
    lines = ["| | " + " | ".join(columns) + " |", "|---" * (len(columns) + 1) + "|"]
    lines += [
        "| " + " | ".join([name, *(column.get(name, "") for column in columns.values())]) + " |" for name in names
    ]
    text, mark = page.read_text(encoding="utf-8"), "<!-- benchmarks.twins -->\n"
    before, _, after = text.split(mark)
    page.write_text(f"{before}{mark}" + "\n".join(lines) + f"\n{mark}{after}", encoding="utf-8")


def main() -> None:
    """Write the table, and print each row as it is found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("scans", nargs="*")
    parser.add_argument("--draws", type=int, default=2)
    parser.add_argument("--evaluations", type=int, default=60)
    parser.add_argument("--page", type=Path, help="a page whose table is made of the files instead")
    parser.add_argument("--only", help="part of the names of the scans that are taken")
    args = parser.parse_args()
    if args.page:
        write_page(args.page, [args.file, *map(Path, args.scans)])
        return
    with args.file.open("w", newline="", encoding="utf-8") as file:
        writer = None
        for name, n, scan in scans(args.scans):
            if args.only and args.only not in name:
                continue
            twin, found = rows(name, scan, n, args.draws, args.evaluations)
            if name.startswith(("own", "foam")):
                draw(scan, twin, args.file.with_name(f"{args.file.stem}-{name.split(',')[0].split()[0]}.png"))
            for row in found:
                writer = writer or csv.DictWriter(file, list(row))
                if file.tell() == 0:
                    writer.writeheader()
                writer.writerow(row)
                file.flush()
                print(*row.values(), sep=" | ", flush=True)


if __name__ == "__main__":
    main()
