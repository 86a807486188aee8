"""Joined sets, blends and warps of the paper's cells: how well porosity is kept, on grids that nothing was tuned on.

    python -m benchmarks.joining [SEEDS]     # 5 if omitted

*Joined*: two sets, omega 20, 42 pores, porosity 0.55, and omega 40, 78 pores, porosity 0.35, through one transition
cell, after `tune.local_porosity`. *Blended*: stochastic cells and a gyroid in equal parts, less the porosity that both
have; the same by a plain mean of both fields, each over its standard deviation. *Warped*: rings of a tube.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

import sppm_pipeline as sppm
from benchmarks.measure import table

CELL = """
    - {stage: sample.mirrored_faces, edge: 2, total: %d, share: 0.5}
    - {stage: sample.dart_throwing, total: %d}
    - {stage: connect.mbdst, degree: [3, 5], mode: greedy}
    - {stage: field.gaussian, omega: %g, mu: %g, level: 0.25}
"""


def configuration(recipes: dict[str, tuple[int, float]], pipeline: str, seed: int) -> str:
    """A whole file."""
    cells = "".join(f"  {name}:{CELL % (n, n, omega, omega)}" for name, (n, omega) in recipes.items())
    return f"sppm: 1\nseed: {seed}\nrecipes:\n{cells}pipeline:\n{pipeline}"


def finished(text: str) -> Any:
    """The run of a configuration."""
    return sppm.run(sppm.Pipeline.from_yaml(text))


def void(field: Any, n: Any) -> Any:
    """Voxels of a field, n along an edge of a cell or on a grid, True for void."""
    return field.sample(n, threads=2) >= 0


def joined(seed: int) -> list[object]:
    """Largest error of four cells, levels, void cut off, solid cut off."""
    from scipy.ndimage import label

    sets = "".join(
        f"  - {{stage: tileset.free_faces, id: s_{name}, recipe: {name}, colors: 2, interiors: 3, "
        f"porosity: {porosity}, resolution: 32, tolerance: 0.02}}\n"
        for name, porosity in (("open", 0.55), ("dense", 0.35))
    )
    run = finished(
        configuration(
            {"open": (42, 20), "dense": (78, 40)},
            sets + "  - {stage: tileset.join, from: {first: s_open, second: s_dense}}\n"
            '  - {stage: grade.formula, of: weight, formula: "clip((x - 5)/5, 0, 1)"}\n'
            "  - {stage: tile.joined, cells: [4, 1, 1], cell: 5 mm}\n"
            '  - {stage: grade.formula, of: porosity, formula: "where(x < 5, 0.55, where(x < 10, 0.45, 0.35))"}\n'
            "  - {stage: tune.local_porosity}\n",
            seed,
        )
    )
    field = run["tune.local_porosity"]
    shares = void(field, 67).reshape(4, 67, 67, 67).mean(axis=(1, 2, 3))
    error = np.abs(shares - [0.55, 0.45, 0.35, 0.35]).max()
    cut, levels = [], np.exp(field.control)
    for phase in (void(field, 48), ~void(field, 48)):
        sizes = np.bincount(label(phase)[0].ravel())[1:]
        cut.append(1 - sizes.max() / sizes.sum())
    before, span = run.numbers["tile.joined.error_max"], f"{levels.min():.3f} to {levels.max():.3f}"
    return [seed, f"{before:.4f}", f"{error:.5f}", span, *(f"{share:.5f}" for share in cut)]


def blended(porosity: float, seed: int) -> list[object]:
    """Errors of two ways to mix."""
    run = finished(
        configuration(
            {"cell": (66, 30)},
            f"  - {{stage: tile.fresh, id: cells, recipe: cell, cells: [4, 2, 2], cell: 5 mm, porosity: {porosity}}}\n"
            "  - {stage: grade.formula, of: weight, formula: 0.5 + 0*x}\n"
            "  - {stage: field.tpms, id: gyroid, surface: gyroid, edge: 5 mm}\n",
            seed,
        )
    )
    cells, gyroid = run["cells"], run["gyroid"]
    gyroid = gyroid.cut_at(float(np.quantile(gyroid.sample(64), 1 - porosity)))
    mixed = sppm.field.blend()(first=cells, second=gyroid, grading=run["grade.formula"])
    values = [cells.sample(40), gyroid.sample(sppm.numerics.cell_centers(40, cells.cells))]
    plain = sum(v / v.std() for v in values) / 2
    errors = void(mixed, 40).mean() - porosity, (plain >= 0).mean() - porosity
    return [porosity, seed, *(f"{100 * error:+.2f}" for error in errors)]


def warped(seed: int) -> list[object]:
    """Rings of a tube, with radii that follow the cells and without."""
    rows: list[object] = [seed]
    for sizes in ("cell", "fixed"):
        run = finished(
            configuration(
                {"cell": (66, 30)},
                "  - {stage: tile.fresh, recipe: cell, cells: [12, 3, 2], cell: 5 mm, periodic: true, porosity: 0.5}\n"
                f"  - {{stage: warp.cylinder, inner_radius: 4.6 mm, sizes: {sizes}}}\n",
                seed,
            )
        )
        field, h = run["warp.cylinder"], 0.1
        n = int(2 * 14.6 / h)
        axis = -14.6 + h * (np.arange(n) + 0.5)
        low = np.array([axis[0], axis[0], h / 2]) - field.origin_mm
        grid = sppm.numerics.Grid(tuple(low / field.edge_mm), (h / field.edge_mm,) * 3, (n, n, round(15 / h)))
        inside, r = void(field, grid), np.hypot(axis[:, None], axis)
        rows.append(" ".join(f"{inside[(r >= a) & (r < a + 5)].mean():.4f}" for a in (4.6, 9.6)))
    return rows


def main(seeds: int) -> None:
    """Print all."""
    header = ["seed", "error before", "after", "level", "void cut off", "solid cut off"]
    table("joined", header, [joined(seed) for seed in range(seeds)])
    rows = [blended(porosity, seed) for porosity in (0.3, 0.5, 0.7) for seed in range(seeds)]
    table("blended, errors in points", ["porosity", "seed", "normal scores", "plain"], rows)
    table("warped", ["seed", "rings, radii of cells", "fixed radii"], [warped(seed) for seed in range(seeds)])


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 5)
