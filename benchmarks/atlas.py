"""The sweep behind `sppm find`: designs of all families, drawn and measured; it goes on where it ended,
or from the rows of the package's data file.

    python -m benchmarks.atlas ROWS.csv --designs 40 --draws 2 --minutes 5     # add rows; repeat until it says done
    python -m benchmarks.atlas ROWS.csv --build                                # write the data file of the package
    python -m benchmarks.atlas ROWS.csv --verify 5                             # run rows again, compare their digests
    python -m benchmarks.atlas FRESH.csv --first 1000 --designs 8 --minutes 5  # fresh designs ...
    python -m benchmarks.atlas FRESH.csv --coverage                            # ... and how many lie in the bands
    python -m benchmarks.atlas FRESH.csv --page docs/howto/find-a-design.md    # the table of the page

`--designs` is the number of each family; they fill its ranges evenly, as points of an additive recurrence, so that more
designs leave those that are there as they are.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import random
import tempfile
import time
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import sppm_pipeline as sppm
from benchmarks.measure import between_marks
from sppm_pipeline.features.design.atlas import (
    DATA,
    FAMILIES,
    LENGTH_POWERS,
    PORES,
    PROPERTIES,
    Atlas,
    configuration,
    fitted,
    scaled,
    spread,
    versions,
)
from sppm_pipeline.services.arrays import F64

MARK = "<!-- benchmarks.atlas -->"

COLUMNS = ("family", "number", "draw", *PROPERTIES, "digest", "versions")


def values_of(family: str, number: int) -> dict[str, float]:
    """Parameters of a design: points spread evenly over the ranges."""
    ranges = FAMILIES[family].ranges
    shares = spread(number + 1, len(ranges))[-1]
    return {
        name: float(f"{a + share * (b - a):.4g}") for share, (name, (a, b)) in zip(shares, ranges.items(), strict=True)
    }


def measured(family: str, number: int, draw: int) -> list[float]:
    """Properties of one draw, lengths in cell sizes; NaN if it can't be made."""
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        path = Path(folder) / "design.yaml"
        path.write_text(configuration("design", family, values_of(family, number)), encoding="utf-8")
        try:
            n = sppm.run(str(path), seed=1000 * number + draw, output=f"{folder}/run", cache=False, threads=1).numbers
            return [
                n["homogenize.voxel.E_relative"], n["homogenize.voxel.isotropic.nu"], n["homogenize.voxel.E_ratio"],
                sum(n[f"homogenize.conductivity.k.{i}.{i}"] for i in (1, 2, 3)) / 3,
                n["homogenize.permeability.k_mean"], n["check.sizes.specific_surface"], n["check.sizes.strut.mean"],
                n["check.sizes.strut.thinnest"], n["check.sizes.pore.mean"],
            ]  # fmt: skip
        except (sppm.SppmError, KeyError):  # it can't be made, or has no stiffness in some direction
            return [float("nan")] * len(PROPERTIES)


def digest_of(values: Sequence[float]) -> str:
    """Digest of the measured properties of a draw."""
    return hashlib.sha256(np.asarray(values, "<f4").tobytes()).hexdigest()[:16]


def built(
    designs: Sequence[tuple[str, Mapping[str, float]]], values: F64, digests: Sequence[str], numbers: Sequence[int],
    draws: Sequence[int], made_by: Sequence[str],
) -> None:  # fmt: skip
    """Fit all families and write the data file; values (n, properties) of draws have lengths in cell sizes."""
    arrays: dict[str, Any] = {}
    scale = PORES ** (np.array(list(LENGTH_POWERS.values())) / 3)
    for family in FAMILIES:
        own = [k for k, (name, _) in enumerate(designs) if name == family and np.isfinite(np.log(values[k])).all()]
        points = np.concatenate([scaled(family, designs[k][1]) for k in own])
        logs = np.log(values[own] * scale)
        of = np.array([numbers[k] for k in own])
        fits = [fitted(points, logs[:, p], of) for p in range(len(PROPERTIES))]
        arrays |= {
            f"{family}.points": points, f"{family}.values": logs.astype(np.float32), f"{family}.number": of,
            f"{family}.draw": np.array([draws[k] for k in own]),
            f"{family}.digest": np.array([digests[k] for k in own]),
            f"{family}.versions": np.array([made_by[own[0]]]), f"{family}.weights": np.array([f.weights for f in fits]),
            f"{family}.settings": np.array([[*f.settings, f.mean, f.deviation, f.band] for f in fits]),
        }  # fmt: skip
        if len({made_by[k] for k in own}) > 1:
            raise ValueError(f"rows of {family} were made by several versions: sweep it again")
    np.savez_compressed(DATA, **arrays)


