"""Solid of the front page's knot that is thin, as cut and with each border, and triangles of its mesh before and after.

Usage: ``python -m benchmarks.borders [--write]``; the latter puts the table into docs/howto/fill-your-own-mesh.md. Thin
is what has a local thickness below 0.3 mm on voxels of 0.05 mm; patches are what of it is connected across faces of
voxels. Times are those of a processor for all layers, the least of three in turn.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

import sppm_pipeline as sppm
from benchmarks.measure import between_marks
from sppm_pipeline.features.surface.numerics.simplifying import qualities, simplify
from sppm_pipeline.features.surface.stages.extract_marching_cubes import MarchingCubes
from sppm_pipeline.method.connectivity.components import find_components
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.services.arrays import U8
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.local_thickness import local_thickness
from sppm_pipeline.services.mesh.measures import genus
from sppm_pipeline.testing.plain_context import PlainContext

ROOT = Path(__file__).resolve().parents[1]
CONFIG, PAGE = ROOT / "configs" / "quickstart.yaml", ROOT / "docs" / "howto" / "fill-your-own-mesh.md"
MARK = "<!-- benchmarks.borders -->\n"
THINNEST, VOXEL, PATCH, WITHIN = 0.3, 0.05, 50, 0.02
WAYS: dict[str, dict[str, str]] = {
    "cut": {},
    "round": {},
    "frame": {"frame": "0.5 mm", "frame_spacing": "2 mm"},
    "closed": {},
}


def layers(part: Part, grid: Grid) -> tuple[U8, float]:
    """All layers of a part, and the seconds they took."""
    made, start, nz = replace(part), time.process_time(), grid.shape[2]
    solid = np.concatenate([made.solid_zyx(grid, k, min(nz, k + 18)) for k in range(0, nz, 18)])
    return solid, time.process_time() - start


def options(name: str) -> dict[str, str]:
    """Settings of `fill.implicit` for a border."""
    thinnest = {} if name == "cut" else {"thinnest": f"{THINNEST} mm"}
    given = {"border": name, **thinnest, **WAYS[name]}
    return {f"fill.implicit.{option}": value for option, value in given.items()}


def main() -> None:
    """Print one line for each kind of border, and a table."""
    parts = {name: sppm.run(str(CONFIG), set=options(name), until="fill.implicit")["fill.implicit"] for name in WAYS}
    plain: Part = parts["cut"]
    edge = plain.physical_edge()
    low = (plain.domain.lower + VOXEL / 2 - plain.origin_mm) / edge
    nx, ny, nz = (round(float(side) / VOXEL) for side in plain.domain.upper - plain.domain.lower)
    grid = Grid((float(low[0]), float(low[1]), float(low[2])), (VOXEL / edge,) * 3, (nx, ny, nz))
    inside = sum(int(plain.inside_zyx(grid, k, min(nz, k + 18)).sum()) for k in range(0, nz, 18))
    made = {name: layers(part, grid)[0] for name, part in parts.items()}  # the first one compiles
    taken = {name: min(layers(part, grid)[1] for _ in range(3)) for name, part in parts.items()}
    rows = [
        "| `border` | solid | in one piece | thinner than 0.3 mm | thin patches above 50 voxels | void open to the "
        "outside | time |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, solid in made.items():
        sizes = find_components(solid, (False,) * 3).sizes
        thickness = local_thickness(np.pad(solid, 2), (False,) * 3)
        thin = (thickness > 0) & (thickness < THINNEST / VOXEL)
        patches = int((find_components(thin.view(np.uint8), (False,) * 3).sizes > PATCH).sum())
        voids = find_components(np.pad(solid, 2), (False,) * 3, 6, zeros=True)
        around = voids.sizes[voids.faces.any(1)].sum() - ((nx + 4) * (ny + 4) * (nz + 4) - inside)
        opened = max(0.0, around / (inside - solid.sum()))
        share = thin.sum() / solid.sum()
        rows.append(
            f"| `{name}` | {solid.sum() / inside:.1%} | {sizes.max() / sizes.sum():.1%} | {share:.2%} | {patches} | "
            f"{opened:.0%} | {taken[name] / taken['cut']:.2f} |"
        )
        if name not in ("cut", "round"):
            continue
        mesh = MarchingCubes(resolution=40).run(PlainContext(), parts[name])
        simplify(mesh.vertices, mesh.faces, WITHIN)
        start = time.process_time()
        few = simplify(mesh.vertices, mesh.faces, WITHIN)
        print(
            f"{name}: layers {taken[name]:.2f} s; {len(mesh.faces)} triangles, "
            f"{len(few.faces)} within {few.farthest:.4f} mm in {time.process_time() - start:.2f} s, genus "
            f"{genus(mesh.faces)} and {genus(few.faces)}, quality below 0.1: "
            f"{(qualities(mesh.vertices, mesh.faces) < 0.1).mean():.2%} and "
            f"{(qualities(few.vertices, few.faces) < 0.1).mean():.2%}",
            flush=True,
        )
    table = "\n".join(rows) + "\n"
    print(table)
    if "--write" in sys.argv:
        between_marks(PAGE, MARK, table)


if __name__ == "__main__":
    main()
