"""``check.residual_periodicity``: how much of an assembly still repeats from cell to cell."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline import Context, DesignError, Stage, Tiling, options
from sppm_pipeline.method.fields.scalar_field import RepeatedField
from sppm_pipeline.services.grid import cell_centers


@dataclass(frozen=True, kw_only=True)
class CheckResidualPeriodicity(Stage):
    """Report what repeats from cell to cell of an assembly, so that one sees what a tile rule buys.

    The Bragg share is the part of the variance that repeats from cell to cell: 1 for one repeated cell, 0 for an
    assembly without memory of its lattice. The axis correlation compares each cell with its neighbors. The folded
    solid shares are those of the mean of all cells within 1/16 of the cell size of the corners; of the edges and
    faces, along their middle halves; and in the middle half of the cell. Where they differ, the lattice shows.
    The deviation of the mean cell is to be compared with that expected of independent cells.
    """

    name: ClassVar[str] = "check.residual_periodicity"
    reported: ClassVar[tuple[str, ...]] = (
        "bragg_share", "axis_correlation", "folded_corner", "folded_edge", "folded_face", "folded_center",
        "folded_deviation", "folded_expected",
    )  # fmt: skip

    resolution: int = options.resolution(16, minimum=4, maximum=128)
    path: str | None = options.write_path(
        None, note="three sections through the mean cell; none if omitted", suffixes=(".png",)
    )

    def run(self, context: Context, tiling: Tiling | RepeatedField) -> None:
        """Sample the whole assembly and compare its cells."""
        from sppm_pipeline.method.tiling.residual import axis_correlation, bragg_share, folded_shares, mean_cell

        if isinstance(tiling, Tiling) and (tiling.arrays.surrounded().interior < 0).any():
            raise DesignError(
                "residual periodicity is defined for a full box of cells; this tiling has empty ones",
                hint="lay the same tile set with `cells: [8, 8, 8]` and measure that",
            )
        if max(tiling.cells) < 2:
            raise DesignError("residual periodicity needs at least two cells along some axis")
        solid = tiling.solid(cell_centers(self.resolution, tiling.cells), context.threads)
        correlation = axis_correlation(solid, tiling.cells)
        folded = folded_shares(solid, tiling.cells)
        context.report(bragg_share=bragg_share(solid, tiling.cells), axis_correlation=correlation.mean)
        context.report(**{f"folded_{name}": value for name, value in folded._asdict().items()})
        if self.path is not None:
            from PIL import Image

            from sppm_pipeline.services.pictures.sheets import folded_sections

            picture = folded_sections(mean_cell(solid, tiling.cells), float(solid.mean()), folded.expected)
            Image.fromarray(picture).save(context.output(self.path))
