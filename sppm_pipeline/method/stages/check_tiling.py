"""``check.tiling``: rules, alike neighbors and entropy of a tiling."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sppm_pipeline import Context, DesignError, Stage, Tiling, option


@dataclass(frozen=True, kw_only=True)
class CheckTiling(Stage):
    """Count broken rules, alike neighbors and the choice a rule leaves, in the layout of a tiling.

    Rule 1 of the paper: touching faces have one color. Rule 2: a cell scores 3, 2 or 1 for each neighbor across a
    face, an edge or a corner that is another tile; reported is the mean over the cells, and its fraction of what it
    would be if no neighbors were alike. The entropy per cell is that of the rule: the binary logarithm of the number
    of layouts it allows, over the number of cells. That of the interiors is measured: the bits in which their
    frequencies differ from a single interior's.
    """

    name: ClassVar[str] = "check.tiling"
    reported: ClassVar[tuple[str, ...]] = (
        "rule1_violations", "rule2_score", "rule2_fraction", "alike_across_faces", "alike_across_edges",
        "alike_across_corners", "interiors", "colors.#3", "interior_entropy", "entropy_per_cell",
    )  # fmt: skip

    violations: int = option(
        0, help="maximum number of faces that may break Rule 1; more are an error", minimum=0, maximum=10**9
    )

    def run(self, context: Context, tiling: Tiling) -> None:
        """Look at the layout alone; nothing is sampled."""
        from sppm_pipeline.method.tiling.statistics import (
            alike_neighbors,
            entropy_per_cell,
            face_violations,
            rule2_scores,
        )
        from sppm_pipeline.method.tiling.wang import tile_colors

        tileset, arrays, periodic = tiling.tileset, tiling.arrays.surrounded(), tiling.periodic
        if tileset.kind == "scattered":
            raise DesignError(
                "scattered pores are no tiles: there are no faces, so no rule to check",
                hint="leave out `check.tiling`; `check.residual_periodicity` shows that nothing repeats",
            )
        interior = arrays.interior
        wang = tileset.kind == "wang"
        table = tile_colors(tileset.palette_colors) if wang else None
        broken = face_violations(interior, arrays.faces, table, periodic=periodic)
        used, counts = np.unique(interior[interior >= 0], return_counts=True)
        # the entropy of interiors is that of their frequencies, Shannon's
        frequencies = counts / max(1, counts.sum())
        alike, pairs = alike_neighbors(interior, periodic=periodic)
        face, edge, corner = (float(n / m) if m else 0.0 for n, m in zip(alike, pairs, strict=True))
        score, largest = rule2_scores(interior, periodic=periodic)
        context.report(
            rule1_violations=int(broken.sum()), rule2_score=float(score.sum() / max(1, counts.sum())),
            rule2_fraction=float(score.sum() / largest.sum()) if largest.any() else 1.0, alike_across_faces=face,
            alike_across_edges=edge, alike_across_corners=corner, interiors=len(used),
            colors=[len(np.unique(faces[faces >= 0])) for faces in arrays.faces],
            interior_entropy=float(-(frequencies * np.log2(frequencies)).sum()) + 0.0,
        )  # fmt: skip
        if tileset.kind != "fresh":
            drawn = 1 if wang else tileset.micro.interiors
            context.report(
                entropy_per_cell=entropy_per_cell(
                    interior >= 0, tileset.kind, tileset.palette_colors, drawn, periodic=periodic
                )
            )
        if broken.sum() > self.violations:
            raise DesignError(
                f"the tiling breaks Rule 1 at {broken[0]}, {broken[1]} and {broken[2]} faces across x, y and z; "
                f"allowed are {self.violations} in all",
                hint="a tile rule must give the two cells beside a face the color of that face",
            )
