"""``check.local_porosity``: the porosity from place to place, compared with a map."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from importlib.util import find_spec
from typing import ClassVar, NamedTuple

import numpy as np

from sppm_pipeline import Palette, Part, ScalarField, TileSet, Tiling, options
from sppm_pipeline.errors import ConfigError
from sppm_pipeline.features.grading.curved_cells import CurvedCells
from sppm_pipeline.features.grading.curved_porosity import CurvedSamples, curved_cells_of, curved_targets
from sppm_pipeline.features.grading.laws import StiffnessLaw
from sppm_pipeline.features.grading.local_porosity import (
    BLOCKS,
    MIN_SHARE,
    block_counts,
    error_summary,
    filled_cells,
    smoothed_means,
)
from sppm_pipeline.features.grading.rounds import trial
from sppm_pipeline.method.assembly.contents import TilingArrays
from sppm_pipeline.method.nouns.maps import Grading
from sppm_pipeline.nouns.palette import Blocks
from sppm_pipeline.services.arrays import F64, I64, U8, Bools
from sppm_pipeline.services.grid import cell_centers
from sppm_pipeline.services.pictures.sheets import colors_of, contact_sheet, with_scale
from sppm_pipeline.stage import Context, Headline, Recipe, Stage

_ALONG = 900  # pixels along the longer side of a section
_NOTHING = (235, 235, 235)
_POINTS = 4000  # points of the moving window that are drawn


def map_sections(target: F64, measured: F64, there: Bools, what: str = "porosity") -> U8:
    """The section through the middle, across the shortest axis: wanted, measured, and their difference, of values (nx,
    ny, nz). Outside of the part, where `there` is false, it is gray. Target and measured share one scale; the
    difference runs from minus to plus its largest size, which is stated.
    """
    across = 1 if target.shape[1] <= min(target.shape) else int(np.argmin(target.shape))
    middle = target.shape[across] // 2
    wanted, found, inside = (np.take(values, middle, across).T[::-1] for values in (target, measured, there))
    both = np.concatenate([wanted[inside], found[inside]])
    low, high = (float(both.min()), float(both.max())) if both.size else (0.0, 1.0)
    # a constant target would leave no scale
    if high - low < 1e-6:
        low, high = low - 0.01, high + 0.01
    error = found - wanted
    largest = float(np.abs(error[inside]).max()) if inside.any() else 0.0
    pictures = [_enlarged(values, inside, low, high) for values in (wanted, found)]
    pictures.append(_enlarged(error, inside, -max(largest, 1e-6), max(largest, 1e-6)))
    labels = [f"wanted {what}", f"measured {what}", f"measured less wanted, from {-largest:.4g} to {largest:.4g}"]
    wide = pictures[0].shape[1] > 1.5 * pictures[0].shape[0]
    sheet = contact_sheet(pictures, labels, columns=1 if wide else 3)
    return with_scale(sheet, low, high, what, 140)


def _enlarged(values: F64, inside: Bools, low: float, high: float) -> U8:
    shown = colors_of(np.where(inside, values, low).ravel(), low, high).reshape(*values.shape, 3)
    shown[~inside] = _NOTHING
    factor = max(1, _ALONG // max(values.shape))
    return np.repeat(np.repeat(shown, factor, 0), factor, 1)


def porosity_scatter(cells_wanted: F64, cells_found: F64, wanted: F64, found: F64, noise: float | None) -> bytes:
    """A PNG chart of measured over wanted porosity: places of the window, whole cells, the line where both agree, and
    with a noise the band of two deviations around it.
    """
    from sppm_pipeline.services.pictures.charts import Series, chart

    step = max(1, len(wanted) // _POINTS)
    every = np.concatenate([cells_wanted, wanted])
    ends = np.array([every.min(), every.max()])
    series = [
        Series(wanted[::step], found[::step], "in the moving window", color="#b8c4ce"),
        Series(cells_wanted, cells_found, "whole cells", color="#0072b2"),
        Series(ends, ends, "", "line", color="#000000"),
    ]
    if noise is not None:
        for sign in (-2, 2):
            label = "two deviations of a homogeneous structure" if sign > 0 else ""
            series.append(Series(ends, ends + sign * noise, label, "dashed", color="#d55e00"))
    return chart(series, "scatter.png", x_label="wanted porosity", y_label="measured porosity", size=(5.0, 4.2))


NOISE_CELLS = 3
"""Maximum number of cells along an edge of the box in which the noise of a homogeneous structure is measured."""


class BlockMap(NamedTuple):
    """Blocks of the moving window, all (nx, ny, nz): share inside the part, porosity of that, and its target."""

    inside: F64
    void: F64
    target: F64


class CellValues(NamedTuple):
    """Cells: meaning of the numbers that name them, these (m, k), centers (m, 3) mm; the rest is (m,)."""

    columns: tuple[str, ...]
    numbers: I64
    middles: F64
    share: F64
    wanted: F64
    found: F64


@dataclass(frozen=True, kw_only=True)
class CheckLocalPorosity(Stage):
    """Measure the porosity of every cell, and in a window that moves, and compare both with a map.

    The window is a Gaussian with a standard deviation of half a cell edge; the map is smoothed by it, too, and only
    what lies in the part counts. With a recipe the noise is measured that a homogeneous structure of that recipe shows
    in the same window. Written are `cells.csv`, the smoothed porosity as `porosity.vti`, `section.png` with target,
    measured porosity and error, and, if matplotlib is
    installed, `scatter.png`. Where the map came from target moduli by `grade.stiffness`, cells
    get a modulus, too, by its curve, and `stiffness.vti` and `stiffness.png` show it; there is none where the porosity
    lies beyond the curve.

    Of what was bent by a `warp` stage, or laid by `tile.hexahedra`, the cells are those of the structure: there is no
    window, and the pictures show the value of each cell. `cells.csv` names a cell by its place in the box, or by its
    hexahedron and its part of that.
    """

    name: ClassVar[str] = "check.local_porosity"
    libraries: ClassVar[tuple[str, ...]] = ("matplotlib",)
    headline: ClassVar[tuple[Headline, ...]] = (
        Headline("cell_error_rms", "error of cells, rms"), Headline("cell_error_max", "largest"),
        Headline("error_rms", "error in the window, rms"), Headline("noise", "noise of a homogeneous structure"),
    )  # fmt: skip
    reported: ClassVar[tuple[str, ...]] = (
        "cells", "cell_error_mean", "cell_error_rms", "cell_error_p95", "cell_error_max", "error_mean", "error_rms",
        "error_p95", "error_max", "slope", "intercept", "noise", "noise_at", "modulus_error_rms", "modulus_error_max",
    )  # fmt: skip

    resolution: int = options.resolution(48, note="a multiple of 8 is taken", minimum=8, maximum=256)
    path: str | None = options.write_path(None, note="none if omitted", suffixes=("/",))

    def run(self, context: Context, field: ScalarField, grading: Grading, recipe: Recipe | None = None) -> None:
        """Count layer by layer, smooth, compare."""
        curved = curved_cells_of(field)
        if curved is not None:
            cells, maps = self._curved(context, field, curved, grading)
        else:
            blocks = self._blocks(context, field, grading)
            cells = _of_cells(blocks, field)
            target, measured = (smoothed_means(values, blocks.inside) for values in (blocks.target, blocks.void))
            maps = (target, measured, blocks.inside >= 0.5)
        wanted, found = cells.wanted, cells.found
        if not len(found):
            raise ConfigError("no cell lies in the part", hint="give smaller cells")
        context.report(
            cells=len(found), **{f"cell_{name}": value for name, value in error_summary(found - wanted).items()}
        )
        target, measured, there = maps
        x, y = target[there], measured[there]
        if curved is None:
            context.report(**error_summary(y - x))
        # a constant target has no slope
        if x.std() > 1e-9:
            slope, intercept = np.polyfit(x, y, 1)
            context.report(slope=float(slope), intercept=float(intercept))
        noise = None
        if recipe is not None:
            cells_along = field.cells if curved is None else (NOISE_CELLS,) * 3
            noise, at = self._noise(context, recipe, cells_along, _kind(field) == "scattered")
            context.report(noise=noise, noise_at=at)
        law = next((law for law in grading.laws[::-1] if isinstance(law, StiffnessLaw)), None)
        if law is not None:
            error = law.curve.modulus(found) / law.curve.modulus(wanted) - 1
            known = np.abs(error[np.isfinite(error)])
            if len(known):
                context.report(
                    modulus_error_rms=float(np.sqrt((known**2).mean())), modulus_error_max=float(known.max())
                )
        if self.path is not None:
            self._write(context, field, cells, maps, noise, law)

    def _curved(
        self, context: Context, field: ScalarField, curved: CurvedCells, grading: Grading
    ) -> tuple[CellValues, tuple[F64, F64, Bools]]:
        """Porosities of bent cells, and these at blocks of the lattice: wanted, measured, and where cells are."""
        # other points than those by which a level was tuned with the same resolution
        samples = CurvedSamples(field, curved, self.resolution + 1, context.threads)
        counts = samples.shares(lambda done, of: context.progress(done, of, "layers"))
        wanted = curved_targets(grading, "porosity", curved)
        enough = counts.share >= MIN_SHARE
        values = CellValues(
            curved.columns, curved.names[enough], curved.centers[enough], counts.share[enough], wanted[enough],
            counts.porosity[enough],
        )  # fmt: skip
        grid = cell_centers(BLOCKS, field.cells)
        edge, origin = field.physical_edge(), np.array(field.origin_mm)
        shape = tuple(BLOCKS * n for n in field.cells)
        target, measured, there = np.zeros(shape), np.zeros(shape), np.zeros(shape, bool)
        x, y = np.meshgrid(grid.axis(0), grid.axis(1), indexing="ij")
        for k, z in enumerate(grid.axis(2)):
            points = np.stack([x, y, np.full_like(x, z)], -1).reshape(-1, 3) * edge + origin
            cell = curved.places(points).cell.reshape(x.shape)
            there[..., k] = (cell >= 0) & enough[cell]
            target[..., k], measured[..., k] = wanted[cell], counts.porosity[cell]
        return values, (target, measured, there)

    def _blocks(self, context: Context, field: ScalarField, grading: Grading) -> BlockMap:
        """Shares of blocks, a layer of blocks at a time."""
        n = BLOCKS * -(-self.resolution // BLOCKS)
        size, grid, edge = n // BLOCKS, cell_centers(n, field.cells), field.physical_edge()
        grading = grading.in_cells(edge, field.origin_mm)
        nx, ny, nz = (BLOCKS * cells for cells in field.cells)
        filled = filled_cells(field.base if isinstance(field, Part) else field)
        made = BlockMap(*(np.zeros((nx, ny, nz)) for _ in range(3)))
        place = [(np.arange(count) + 0.5) / BLOCKS for count in (nx, ny, nz)]
        whole = float(size**3)
        for k in range(nz):
            start, stop = k * size, (k + 1) * size
            # cells that hold nothing do not count: their void is no pore
            full = np.repeat(np.repeat(filled[:, :, k // BLOCKS], BLOCKS, 0), BLOCKS, 1)
            void = field.solid_zyx(grid, start, stop, context.threads) == 0
            inside = field.inside_zyx(grid, start, stop).view(np.bool_) if isinstance(field, Part) else None
            open_, all_ = (counts[0].T * full for counts in block_counts(void, inside, size))
            made.inside[:, :, k] = all_ / whole
            made.void[:, :, k] = open_ / np.maximum(all_, 1)
            some = np.argwhere(all_ > 0)
            points = np.column_stack([place[0][some[:, 0]], place[1][some[:, 1]], np.full(len(some), place[2][k])])
            made.target[some[:, 0], some[:, 1], k] = grading["porosity"].at(points * edge + np.array(field.origin_mm))
            context.progress(k + 1, nz, "layers of blocks")
        return made

    def _noise(
        self, context: Context, recipe: Recipe, cells: tuple[int, int, int], scattered: bool
    ) -> tuple[float, float]:
        """Standard deviation in the window, and mean, of the porosity of equal cells in a box of at most 3^3."""
        nx, ny, nz = (min(NOISE_CELLS, n) for n in cells)
        blocks = Blocks(np.ones((nx, ny, nz), bool), True) if scattered else None
        colors = (0, 0, 0) if scattered else (1, 1, 1)
        micro = trial(context, recipe, None, 1, Palette(nx * ny * nz, colors, blocks=blocks))
        interior = np.arange(nx * ny * nz, dtype=np.int32).reshape(nx, ny, nz)
        color = -1 if scattered else 0
        x, y, z = (np.full((nx + (a == 0), ny + (a == 1), nz + (a == 2)), color, np.int32) for a in range(3))
        kind = "scattered" if scattered else "fresh"
        tiling = Tiling(TileSet(micro, kind, 0), TilingArrays(interior, (x, y, z), True), None)
        void = tiling.solid(BLOCKS * 3, context.threads).T == 0
        counts, of = block_counts(void, None, 3)
        # cells around the box are those of it once more, but the window ends at it, as it does at that of the field
        means = smoothed_means(counts / of, np.ones(of.shape))
        return float(means.std()), float(void.mean())

    def _write(
        self,
        context: Context,
        field: ScalarField,
        cells: CellValues,
        maps: tuple[F64, F64, Bools],
        noise: float | None,
        law: StiffnessLaw | None,
    ) -> None:
        from PIL import Image

        from sppm_pipeline.services.formats import vti

        assert self.path is not None
        folder = context.output(self.path)
        folder.mkdir()
        edge, origin = field.physical_edge(), np.array(field.origin_mm)
        text = io.StringIO()
        rows = csv.writer(text, lineterminator="\n")
        head = [*cells.columns, "x_mm", "y_mm", "z_mm", "share_inside", "target", "measured", "error"]
        rows.writerow(head if law is None else [*head, "modulus_target", "modulus"])
        for cell, middle, share, wanted, found in zip(*cells[1:], strict=True):
            moduli = () if law is None else law.curve.modulus(np.array([wanted, found])).tolist()
            rows.writerow(
                [*cell.tolist(), *(f"{v:.6g}" for v in (*middle, share)), f"{wanted:.6f}", f"{found:.6f}",
                 f"{found - wanted:.6f}", *(f"{v:.6g}" if np.isfinite(v) else "" for v in moduli)]
            )  # fmt: skip
        (folder / "cells.csv").write_text(text.getvalue(), encoding="utf-8", newline="")
        target, measured, there = maps
        spacing = (edge / BLOCKS,) * 3
        x, y, z = origin.tolist()

        def shown(name: str, picture: str, wanted: F64, found: F64) -> None:
            image = np.where(there, found, np.nan).astype(np.float32)
            with (folder / f"{name}.vti").open("wb") as file:
                file.writelines(vti.encode(image, spacing, (x, y, z), name))
            known = there & np.isfinite(wanted) & np.isfinite(found)
            Image.fromarray(map_sections(wanted, found, known, name)).save(folder / picture)

        shown("porosity", "section.png", target, measured)
        if law is not None:
            shown("stiffness", "stiffness.png", law.curve.modulus(target), law.curve.modulus(measured))
        if find_spec("matplotlib") is None:
            context.warn("scatter.png is not drawn, as matplotlib is not installed: pip install 'sppm-pipeline[plot]'")
            return
        picture = porosity_scatter(cells.wanted, cells.found, target[there], measured[there], noise)
        (folder / "scatter.png").write_bytes(picture)


def _of_cells(blocks: BlockMap, field: ScalarField) -> CellValues:
    """Cells of which enough lies in the part."""
    nx, ny, nz = (n // BLOCKS for n in blocks.inside.shape)

    def summed(values: F64) -> F64:
        return np.asarray(values.reshape(nx, BLOCKS, ny, BLOCKS, nz, BLOCKS).sum((1, 3, 5)))

    inside = summed(blocks.inside)
    enough = inside >= MIN_SHARE * BLOCKS**3
    wanted, found = (summed(values * blocks.inside)[enough] / inside[enough] for values in (blocks.target, blocks.void))
    cells = np.argwhere(enough)
    middles = (cells + 0.5) * field.physical_edge() + np.array(field.origin_mm)
    return CellValues(("i", "j", "k"), cells, middles, inside[enough] / BLOCKS**3, wanted, found)


def _kind(field: ScalarField) -> str:
    """Kind of the tile set that a field is made of; empty for other fields."""
    while not isinstance(field, Tiling) and hasattr(field, "base"):
        field = field.base
    return field.tileset.kind if isinstance(field, Tiling) else ""
