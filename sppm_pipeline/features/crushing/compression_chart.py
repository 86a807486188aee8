"""A chart of curves of compression: stress, energy and efficiency over strain, one below the other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

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
                [],
                [],
                color=COLORS[n % len(COLORS)],
                linestyle="--" if line.dashed else "-",
                label=plain_text(line.label),
            )
            for n, line in enumerate(lines)
        ]
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
