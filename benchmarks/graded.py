"""The paper's graded bar, and steps from 0.2 to 0.8, over seeds: each cell's porosity counted again by code of its own.

    python -m benchmarks.graded [SEEDS] [VOXELS]     # 10 and 121 if omitted
    python -m benchmarks.graded maps [SEEDS] [VOXELS]  # scattered pores by random smooth maps; 3 and 101 if omitted
    python -m benchmarks.graded cells [ALONG_AN_EDGE]  # scattered pores by a map, time and memory; 46 if omitted
    python -m benchmarks.graded part MESH            # whole processes, from a mesh to layers

A row for each kind of bar: the largest error of a cell, rms, how far the level goes from the recipe's, the share of the
void that is connected neither to the largest part of it nor to the outside, and the share of the solid that falls off;
bars of one face pattern repeat across, and so does what is counted as falling off. The maps are sums of waves from 0.3
to 0.7, drawn by the seed; all cells of a box of 4 x 3 x 3 are counted again. With a mesh, the part of
configs/bunny.yaml is graded by the distance from its surface, and compared with itself ungraded.
"""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy.ndimage import label

from benchmarks.measure import pipeline_command, run, table
from benchmarks.recount import laid_kernels, recounted_porosity
from sppm_pipeline.features.grading.laws import TableLaw
from sppm_pipeline.features.grading.stages.grade_formula import GradeFormula
from sppm_pipeline.features.grading.stages.tile_graded import GradedTiling
from sppm_pipeline.features.grading.stages.tune_local_porosity import TuneLocalPorosity
from sppm_pipeline.method.connectivity.islands import keep_largest
from sppm_pipeline.method.fields.level_field import LevelField
from sppm_pipeline.method.nouns.maps import Grading
from sppm_pipeline.method.stages.connect_mbdst import BoundedDegreeSubgraph
from sppm_pipeline.method.stages.connect_relative_neighbors import RelativeNeighbors
from sppm_pipeline.method.stages.field_gaussian import GaussianField
from sppm_pipeline.method.stages.sample_dart_throwing import DartThrowing
from sppm_pipeline.method.stages.sample_mirrored_faces import MirroredFaces
from sppm_pipeline.method.stages.tile_scattered import ScatteredTiling
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.testing.plain_context import PlainContext, recipe_of

CONFIG = Path(__file__).parent.parent / "configs" / "bunny.yaml"
RECIPE = recipe_of(
    MirroredFaces(edge=Length(2), total=66, share=0.5),
    DartThrowing(total=66),
    BoundedDegreeSubgraph(degree=(3, 5), mode="greedy"),
    GaussianField(omega=30, mu=30, level=0.25),
)
BARS = {
    "paper's bar, one face pattern": ((0.75, 0.65, 0.55, 0.45, 0.35, 0.25), "same"),
    ".2|.8, one face pattern": ((0.2, 0.8), "same"),
    ".2|.8, graded faces": ((0.2, 0.8), "graded"),
    ".2 alone": ((0.2,), "same"),
    ".8 alone": ((0.8,), "same"),
}


def measured(values: tuple[float, ...], faces: str, seed: int, n: int) -> list[float]:
    """Errors of all cells, then the largest change of the level, loose void, loose solid, and processor seconds."""
    law = TableLaw("porosity", "", "cell_x", np.arange(float(len(values))), np.array(values), "steps")
    grading, context, begun = Grading((law,)), PlainContext(seed), time.process_time()
    tiling = GradedTiling(cell=Length(20, "mm"), cells=(len(values), 1, 1), faces=faces).run(
        context, RECIPE, grading, None
    )
    tuned = TuneLocalPorosity().run(context, tiling, grading)
    assert isinstance(tuned, LevelField)
    seconds = time.process_time() - begun
    kernels = laid_kernels(tiling)
    found = [recounted_porosity(kernels, tuned.control, (i, 0, 0), n) - p for i, p in enumerate(values)]
    solid = tuned.solid(64).astype(bool)
    void = np.pad(~solid, 1, constant_values=True)
    parts = label(void)[0]
    loose_void = np.count_nonzero(void & (parts != parts[0, 0, 0])) / solid.size
    across = faces == "same"
    loose_solid = 1 - np.count_nonzero(keep_largest(solid.T, (False, across, across))) / np.count_nonzero(solid)
    change = float(np.abs(np.exp(tuned.control) / tiling.solid_below - 1).max())
    return [*found, change, loose_void, loose_solid, seconds]


def wavy(seed: int) -> str:
    """A formula of a random smooth map of porosities from 0.3 to 0.7 for a box of 80 x 60 x 60 mm."""
    rng = np.random.default_rng(seed)
    waves = [
        f"sin({a:.4f}*x + {b:.4f}*y + {c:.4f}*z + {phase:.4f})"
        for a, b, c, phase in np.column_stack([rng.uniform(-0.06, 0.06, (3, 3)), rng.uniform(0, 6.3, 3)])
    ]
    return f"0.5 + 0.066*({' + '.join(waves)})"


