"""Panels of bars: several measures of the same things, each on an axis of its own."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sppm_pipeline.errors import DesignError
from sppm_pipeline.render.lettering import font, printable, text_width
from sppm_pipeline.render.shading import Color

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw

_INK: Color = (52, 58, 66)
_FAINT: Color = (150, 157, 166)
_BAND: Color = (244, 246, 248)
_BAR: Color = (122, 152, 190)
_MARKED: Color = (206, 96, 62)
_FINE = 2  # drawn this much larger and averaged down


class Panel(NamedTuple):
    """One measure.

    Attributes
    ----------
    title : str
        Text above the bars.
    values : sequence of float
        One for each thing; what is not finite is shown as a dash.
    """

    title: str
    values: ArrayLike


def bar_panels(
    labels: Sequence[str],
    panels: Sequence[Panel],
    *,
    title: str = "",
    marked: Collection[int] = (),
    bar_length: int = 110,
    text_size: int = 16,
) -> NDArray[np.uint8]:
    """Draw a row for each thing and a panel of bars for each measure, side by side.

    Bars of a panel start at zero and are as long as its largest value allows; the number stands beside them.

    Parameters
    ----------
    labels : sequence of str
        Names of the things, from top to bottom.
    panels : sequence of Panel
        From left to right.
    title : str
        Text above all panels.
    marked : collection of int
        Rows that are drawn in another color.
    bar_length : int
        Pixels that the span of a panel's values takes.
    text_size : int
        Height of the text in pixels; everything else grows with it.

    Returns
    -------
    (height, width, 3) uint8
        The picture.

    Raises
    ------
    DesignError
        If there is no row or no panel, or a size is not positive.
    ValueError
        If a panel has another number of values than there are labels.
    """
    from PIL import Image, ImageDraw  # only pictures with text need Pillow

    if not labels or not panels:
        raise DesignError(f"{len(labels)} rows and {len(panels)} measures make no picture; at least one each is needed")
    if bar_length < 1 or text_size < 1:
        raise DesignError(f"bars of {bar_length} and text of {text_size} pixels can't be drawn")
    columns = [np.asarray(panel.values, np.float64) for panel in panels]
    if any(column.shape != (len(labels),) for column in columns):
        raise ValueError(f"{len(labels)} rows have panels of shapes {[column.shape for column in columns]}")
    text, length = text_size * _FINE, bar_length * _FINE
    row, pad = round(1.6 * text), round(0.9 * text)
    names = max(text_width(label, text) for label in labels)
    numbers = [[_number(value) for value in column.tolist()] for column in columns]
    figures = [max(text_width(number, text) for number in column) for column in numbers]
    widths = [max(length + pad // 2 + wide, text_width(p.title, text)) for p, wide in zip(panels, figures, strict=True)]
    top = round((2.4 if title else 0.6) * text) + 2 * text
    width = max(2 * pad + names + sum(widths) + 2 * pad * len(panels), 2 * pad + text_width(title, round(1.15 * text)))
    height = top + row * len(labels) + pad
    width, height = (-(-side // _FINE) * _FINE for side in (width, height))
    canvas = Image.new("RGB", (width, height), (255, 255, 255))
    pen = ImageDraw.Draw(canvas)
    if title:
        heading = font(round(1.15 * text))
        pen.text((width / 2, 1.3 * text), printable(title), fill=_INK, font=heading, anchor="mm")
    for number in range(0, len(labels), 2):
        pen.rectangle((0, top + number * row, width, top + (number + 1) * row - 1), fill=_BAND)
    for number, label in enumerate(labels):
        color = _MARKED if number in marked else _INK
        pen.text((pad, top + (number + 0.5) * row), printable(label), fill=color, font=font(text), anchor="lm")
    left = pad + names + 2 * pad
    for panel, column, words, wide in zip(panels, columns, numbers, widths, strict=True):
        pen.text((left, top - 0.9 * text), printable(panel.title), fill=_INK, font=font(text), anchor="lm")
        _draw_bars(pen, column, words, marked, (left, top, length, row), text)
        left += wide + 2 * pad
    return np.asarray(canvas.reduce(_FINE), np.uint8).copy()


def _number(value: float) -> str:
    return f"{value:.3g}" if math.isfinite(value) else "-"


def _draw_bars(
    pen: ImageDraw,
    values: NDArray[np.float64],
    words: Sequence[str],
    marked: Collection[int],
    place: tuple[int, int, int, int],
    text: int,
) -> None:
    """The bars of one panel and their numbers."""
    left, top, length, row = place
    known = values[np.isfinite(values)]
    low, high = min(0.0, float(known.min(initial=0.0))), max(0.0, float(known.max(initial=0.0)))
    scale = length / (high - low) if high > low else 0.0
    zero = left - low * scale
    for number, (value, word) in enumerate(zip(values.tolist(), words, strict=True)):
        y = top + (number + 0.5) * row
        end = zero
        if math.isfinite(value):
            end = zero + value * scale
            color = _MARKED if number in marked else _BAR
            pen.rectangle((min(zero, end), y - 0.3 * row, max(zero, end), y + 0.3 * row), fill=color)
        pen.text(
            (max(zero, end) + 0.3 * text, y), word, fill=_INK if math.isfinite(value) else _FAINT, font=font(text),
            anchor="lm",
        )  # fmt: skip
    pen.line([(zero, top), (zero, top + row * len(words))], fill=_FAINT, width=max(1, text // 16))
