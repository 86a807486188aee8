"""Panels of bars side by side, by matplotlib: a row for each thing, a panel for each measure."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sppm_pipeline.errors import DesignError
from sppm_pipeline.services.pictures.chart_style import COLORS, figure_file, plain_text, styled

_GRAY = "#888888"


class Panel(NamedTuple):
    """One measure in a chart of bars: its heading, and a value for each row, NaN where there is none."""

    heading: str
    values: ArrayLike


def bars(
    labels: Sequence[str], panels: Sequence[Panel], path: str, *, title: str = "", marked: Collection[int] = ()
) -> bytes:
    """Draw a row for each label, from the top, and a panel of bars for each measure, side by side.

    Each panel has a scale of its own that includes zero. Numbers stand beside the bars, a dash where there is none. The
    extension of the path is .pdf, .png or .svg; marked rows are drawn in another color.
    """
    from matplotlib.figure import Figure

    if not labels or not panels:
        raise DesignError(f"{len(labels)} rows and {len(panels)} measures make no chart; at least one each is needed")
    columns = [np.asarray(panel.values, np.float64) for panel in panels]
    if any(column.shape != (len(labels),) for column in columns):
        raise ValueError(f"{len(labels)} rows have panels of shapes {[column.shape for column in columns]}")
    rows = np.arange(len(labels))
    colors = [COLORS[1] if row in marked else COLORS[0] for row in rows]
    with styled():
        figure = Figure(figsize=(1.2 + 1.25 * len(panels), 0.6 + 0.19 * len(labels)), layout="constrained")
        figure.suptitle(title, fontsize=10)
        for column, (axes, panel) in enumerate(
            zip(figure.subplots(1, len(panels), sharey=True, squeeze=False)[0], panels, strict=True)
        ):
            values = np.where(np.isfinite(columns[column]), columns[column], np.nan)
            drawn = axes.barh(rows, np.nan_to_num(values), height=0.62, color=colors)
            texts = [f"{value:.3g}" if math.isfinite(value) else "–" for value in values.tolist()]
            axes.bar_label(drawn, texts, padding=2, fontsize=7.5)
            axes.barh(rows[::2], 1, height=1, color="#f4f6f8", zorder=0, transform=axes.get_yaxis_transform())
            axes.axvline(0.0, color=_GRAY, linewidth=0.7)
            axes.set_title(panel.heading, fontsize=9)
            axes.spines[:].set_visible(False)
            axes.tick_params(left=False, right=False, bottom=False, top=False, labelbottom=False)
            axes.margins(x=0.36, y=0)
            axes.set_ylim(len(labels) - 0.5, -0.5)
            if not column:  # the others share its rows
                axes.set_yticks(rows, [plain_text(label) for label in labels])
                for row in marked:
                    axes.get_yticklabels()[row].set_color(COLORS[1])
        return figure_file(figure, path)
