"""The paper's graded bar, and steps from .2 to .8, over seeds: each cell's porosity counted again by code of its own.

    python -m benchmarks.graded [SEEDS] [VOXELS]     # 10 and 121 if omitted

A row for each kind of bar: the largest error of a cell, rms, how far the level goes from the recipe's, the share of the
void that is connected neither to the largest part of it nor to the outside, and the share of the solid that falls off.
"""

from __future__ import annotations

import sys
import time

import numpy as np
from scipy.ndimage import label

from benchmarks.measure import table
from sppm_pipeline.data.grading import Grading, TableLaw
from sppm_pipeline.data.length import Length
from sppm_pipeline.fields.level_field import LevelField
from sppm_pipeline.stages.connect.mbdst import BoundedDegreeSubgraph
from sppm_pipeline.stages.field.gaussian import GaussianField
from sppm_pipeline.stages.sample.dart_throwing import DartThrowing
from sppm_pipeline.stages.sample.mirrored_faces import MirroredFaces
from sppm_pipeline.stages.tile.graded import GradedTiling
from sppm_pipeline.stages.tune.local_porosity import TuneLocalPorosity
from sppm_pipeline.testing.plain_context import PlainContext, recipe_of
from sppm_pipeline.testing.recount import laid_kernels, recounted_porosity

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
    parts = label(solid)[0]
    loose_solid = 1 - np.bincount(parts[solid]).max() / np.count_nonzero(solid)
    change = float(np.abs(np.exp(tuned.control) / tiling.solid_below - 1).max())
    return [*found, change, loose_void, loose_solid, seconds]


def main() -> None:
    """Print the table."""
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