def main() -> None:
    """Sweep, build, verify, or measure the coverage."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rows", type=Path)
    parser.add_argument("--designs", type=int, default=40)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--draws", type=int, default=2)
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("--build", action="store_true")
    parser.add_argument("--verify", type=int, default=0)
    parser.add_argument("--coverage", action="store_true")
    parser.add_argument("--page", type=Path)
    args = parser.parse_args()
    if not (args.rows.exists() or args.first):
        exported(args.rows)
    rows = list(csv.DictReader(args.rows.open(encoding="utf-8"))) if args.rows.exists() else []
    designs = [(row["family"], int(row["number"]), int(row["draw"])) for row in rows]
    if args.build:
        built(
            [(family, values_of(family, number)) for family, number, _ in designs],
            np.array([[float(row[name]) for name in PROPERTIES] for row in rows]),
            [row["digest"] for row in rows], [number for _, number, _ in designs], [draw for *_, draw in designs],
            [row["versions"] for row in rows],
        )  # fmt: skip
        print(f"{DATA}: {DATA.stat().st_size} bytes, {len(rows)} draws of {len({d[:2] for d in designs})} designs")
    elif args.verify:
        for k in random.Random(1).sample(range(len(rows)), args.verify):
            again = digest_of(measured(*designs[k]))
            print(*designs[k], "the same" if again == rows[k]["digest"] else f"NOT the same: {again}", flush=True)
    elif args.page:
        between_marks(args.page, MARK, words_of(rows))
    elif args.coverage:
        for name, own in [(f, [row for row in rows if row["family"] == f]) for f in FAMILIES] + [("all", rows)]:
            found = coverage(own)
            shares = (f"{key} {share:.2f}" for key, share in zip(PROPERTIES, found.mean(0), strict=True))
            print(f"{name}, {len(found)} draws: {found.mean():.3f};", ", ".join(shares))
    else:
        swept(args, set(designs))


def exported(path: Path) -> None:
    """Write the rows of the package's data file, from which a sweep goes on."""
    atlas = Atlas.read()
    scale = PORES ** (np.array(list(LENGTH_POWERS.values())) / 3)
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        for family in FAMILIES:
            if family in atlas.stale():
                continue
            number, draw, values, digest = (
                atlas.arrays[f"{family}.{key}"] for key in ("number", "draw", "values", "digest")
            )
            for k in range(len(number)):
                numbers = [f"{value:.9g}" for value in np.exp(values[k].astype(float)) / scale]
                writer.writerow([family, number[k], draw[k], *numbers, digest[k], versions(family)])


def swept(args: argparse.Namespace, known: set[tuple[str, int, int]]) -> None:
    """Add rows until there are all, or the time is over."""
    started = time.process_time()
    new = not args.rows.exists()
    with args.rows.open("a", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        if new:
            writer.writerow(COLUMNS)
        for number in range(args.first, args.first + args.designs):
            for draw in range(args.draws):
                for family in FAMILIES:
                    if (family, number, draw) in known:
                        continue
                    if time.process_time() - started > 60 * args.minutes:
                        print(f"not done: {len(known)} draws")
                        return
                    found = measured(family, number, draw)
                    numbers = [f"{np.float32(value):.9g}" for value in found]
                    writer.writerow([family, number, draw, *numbers, digest_of(found), versions(family)])
                    file.flush()
                    known.add((family, number, draw))
    print(f"done: {len(known)} draws")


def coverage(rows: list[dict[str, str]]) -> np.ndarray:
    """Whether fresh draws lie in the bands, (draws, properties); those that could not be made are left out."""
    atlas = Atlas.read()
    inside = []
    for row in rows:
        draw = np.array([float(row[name]) for name in PROPERTIES])
        if np.isfinite(np.log(draw)).all():
            low, high = atlas.band(row["family"], values_of(row["family"], int(row["number"])))
            inside.append((low <= draw) & (draw <= high))
    return np.array(inside)


SHOWN = ("E_relative", "E_ratio", "permeability", "surface", "strut", "strut_thinnest", "pore")


def words_of(rows: list[dict[str, str]]) -> str:
    """The table of the page: draws and half widths of bands of each family, and the coverage of fresh draws."""
    atlas = Atlas.read()
    words = ["| family | designs | draws | " + " | ".join(f"`{name}`" for name in SHOWN) + " |", "|---" * 10 + "|"]
    for family, (_, ranges) in FAMILIES.items():
        half = atlas.logs(family, spread(1, len(ranges)))[1]
        bands = (f"{100 * (np.exp(half[PROPERTIES.index(name)]) - 1):.0f}" for name in SHOWN)
        numbers = atlas.arrays[f"{family}.number"]
        words.append(f"| `{family}` | {len(set(numbers))} | {len(numbers)} | " + " | ".join(bands) + " |")
    found = coverage(rows)
    shares = dict(zip(PROPERTIES, found.mean(0), strict=True))
    (low, least), *_, (high, most) = sorted((share, name) for name, share in shares.items())
    mean, error = 100 * found.mean(), 100 * found.mean(1).std() / len(found) ** 0.5
    words.append("")
    words.append(
        f"Of {len(found)} fresh draws, of designs that are not in the atlas, {mean:.1f} ± {error:.1f} % of the"
    )
    words.append(f"numbers lay in the bands, from {100 * low:.0f} % for `{least}` to {100 * high:.0f} % for `{most}`.")
    return "\n".join(words)


if __name__ == "__main__":
    main()
