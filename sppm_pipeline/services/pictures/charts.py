r"""Charts of results by matplotlib: points, lines, error bars and box plots, on common axes or side by side.

Titles and labels may hold mathematics between dollar signs, for instance ``$E_x / E_\mathrm{s}$``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sppm_pipeline.services.arrays import F64
from sppm_pipeline.services.pictures.chart_style import COLORS, figure_file, styled

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.container import Container

_MARKERS = "os^DvPXp"  # one more than colors, so that 56 series differ

MANY = 20
"""Means over more x than this are drawn as a line in a band, since markers with error bars would touch at usual
sizes."""


class Series(NamedTuple):
    """Values over x.

    Attributes
    ----------
    x, y : (n,) float
        What is not finite is left out; it interrupts a line.
    label : str
        Entry in the legend; none if empty.
    kind : {"points", "line", "dashed", "boxes", "means"}
        Markers, a line, a box plot of the values at each x (box from quartile to quartile, whiskers to the last value
        within 1.5 interquartile ranges of it, after Tukey), or their mean with its standard deviation, as error bars
        or, where there are more than `MANY` x, as a band.
    error : (n,) float, optional
        Half lengths of error bars of points; NaN for none.
    color : str, optional
        Color as matplotlib names it; the next one of `COLORS` otherwise.
    hull : bool
        Whether the convex hull of the points is shaded, as in charts of material families (Ashby 2011, "Materials
        Selection in Mechanical Design"); on logarithmic axes that of the logarithms.
    """

    x: ArrayLike
    y: ArrayLike
    label: str = ""
    kind: Literal["points", "line", "dashed", "boxes", "means"] = "points"
    error: ArrayLike | None = None
    color: str | None = None
    hull: bool = False


def chart(
    series: Sequence[Series],
    path: str,
    *,
    title: str = "",
    x_label: str = "",
    y_label: str = "",
    legend: str = "",
    log_x: bool = False,
    log_y: bool = False,
    size: tuple[float, float] = (5.0, 3.4),
) -> bytes:
    """Draw series on common axes; see `charts_beside`."""
    axes = Axis(series, y_label, log_y)
    return charts_beside([axes], path, title=title, x_label=x_label, legend=legend, log_x=log_x, size=size)


class Axis(NamedTuple):
    """One of several charts over the same x."""

    series: Sequence[Series]  # the first one is drawn at the bottom
    label: str  # text at the left of the axes
    log: bool  # the vertical axis is logarithmic


def charts_beside(
    panels: Sequence[Axis],
    path: str,
    *,
    title: str = "",
    x_label: str = "",
    legend: str = "",
    log_x: bool = False,
    size: tuple[float, float] = (5.0, 3.4),
) -> bytes:
    """Draw series over the same x on axes side by side, with a common legend.

    Panels come from the left; series of several have the same labels. The extension of the path is .pdf, .png or .svg;
    the size (width, height) of each chart is in inches. Values that are not positive are left out on logarithmic axes.
    """
    from matplotlib.figure import Figure

    count = len(panels)
    with styled():
        figure = Figure(figsize=(count * size[0], size[1]), layout="constrained")
        named: list[tuple[Artist | Container, str]] = []
        for place, panel in enumerate(panels, 1):
            axes = figure.add_subplot(1, count, place)
            axes.set(title=title if count == 1 else "", xlabel=x_label, ylabel=panel.label)
            axes.set_xscale("log" if log_x else "linear")
            axes.set_yscale("log" if panel.log else "linear")
            axes.minorticks_on()
            axes.grid(True)
            drawn = _draw(axes, panel, log_x)
            named = [(artist, one.label) for artist, one in zip(drawn, panel.series, strict=True) if one.label]
        if count > 1 and title:
            figure.suptitle(title, fontsize=10)
        if named and (len(named) > 6 or count > 1):  # a long list would hide what it explains
            figure.legend(*zip(*named, strict=True), title=legend or None, loc="outside right upper")
        elif named:
            axes.legend(*zip(*named, strict=True), title=legend or None, loc="best")
        return figure_file(figure, path)


def _draw(axes: Axes, panel: Axis, log_x: bool) -> list[Artist | Container]:
    """Draw all series; what stands for each in a legend."""
    boxes = [number for number, one in enumerate(panel.series) if one.kind == "boxes"]
    drawn: list[Artist | Container] = []
    for number, one in enumerate(panel.series):
        x, y = (np.asarray(values, np.float64) for values in (one.x, one.y))
        error = np.full(x.shape, np.nan) if one.error is None else np.asarray(one.error, np.float64)
        if not x.ndim == 1 or not x.shape == y.shape == error.shape:
            raise ValueError(f"x, y and errors of a series have shapes {x.shape}, {y.shape} and {error.shape}")
        x = np.where(np.isfinite(x) & ((x > 0) | (not log_x)), x, np.nan)
        y = np.where(np.isfinite(y) & ((y > 0) | (not panel.log)), y, np.nan)
        color = one.color or COLORS[number % len(COLORS)]
        if one.hull:
            corners = _hull(np.log10(x) if log_x else x, np.log10(y) if panel.log else y)
            axes.fill(x[corners], y[corners], color=color, alpha=0.16, linewidth=0)
        if one.kind == "boxes":
            drawn.append(_boxes(axes, x, y, color, (boxes.index(number), len(boxes)), log_x))
        elif one.kind in ("line", "dashed"):
            drawn += axes.plot(x, y, "--" if one.kind == "dashed" else "-", color=color)
        else:
            joined = one.kind == "means"
            if joined:
                x, y, error = _means(x, y)
            if joined and len(x) > MANY:
                around = np.nan_to_num(error)
                axes.fill_between(x, y - around, y + around, color=color, alpha=0.22, linewidth=0)
                drawn += axes.plot(x, y, "-", color=color)
                continue
            drawn.append(axes.errorbar(
                x, y, error if np.isfinite(error).any() else None, color=color, capsize=2.5, elinewidth=0.9,
                linestyle="-" if joined else "none", marker=_MARKERS[number % len(_MARKERS)],
                markeredgecolor="white", markeredgewidth=0.4,
            ))  # fmt: skip
    if boxes and not log_x:
        places = np.unique(np.concatenate([np.asarray(panel.series[number].x, np.float64) for number in boxes]))
        if len(places) <= 12:
            axes.set_xticks(places[np.isfinite(places)])
            axes.set_xticks([], minor=True)
    return drawn


def _hull(x: F64, y: F64) -> list[int]:
    """Corners of the convex hull of the points with finite coordinates, once around (Andrew 1979)."""
    order = [int(i) for i in np.lexsort((y, x)) if np.isfinite(x[i]) and np.isfinite(y[i])]

    def half(points: Sequence[int]) -> list[int]:
        side: list[int] = []
        for i in points:
            while len(side) > 1 and (x[side[-1]] - x[side[-2]]) * (y[i] - y[side[-2]]) <= (
                y[side[-1]] - y[side[-2]]
            ) * (x[i] - x[side[-2]]):
                side.pop()
            side.append(i)
        return side

    return half(order)[:-1] + half(order[::-1])[:-1]


def _samples(x: F64, y: F64) -> tuple[F64, list[F64]]:
    """Each x once, and the values of y there."""
    known = np.isfinite(x) & np.isfinite(y)
    places = np.unique(x[known])
    return places, [y[known & (x == place)] for place in places]


def _means(x: F64, y: F64) -> tuple[F64, ...]:
    """Each x once, the mean of y there, and its sample standard deviation; NaN for a single value."""
    places, samples = _samples(x, y)
    deviations = [sample.std(ddof=1) if len(sample) > 1 else np.nan for sample in samples]
    return places, np.array([sample.mean() for sample in samples]), np.array(deviations)


def _boxes(axes: Axes, x: F64, y: F64, color: str, place: tuple[int, int], log_x: bool) -> Artist:
    """Box plots at each x; `place` is the number of this series among those that stand side by side."""
    from matplotlib.colors import to_rgba
    from matplotlib.patches import Patch

    face: dict[str, Any] = {"facecolor": to_rgba(color, 0.25), "edgecolor": color, "linewidth": 0.9}

    positions, samples = _samples(x, y)
    if not samples:
        return Patch(**face)
    along = np.log10(positions) if log_x else positions
    # boxes far apart would be bands
    gap = min(float(np.diff(along).min()), float(np.ptp(along)) / 6) if len(along) > 1 else (0.1 if log_x else 1.0)
    number, count = place
    width = 0.7 * gap / count
    left = along + (number - count / 2) * width
    ends = [10**side if log_x else side for side in (left, left + width)]
    found = axes.boxplot(
        samples,
        positions=(ends[0] + ends[1]) / 2,
        widths=0.9 * (ends[1] - ends[0]),
        manage_ticks=False,
        patch_artist=True,
        boxprops=face,
        medianprops={"color": color, "linewidth": 1.6},
        whiskerprops={"color": color, "linewidth": 0.9},
        capprops={"color": color, "linewidth": 0.9},
        flierprops={"marker": "o", "markersize": 3.0, "markeredgecolor": color, "markerfacecolor": "none"},
    )
    box: Artist = found["boxes"][0]
    return box