def maps(seeds: int, n: int) -> None:
    """Scattered pores that follow random maps, each cell counted again, and its target found again."""
    t = (np.arange(8) + 0.5) / 8
    inner = np.stack(np.meshgrid(t, t, t, indexing="ij"), -1).reshape(-1, 3)
    rows = []
    for seed in range(1, seeds + 1):
        context, formula, begun = PlainContext(seed), wavy(seed), time.process_time()
        grading = GradeFormula(of="porosity", formula=formula).run(context, None, None)
        tiling = ScatteredTiling(cell=Length(20, "mm"), cells=(4, 3, 3)).run(context, RECIPE, None, grading)
        tuned = TuneLocalPorosity().run(context, tiling, grading)
        assert isinstance(tuned, LevelField)
        seconds, kernels, errors = time.process_time() - begun, laid_kernels(tiling), []
        for cell in np.ndindex(4, 3, 3):
            x, y, z = ((np.array(cell) + inner) * 20).T
            target = eval(formula, {"sin": np.sin, "x": x, "y": y, "z": z}).mean()
            errors.append(recounted_porosity(kernels, tuned.control, cell, n) - target)
        change = np.abs(np.exp(tuned.control) / tiling.solid_below - 1).max()
        worst, rms = np.abs(errors).max(), np.sqrt(np.square(errors).mean())
        rows.append([seed, f"{100 * worst:.3f}", f"{100 * rms:.3f}", f"{100 * change:.1f}", f"{seconds:.1f}"])
    head = ["map", "largest error, %", "rms, %", "level, %", "CPU s"]
    table(f"scattered, 36 cells each, counted on {n} voxels along an edge", head, rows)


def cells(along: int) -> None:
    """A box of so many cells whose porosity goes up and down from 0.42 to 0.72, measured and put right once."""
    recipe = recipe_of(
        DartThrowing(total=70, share=0.55),
        RelativeNeighbors(),
        GaussianField(pore_radius=Length(0.11), tunnel_radius=Length(0.03)),
    )
    context, formula = PlainContext(1, threads=2), f"0.57 + 0.15*sin(4*pi*x/{along})*cos(2*pi*y/{along})"
    grading, begun = GradeFormula(of="porosity", formula=formula).run(context, None, None), time.process_time()
    stage = ScatteredTiling(cell=Length(1, "mm"), cells=(along,) * 3, rounds=1, resolution=16)
    pores = len(stage.run(context, recipe, None, grading).tileset.micro.graph.pores.centers)
    seconds, peak = time.process_time() - begun, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    errors = " ".join(f"{100 * rms:.2f}" for rms in context.reported["error_rms_of_rounds"])
    rows: list[list[object]] = [[along**3, pores, seconds, peak, errors]]
    table("scattered by a map", ["cells", "pores", "CPU s", "peak MB", "rms of the rounds, %"], rows)


def part(mesh: str) -> None:
    """The bunny's configuration as it is, with a map, and with a level that follows it."""
    plain = CONFIG.read_text()
    scattered, slices = "  - {stage: tile.scattered", "  - {stage: slice.field"
    maps = """  - {stage: grade.distance, of: depth}
  - {stage: grade.formula, of: porosity, formula: "0.75 - 0.2*smoothstep(0, 8, depth)"}
"""
    graded = plain.replace(scattered, maps + scattered).replace(', porosity: "${porosity}"}', "}")
    configurations = {
        "one porosity": plain,
        "graded": graded,
        "graded, and tuned": graded.replace(slices, "  - tune.local_porosity\n" + slices),
    }
    rows: list[list[object]] = []
    with tempfile.TemporaryDirectory() as folder:
        for name, text in configurations.items():
            path = Path(folder) / "part.yaml"
            path.write_text(text)
            command = [*pipeline_command(path, f"{folder}/{len(rows)}"), "-p", f"mesh={mesh}"]
            done = min((run(command) for _ in range(2)), key=lambda one: one.cpu)
            rows.append([name, done.wall, done.cpu, done.peak])
    table(f"{Path(mesh).name}, 60 mm high, 100^3 voxels a cell", ["part", "wall s", "CPU s", "peak MB"], rows)


def main() -> None:
    """Print the table."""
    if sys.argv[1:2] == ["part"]:
        part(sys.argv[2])
        return
    if sys.argv[1:2] == ["cells"]:
        cells(int(sys.argv[2]) if sys.argv[2:] else 46)
        return
    if sys.argv[1:2] == ["maps"]:
        maps(*(int(a) for a in (sys.argv[2:] + ["3", "101"][len(sys.argv) - 2 :])[:2]))
        return
    seeds, n = (int(a) for a in (sys.argv[1:] + ["10", "121"][len(sys.argv) - 1 :])[:2])
    rows = []
    for name, (values, faces) in BARS.items():
        found = np.array([measured(values, faces, seed, n) for seed in range(1, seeds + 1)])
        errors, (change, void, solid, seconds) = found[:, : len(values)], found[:, len(values) :].T
        rows.append([
            name, f"{100 * np.abs(errors).max():.3f}", f"{100 * np.sqrt((errors**2).mean()):.3f}",
            f"{100 * change.max():.1f}", f"{100 * void.max():.4f}", f"{100 * solid.max():.2f}",
            f"{np.median(seconds):.2f}",
        ])  # fmt: skip
    head = ["bar", "largest error, %", "rms, %", "level, %", "void apart, %", "solid apart, %", "CPU s"]
    table(f"{seeds} seeds, counted on {n} voxels along an edge", head, rows)


if __name__ == "__main__":
    main()
