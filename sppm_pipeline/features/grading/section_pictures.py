"""Pictures of a porosity that follows a map: sections, and measured over wanted values."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.pictures.sheets import colors_of, contact_sheet, with_scale

_ALONG = 900  # pixels along the longer side of a section
_NOTHING = (235, 235, 235)
_POINTS = 4000  # points of the moving window that are drawn


def map_sections(
    target: NDArray[np.float64], measured: NDArray[np.float64], there: NDArray[np.bool_], what: str = "porosity"
) -> NDArray[np.uint8]:
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


def _enlarged(values: NDArray[np.float64], inside: NDArray[np.bool_], low: float, high: float) -> NDArray[np.uint8]:
    shown = colors_of(np.where(inside, values, low).ravel(), low, high).reshape(*values.shape, 3)
    shown[~inside] = _NOTHING
    factor = max(1, _ALONG // max(values.shape))
    return np.repeat(np.repeat(shown, factor, 0), factor, 1)


def porosity_scatter(
    cells_wanted: NDArray[np.float64],
    cells_found: NDArray[np.float64],
    wanted: NDArray[np.float64],
    found: NDArray[np.float64],
    noise: float | None,
) -> bytes:
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
