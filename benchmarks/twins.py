"""Twins of scans: what `tune.match` finds for each, number by number, as a CSV table.

    python -m benchmarks.twins FILE.csv [SCAN[@THRESHOLD] ...] [--draws N] [--evaluations N] [--seeds N]
        [--only WORD] [--match KIND ...]
    python -m benchmarks.twins --page docs/features/scans.md FILE.csv [FILE.csv ...]

SCAN is a gray image, .npy or .npz with one array (x, y, z); Otsu's threshold is taken if none is given. Two images are
made here: a foam of overlapping balls and a cell of this program, both blurred and with noise. Of larger scans the
middle 72 voxels along each edge are taken; the cell of the twin has 48. Each has a recipe of its kind, see `RECIPES`;
of the structure of ours, for which "own" stands, the number of pores alone is varied, and again with the radius of the
tunnels. Of each match the nearest of DRAWS structures is taken, and all is done SEEDS times with other random numbers:
`difference` is the mean, `error` the standard deviation. `wanted` is the goal of the row. Stiffness and permeability
are not matched. With `--others` other draws of the foam are compared with it instead; with `--tensor` the twins of a
file go on to `tune.tensor`. Beside the CSV file, a PNG file has the middle of each scan made here on the left, of its
twin on the right. With `--page` the table of a page is made of such files.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from benchmarks.measure import between_marks
from sppm_pipeline.features.scans.image_field import ImageField
from sppm_pipeline.features.scans.numerics.statistics import configurations, fabric
from sppm_pipeline.features.scans.numerics.stretching import matrix_of, stretch_of, stretched
from sppm_pipeline.features.scans.stages.measure_statistics import MeasureStatistics
from sppm_pipeline.features.scans.stages.tune_match import (
    KINDS,
    PROPERTIES,
    Look,
    TuneMatch,
    differences,
    properties_of,
)
from sppm_pipeline.features.stiffness.stages.homogenize_voxel import HomogenizeVoxel
from sppm_pipeline.features.stiffness.stages.tune_tensor import TuneTensor
from sppm_pipeline.features.walls.stages.field_walls import WallsField
from sppm_pipeline.method.families.homogenizer import Quiet
from sppm_pipeline.method.fields.scalar_field import ScalarField
from sppm_pipeline.method.nouns.stiffness_design import StiffnessDesign
from sppm_pipeline.method.porosity.level import cut_for_porosity
from sppm_pipeline.method.stages.connect_mbdst import BoundedDegreeSubgraph
from sppm_pipeline.method.stages.connect_mst import MinimumSpanningTree
from sppm_pipeline.method.stages.connect_relative_neighbors import RelativeNeighbors
from sppm_pipeline.method.stages.field_gaussian import GaussianField
from sppm_pipeline.method.stages.sample_dart_throwing import DartThrowing
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.numerics import cell_centers
from sppm_pipeline.services.segmentation import otsu
from sppm_pipeline.testing.plain_context import PlainContext, recipe_of

OWN = {"sample.dart_throwing.total": 80.0, "field.gaussian.tunnel_radius": 0.03}
"""Options of the own structure, which the twin should find again."""

N, LARGEST = 48, 72
"""Voxels along the cell of a twin, which is 1 mm long, and those of a scan."""

WANTED = {"porosity": 0.001, "S2": 0.02, "chords": 0.05, "thickness": 0.05, "permeability": 0.15, "stiffness": 0.1}


def cell(total: int = 100, tunnel: float = 0.03) -> Any:
    """Pores and tunnels of a cell of this program."""
    return recipe_of(
        DartThrowing(total=total, edge=Length(1.0, "mm")),
        BoundedDegreeSubgraph(degree=(3, 5), mode="greedy"),
        GaussianField(pore_radius=Length(0.03), tunnel_radius=Length(tunnel)),
    )


def balls() -> Any:
    """Scattered balls that overlap: a low level makes the sum of kernels as sharp as the largest of them, and tunnels
    are thinner than voxels.
    """
    return recipe_of(
        DartThrowing(total=60, edge=Length(1.0, "mm"), spacing=Length(0.01)),
        MinimumSpanningTree(),
        GaussianField(
            pore_radius=Length(0.13), tunnel_radius=Length(0.001), level=0.001, tunnel="squared", pore_spread=0.1
        ),
    )


def plates(total: float = 200, share: float = 0.4, tunnel_radius: float = 0.05, struts: float = 0.5) -> Any:
    """Rods and plates: walls between pores of many sizes, with holes where tunnels pierce them, or without middles."""
    return recipe_of(
        DartThrowing(total=int(total), share=share, edge=Length(1.0, "mm")),
        RelativeNeighbors(degree=(3, 12)),
        WallsField(thickness=Length(0.01), tunnel_radius=Length(tunnel_radius), rounding=Length(0.005), struts=struts),
    )


RECIPES: dict[str, tuple[Callable[[], Any], dict[str, tuple[float, float]]]] = {
    "own, number": (cell, {"sample.dart_throwing.total": (20.0, 600.0)}),
    "own, number and radius": (
        cell, {"sample.dart_throwing.total": (20.0, 600.0), "field.gaussian.tunnel_radius": (0.008, 0.06)},
    ),
    "foam of overlapping balls": (
        balls, {"sample.dart_throwing.total": (20.0, 200.0), "field.gaussian.pore_spread": (0.0, 0.4)},
    ),
    "": (plates, {
        "sample.dart_throwing.total": (15.0, 600.0), "sample.dart_throwing.share": (0.02, 0.8),
        "field.walls.tunnel_radius": (0.02, 0.2), "field.walls.struts": (0.0, 1.0),
    }),
}  # fmt: skip
"""Recipes and what is varied, by the scan; "" of all others."""


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
    values = cell(int(total), tunnel).run(PlainContext(77)).sample(n)
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


def matched(
    name: str, scan: ScalarField, n: int, draws: int, evaluations: int, seed: int, kinds: tuple[str, ...]
) -> tuple[Any, Any]:
    """The twin, and quantities by name."""
    context = PlainContext(seed)
    mapping: dict[str, Any] = {}
    recipe, varied = RECIPES.get(name, RECIPES[""])
    if name not in RECIPES:
        report = MeasureStatistics(resolution=n, subcubes=1).run(context, scan)
        mapping = {"stretch": tuple(report.stretch.tolist()), "turn": tuple(report.turn.tolist())}
    # the level that meets the porosity makes up for radii that are all larger: of pores and tunnels one is known
    twin = TuneMatch(
        vary=tuple(varied), low=tuple(a for a, _ in varied.values()), high=tuple(b for _, b in varied.values()),
        starts=evaluations // 2, evaluations=evaluations, draws=draws, resolution=n, match=kinds,
        **mapping,
    ).run(context, recipe(), scan)  # fmt: skip
    found = context.reported
    quantities = quantities_of(found) | {kind: found["held_out"][kind] for kind in ("permeability", "stiffness")}
    for option, value in zip(varied, found["values"], strict=True):
        truth = OWN.get(option) if name.startswith("own") else None
        quantities[option] = value if truth is None else value / truth - 1
    return twin, quantities


def row(name: str, quantity: str, value: float, error: float | str) -> dict[str, Any]:
    """A row of the table."""
    known = name.startswith("own") and quantity in OWN
    wanted = 0.05 if known else WANTED.get(quantity.split(",")[0])
    return {
        "scan": name, "quantity": quantity, "difference": value, "error": error,
        "wanted": "" if wanted is None else wanted, "met": "" if wanted is None else abs(value) <= wanted,
    }  # fmt: skip


def rows(
    name: str, scan: ScalarField, n: int, draws: int, evaluations: int, seeds: int, kinds: tuple[str, ...]
) -> tuple[ScalarField, list[dict[str, Any]]]:
    """A twin, and a row for each number."""
    found = [matched(name, scan, n, draws, evaluations, seed, kinds) for seed in range(1, seeds + 1)]
    further = [kind for kind in PROPERTIES if kind in kinds]
    return found[0][0], rows_of(", ".join([name, *further]), [one[1] for one in found])


def rows_of(name: str, found: list[dict[str, float]]) -> list[dict[str, Any]]:
    """A row for each quantity, with the mean and standard deviation over what was found."""
    made = []
    for quantity in found[0]:
        values = np.array([one[quantity] for one in found], float)
        error = float(values.std(ddof=1)) if len(found) > 1 else ""
        made.append(row(name, quantity, float(values.mean()), error))
    return made


def other_foams(n: int, count: int) -> list[dict[str, Any]]:
    """What other draws of the same foam differ by from the one that is the scan, at its porosity."""

    def seen(seed: int) -> tuple[Look, dict[str, float]]:
        gray = foam(n, seed)
        values = np.asfortranarray(np.float32(np.quantile(gray, level)) - gray)
        look = Look.at(values < 0, True, n // 4)
        field = ImageField.through(values, (1 / n,) * 3, physical=True, periodic=True)
        return look, properties_of(silent, field, n)

    silent: Any = Quiet(PlainContext(1))
    level = float((foam(n) < 0.5).mean())
    own, numbers = seen(3)
    found = []
    for seed in range(4, 4 + count):
        look, other = seen(seed)
        kinds = {key: other[key] / numbers[key] - 1 for key in ("permeability", "stiffness")}
        found.append(quantities_of(differences(own, look)) | kinds)
    return rows_of("another foam of such balls", found)


def quantities_of(off: Mapping[str, Any]) -> dict[str, float]:
    """Differences of statistics by the names of rows."""
    parts = {
        f"{kind}, {phase}": off[kind][phase] for kind in ("chords", "thickness") for phase in ("solid", "void")
    }  # fmt: skip
    return {"porosity": off["porosity"], "S2": off["S2"], **parts}


def with_tensor(name: str, scan: ScalarField, n: int, found: dict[str, float]) -> list[dict[str, Any]]:
    """Rows of a twin whose level `tune.tensor` has changed, until its stiffness is that of the scan.

    The stiffness of the scan is that with its mirror images, of the twin that of the cell that repeats, stretched.
    """
    context = PlainContext(1)
    silent: Any = Quiet(context)
    solid = scan.solid(cell_centers(n, scan.cells)).view(np.bool_)
    target = Look.at(solid, False, n // 4)
    stretch, turn = stretch_of(*fabric(configurations(solid, False), (1.0,) * 3))
    own = HomogenizeVoxel(sides="mirror", resolution=n, solver_tolerance=1e-3).run(silent, scan).stiffness
    nothing, matrix = np.zeros((6, 6)), matrix_of(tuple(stretch), tuple(turn))
    design = StiffnessDesign(
        recipe="recipe", options=(), porosity=1 - target.share, stretch=stretch, rotation=matrix / stretch,
        stiffness=own, target=own, mean_error=nothing, draw_error=nothing, distance=0.0, floor=0.0, grid_error=0.0,
        draws=1,
    )  # fmt: skip
    recipe = plates(**{option.rpartition(".")[2]: value for option, value in found.items()})
    twin = TuneTensor(trials=1, resolution=32, max_distance=1.0).run(context, recipe, design)
    values = stretched(twin.sample(2 * N), 2, matrix, solid.shape)
    values -= np.float32(cut_for_porosity(values, 1 - target.share).level)
    off = differences(target, Look.at(values < 0, False, n // 4))
    box = ImageField.through(values, (1 / N,) * 3, physical=True, periodic=False)
    k = [properties_of(silent, one, n)["permeability"] for one in (scan, box)]
    quantities = quantities_of(off) | {"permeability": k[1] / k[0] - 1, "stiffness": context.reported["distance"]}
    return [row(f"{name}, tune.tensor", quantity, value, "") for quantity, value in quantities.items()]


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
                scale, digits = (100, "+.1f") if row["wanted"] and quantity != "S2" else (1, ".3g")
                shown = f"{scale * float(row['difference']):{digits}}"
                if row["error"]:
                    shown += f" ± {scale * float(row['error']):{digits.strip('+')}}"
                shown += " %" if scale == 100 else ""
                shown = shown if row["met"] != "False" else f"**{shown}**"
                columns.setdefault(row["scan"], {})[quantity] = shown
    names = list(dict.fromkeys(name for column in columns.values() for name in column))
    lines = ["| | " + " | ".join(columns) + " |", "|---" * (len(columns) + 1) + "|"]
    lines += [
        "| " + " | ".join([name, *(column.get(name, "") for column in columns.values())]) + " |" for name in names
    ]
    between_marks(page, "<!-- benchmarks.twins -->", "\n".join(lines))


def main() -> None:
    """Write the table, and print each row as it is found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("scans", nargs="*")
    parser.add_argument("--draws", type=int, default=2)
    parser.add_argument("--evaluations", type=int, default=60)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--tensor", type=Path, help="a file whose twins go on to `tune.tensor`, by the options in it")
    parser.add_argument("--others", type=int, default=0, help="other draws of the foam, compared with it, no twins")
    parser.add_argument("--page", type=Path, help="a page whose table is made of the files instead")
    parser.add_argument("--match", nargs="+", default=["S2", "chords", "thickness"], choices=KINDS)
    parser.add_argument("--only", help="a scan, or part of the names of those that are taken")
    args = parser.parse_args()
    if args.page:
        write_page(args.page, [args.file, *map(Path, args.scans)])
        return
    with args.file.open("w", newline="", encoding="utf-8") as file:
        writer = None
        given = scans(args.scans)
        named = [one for one in given if one[0] == args.only] or [one for one in given if (args.only or "") in one[0]]
        for name, n, scan in named:
            if args.others:
                found = other_foams(n, args.others)
            elif args.tensor:
                with args.tensor.open(encoding="utf-8") as earlier:
                    lines = [one for one in csv.DictReader(earlier) if one["scan"] == name and not one["wanted"]]
                found = with_tensor(name, scan, n, {one["quantity"]: float(one["difference"]) for one in lines})
            else:
                twin, found = rows(name, scan, n, args.draws, args.evaluations, args.seeds, tuple(args.match))
            if name.startswith(("own", "foam")) and not args.tensor and not args.others:
                draw(scan, twin, args.file.with_name(f"{args.file.stem}-{name.split(',')[0].split()[0]}.png"))
            for one in found:
                writer = writer or csv.DictWriter(file, list(one))
                if file.tell() == 0:
                    writer.writeheader()
                writer.writerow(one)
                file.flush()
                print(*one.values(), sep=" | ", flush=True)


if __name__ == "__main__":
    main()
