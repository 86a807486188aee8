"""``write.curves``: curves of compression in one chart, tested and simulated ones, and batches of specimens."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_crushing.compression import CompressionCurve
from sppm_crushing.numerics.compression import Specimen, efficiency, loading, mean_and_spread, percent
from sppm_crushing.stages.measure_compression import check_plateau, energy_end, measured, plateau_window
from sppm_pipeline import Context, DesignError, Stage, option, options
from sppm_pipeline.pictures import CHART_COLORS as COLORS
from sppm_pipeline.pictures import figure_file, plain_text, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]

MARKS = {"first maximum": "v", "plateau end": "s", "densification strain": "D"}
"""Measures that are points of a curve, and their signs."""


class Line(NamedTuple):
    """A curve, or the mean of several; arrays (n,) are NaN where there is nothing to draw."""

    label: str
    dashed: bool
    strain: Array
    stress: Array
    energy: Array
    efficiency: Array
    spread: Array | None  # half height of the band around the stress
    plateau: tuple[float, float, float] | None  # from, to, stress
    marks: dict[str, float]  # strains of `MARKS`


def compression_chart(lines: Sequence[Line], path: str, *, title: str, unit: str, energy_unit: str) -> bytes:
    """Draw curves to a file of the extension of `path` (.pdf, .png or .svg); units are empty for relative ones."""
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    with styled():
        figure = Figure(figsize=(5.6, 6.4), layout="constrained")
        stress, energy, share = figure.subplots(3, 1, sharex=True, height_ratios=(2.4, 1, 1))
        stress.set_title(title)
        stress.set_ylabel(f"stress ({unit})" if unit else r"stress / $E_\mathrm{s}$")
        energy.set_ylabel(f"$W$ ({energy_unit})" if energy_unit else r"$W$ / $E_\mathrm{s}$")
        share.set_ylabel(r"efficiency $W / \sigma$")
        share.set_xlabel("strain (%)")
        for axes in (stress, energy, share):
            axes.minorticks_on()
            axes.grid(True)
        # the legend explains only signs that are drawn
        used = {name for line in lines for name in line.marks}
        for number, line in enumerate(lines):
            _draw(line, COLORS[number % len(COLORS)], stress, energy, share)
        for axes in (stress, energy, share):
            axes.set_xlim(left=0)
            axes.set_ylim(bottom=0)
        entries = [
            Line2D(
                [], [], color=COLORS[n % len(COLORS)], linestyle="--" if line.dashed else "-",
                label=plain_text(line.label),
            )
            for n, line in enumerate(lines)
        ]  # fmt: skip
        signs = [
            Line2D([], [], color="#555555", marker=sign, linestyle="none", label=name)
            for name, sign in MARKS.items()
            if name in used
        ]
        if any(line.plateau for line in lines):
            signs.append(Line2D([], [], color="#555555", linewidth=3.2, alpha=0.45, label="plateau stress"))
        handles = [entry for entry in entries if entry.get_label()] + signs
        if len(handles) > 6:  # a long list would hide what it explains
            figure.legend(handles=handles, loc="outside lower center", ncols=3)
        elif handles:
            stress.legend(handles=handles, loc="best")
        figure.align_ylabels()
        return figure_file(figure, path)


def _draw(line: Line, color: str, stress: Axes, energy: Axes, share: Axes) -> None:
    percent, style = 100 * line.strain, "--" if line.dashed else "-"
    if line.spread is not None:
        low, high = line.stress - line.spread, line.stress + line.spread
        stress.fill_between(percent, low, high, color=color, alpha=0.2, linewidth=0)
    for axes, values in ((stress, line.stress), (energy, line.energy), (share, line.efficiency)):
        axes.plot(percent, values, style, color=color)
    if line.plateau is not None:
        first, last, value = line.plateau
        stress.plot([100 * first, 100 * last], [value, value], color=color, linewidth=3.2, alpha=0.45)
    for name, at in line.marks.items():
        for axes, values in ((stress, line.stress), (share, line.efficiency)):
            if axes is stress or name == "densification strain":
                height = float(np.interp(at, line.strain, values))
                axes.plot([100 * at], [height], MARKS[name], color=color, markeredgecolor="white", markersize=5.5)


NOTES = {"simulated": "simulation", "measured": "test"}


@dataclass(frozen=True, kw_only=True)
class WriteCurves(Stage):
    """Draw curves of compression over each other: stress, and below it energy and efficiency, over strain.

    Tests are drawn as lines, simulations dashed. Curves of one name and origin are specimens of one batch: their mean
    is drawn with a band of one sample standard deviation, up to the end of the shortest. The energy W is the area below
    the curve, the efficiency W over the stress; its largest value marks the densification strain. A table holds the
    numbers in steps of 0.1 % strain. Charts are drawn by matplotlib: ``pip install 'sppm-pipeline[plot]'``.
    """

    name: ClassVar[str] = "write.curves"
    libraries: ClassVar[tuple[str, ...]] = ("matplotlib",)

    path: str = options.write_path("curves.png", suffixes=options.CHARTS)
    table: str | None = option(
        "curves.csv", help="CSV file of the numbers; none if null", output=True, suffixes=(".csv",)
    )
    measures: bool = option(False, help="mark plateau stress, first maximum, plateau end and densification strain")
    plateau: tuple[float, float] = plateau_window()
    energy_to: float = energy_end()
    title: str = options.title("", note="above the chart")

    def check_options(self) -> None:
        """A chart that can be drawn."""
        from sppm_pipeline.pictures import check_chart

        check_chart(self.path, title=self.title)
        check_plateau(self.plateau)

    def run(self, context: Context, curves: tuple[CompressionCurve, ...]) -> None:
        """Average, draw, write."""
        units = {curve.unit for curve in curves}
        if "relative" in units and len(units) > 1:
            names = ", ".join(repr(curve.name) for curve in curves if curve.unit == "relative")
            raise DesignError(
                f"the stresses of {names} are relative to Young's modulus, and those of others are not",
                hint="simulate with the `unit` of the tests",
            )
        specimen = Specimen("MPa" if len(units) > 1 else units.pop())
        batches: dict[tuple[str, str], list[CompressionCurve]] = {}
        for curve in curves:
            batches.setdefault((curve.name, curve.origin), []).append(curve)
        lines = [self._line(batch, specimen.unit) for batch in batches.values()]
        chart = compression_chart(
            lines, self.path, title=self.title, unit=specimen.stress_unit, energy_unit=specimen.energy_unit
        )
        context.output(self.path).write_bytes(chart)
        if self.table is not None:
            text = _csv(lines, specimen)
            context.output(self.table).write_text(text, encoding="utf-8", newline="")
        context.report(curves=len(curves), lines=[line.label for line in lines])

    def _line(self, batch: Sequence[CompressionCurve], unit: str) -> Line:
        """A curve, or the mean of several."""
        first, spread, note = batch[0], None, NOTES[batch[0].origin]
        pairs = [
            (curve.strain, curve.stress * (1e3 if (curve.unit, unit) == ("GPa", "MPa") else 1.0)) for curve in batch
        ]
        try:
            if len(pairs) == 1:
                drawn = loading(*pairs[0])
                note += f" to {percent(drawn.end)}, where {first.ended}" if first.ended else ""
            else:
                strain, mean, spread = mean_and_spread(pairs)
                drawn, note = loading(strain, mean), f"mean of {len(batch)} {note}s ± s"
        except ValueError as error:
            raise DesignError(f"{first.name or note} can't be drawn: {error}") from error
        marks: dict[str, float] = {}
        plateau = None
        if self.measures:
            of_mean = CompressionCurve(drawn.strain, drawn.stress, unit, first.origin, first.name)
            found = {one.name: one.value for one in measured(of_mean, self.plateau, self.energy_to)}
            places = zip(MARKS, ("first_maximum_strain", "plateau_end", "densification_strain"), strict=True)
            marks = {mark: at for mark, name in places if (at := found[name]) is not None}
            stress = found["plateau_stress"]
            plateau = None if stress is None else (*self.plateau, stress)
        label = f"{first.name}, {note}" if first.name else note
        return Line(
            label, first.origin == "simulated", drawn.strain, drawn.stress, drawn.work,
            efficiency(drawn, self.plateau[0]), spread, plateau, marks,
        )  # fmt: skip


def _csv(lines: Sequence[Line], specimen: Specimen) -> str:
    """A row for each strain; a curve that has ended leaves its cells empty."""
    columns: list[tuple[str, NDArray[np.float64]]] = []
    for line in lines:
        stress, energy = specimen.stress_unit or "E_s", specimen.energy_unit or "E_s"
        columns.append((f"{line.label}: stress ({stress})", line.stress))
        if line.spread is not None:
            columns.append((f"{line.label}: standard deviation ({stress})", line.spread))
        columns.append((f"{line.label}: W ({energy})", line.energy))
        columns.append((f"{line.label}: efficiency", line.efficiency))
    longest = max((line.strain for line in lines), key=len)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["strain", *(heading for heading, _ in columns)])
    for row, strain in enumerate(longest):
        cells = [values[row] if row < len(values) else np.nan for _, values in columns]
        writer.writerow([f"{strain:.6g}", *("" if np.isnan(value) else f"{value:.6g}" for value in cells)])
    return text.getvalue()
