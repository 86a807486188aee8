"""Tables of docs/explanation/stiffest.md from a finished sweep of configs/stiffest.yaml.

    python -m benchmarks.stiffest runs/stiffest/sweep.csv [--porosity 0.7]

The permeability is the estimate of Johnson, Koplik and Schwartz 1986, ``Lambda^2 / (8 F)``: F is one over the
conductivity of the void, and its length Lambda is taken as twice the void's volume over its surface. It is a proxy
that ranks structures at equal cell size; it solves no flow.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

KINDS = {
    "walls": "ours: walls pierced by tunnels",
    "tunnels": "ours: pores and tunnels, as in the paper",
    "paper": "the paper's cell",
    "gyroid": "gyroid sheet",
    "octet": "octet",
    "kelvin": "Kelvin",
    "openfoam": "open foam",
    "closedfoam": "closed foam",
    "spinodoid": "spinodoid",
}


def number(row: dict[str, str], column: str) -> float:
    """A number of a row; not a number where there is none."""
    return float(row[column] or "nan")


def permeability(row: dict[str, str]) -> float:
    """The proxy, in squares of the cell edge."""
    conductivity = sum(number(row, f"pores.k.{i}.{i}") for i in (1, 2, 3)) / 3
    length = 2 * number(row, "elastic.porosity") / number(row, "sizes.specific_surface")
    return length**2 * conductivity / 8


def line(name: str, row: dict[str, str]) -> str:
    """A row of a table."""
    e, bound = number(row, "elastic.isotropic.E"), number(row, "elastic.bounds.hashin_shtrikman_young.2")
    return (
        f"| {name} | {e:.3f} | {e / bound:.2f} | {number(row, 'elastic.deviation_invariant'):.3f} "
        f"| {number(row, 'elastic.universal_anisotropy'):.3f} | {number(row, 'pores.k.1.1'):.3f} "
        f"| {1e4 * permeability(row):.2f} | {number(row, 'sizes.solid.quantiles.1'):.3f} "
        f"| {number(row, 'phases.void_components'):.0f} |"
    )


def main() -> None:
    """Print the best of each family at one porosity, and all designs at that porosity."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("table", type=Path)
    parser.add_argument("--porosity", default="0.7")
    args = parser.parse_args()
    with args.table.open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row.get("elastic.isotropic.E")]
    for row in rows:  # an axis that the command line fixed is no column
        row.setdefault("porosity", f"{round(20 * number(row, 'elastic.porosity')) / 20:g}")
    rows.sort(key=lambda row: -number(row, "elastic.isotropic.E"))
    chosen = [row for row in rows if float(row["porosity"]) == float(args.porosity)]
    head = "E / E_s | of the bound | deviation | A^U | conductivity | permeability, 1e-4 L^2 | thinnest tenth / L"
    for title, picked in (
        ("stiffest of a kind", list({row["structure"].split("_")[0]: row for row in reversed(chosen)}.values())[::-1]),
        ("all", chosen),
    ):
        print(f"| {title} | {head} | void parts |\n|---" + "|---" * 8 + "|")
        for row in sorted(picked, key=lambda row: -number(row, "elastic.isotropic.E")):
            kind = row["structure"].split("_")[0]
            print(line(f"{KINDS[kind]} (`{row['structure']}`)" if title != "all" else f"`{row['structure']}`", row))
        print()
    print("| E / E_s by porosity | " + " | ".join(sorted({row["porosity"] for row in rows}, reverse=True)) + " |")
    print("|---" * (1 + len({row["porosity"] for row in rows})) + "|")
    for kind, name in KINDS.items():
        best = {
            row["porosity"]: number(row, "elastic.isotropic.E")
            for row in reversed(rows)
            if row["structure"].split("_")[0] == kind
        }
        if best:
            print(f"| {name} | " + " | ".join(f"{best[p]:.3f}" for p in sorted(best, reverse=True)) + " |")


if __name__ == "__main__":
    main()
