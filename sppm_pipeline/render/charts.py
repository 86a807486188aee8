"""Charts of results: lines, points and box plots on common axes."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sppm_pipeline.errors import DesignError
from sppm_pipeline.render.lettering import font, printable, text_width
from sppm_pipeline.render.series import Boxes, Line, Points, box_statistics
from sppm_pipeline.render.shading import Color

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw

_COLORS: tuple[Color, ...] = (
    (46, 98, 158),
    (206, 96, 62),
    (66, 140, 104),
    (136, 92, 158),
    (196, 148, 44),
    (96, 104, 114),
)
_INK: Color = (52, 58, 66)
_GRID: Color = (228, 231, 235)
_FINE = 3  # drawn this much larger and averaged down, for smooth edges


def nice_ticks(low: float, high: float, log: bool = False, most: int = 8) -> list[float]:
    """Round numbers within low..high: multiples of 1, 2, 2.5 or 5 times a power of ten; powers of ten on a log axis.

    Parameters
    ----------
    low, high : float
        Ends of the axis, low < high, positive on a log axis.
    log : bool
        Whether the axis is logarithmic; below two decades it gets 2 and 5 times the powers of ten as well.
    most : int
        Largest number of ticks.

    Returns
    -------
    list of float
        Ticks in rising order.
    """
    if log:
        first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
        within = [
            10.0**e for e in range(first, last + 1) if low <= 10.0**e * (1 + 1e-9) and 10.0**e <= high * (1 + 1e-9)
        ]
        if len(within) < 3:
            steps = [m * 10.0**e for e in range(first, last + 1) for m in (1, 2, 5)]
            within = [tick for tick in steps if low <= tick * (1 + 1e-9) and tick <= high * (1 + 1e-9)]
        return within[:: -(-len(within) // most)] if within else []
    rough = (high - low) / most
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(m * power for m in (1.0, 2.0, 2.5, 5.0, 10.0) if m * power >= rough * (1 - 1e-9))
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [n * step for n in range(first, last + 1)]


def _tick_text(tick: float) -> str:
    return "0" if abs(tick) < 1e-12 else f"{tick:.6g}"


class _Axis(NamedTuple):
    low: float
    high: float
    log: bool
    start: float  # pixels
    end: float

    def at(self, values: ArrayLike) -> NDArray[np.float64]:
        numbers = np.asarray(values, np.float64)
        low, high = self.low, self.high
        if self.log:
            numbers = np.log10(np.where(numbers > 0.0, numbers, np.nan))
            low, high = math.log10(low), math.log10(high)
        return np.asarray(self.start + (numbers - low) / (high - low) * (self.end - self.start))


def _reach(
    values: list[NDArray[np.float64]], given: tuple[float, float] | None, log: bool, name: str
) -> tuple[float, float]:
    if given is not None:
        low, high = given
        if not low < high or (log and low <= 0.0):
            raise DesignError(
                f"the range of the {name} axis is {low} to {high}",
                hint="the first number must be the smaller one" + (", and positive on a log axis" if log else ""),
            )
        return low, high
    numbers = np.concatenate([v.ravel() for v in values]) if values else np.zeros(0)
    numbers = numbers[np.isfinite(numbers) & (numbers > 0.0 if log else True)]
    if not numbers.size:
        return (1.0, 10.0) if log else (0.0, 1.0)
    low, high = float(numbers.min()), float(numbers.max())
    if log:
        spread = max((high / low) ** 0.05, 1.1)
        return low / spread, high * spread
    spread = 0.05 * (high - low) or 0.5 * abs(high) or 0.5
    return low - spread, high + spread


def _paler(color: Color, share: float) -> Color:
    red, green, blue = (round(255 - share * (255 - c)) for c in color)
    return red, green, blue


def _dashes(points: list[tuple[float, float]], length: float) -> list[list[tuple[float, float]]]:
    """Cut a line into dashes of `length` with gaps of 0.7 times it."""
    dashes: list[list[tuple[float, float]]] = [[points[0]]]
    drawn, left = True, length
    for (x, y), (x_end, y_end) in itertools.pairwise(points):
        span = math.hypot(x_end - x, y_end - y)
        done = 0.0
        while span - done > left:
            done += left
            corner = (x + (x_end - x) * done / span, y + (y_end - y) * done / span)
            if drawn:
                dashes[-1].append(corner)
            else:
                dashes.append([corner])
            drawn = not drawn
            left = length if drawn else 0.7 * length
        left -= span - done
        if drawn:
            dashes[-1].append((x_end, y_end))
    return [dash for dash in dashes if len(dash) > 1]


def _draw_line(pen: ImageDraw, line: Line, x: _Axis, y: _Axis, color: Color, unit: float) -> None:
    across, up = x.at(line.x), y.at(line.y)
    known = np.isfinite(across) & np.isfinite(up)
    ends = np.flatnonzero(np.diff(np.concatenate([[False], known, [False]]).astype(np.int8)))
    for first, last in zip(ends[::2], ends[1::2], strict=True):
        points = list(zip(across[first:last].tolist(), up[first:last].tolist(), strict=True))
        for piece in _dashes(points, 9 * unit) if line.dashed else [points]:
            pen.line(piece, fill=color, width=round(2.4 * unit), joint="curve")


def _draw_points(pen: ImageDraw, points: Points, x: _Axis, y: _Axis, color: Color, unit: float) -> None:
    for a, b in zip(x.at(points.x).tolist(), y.at(points.y).tolist(), strict=True):
        if math.isfinite(a) and math.isfinite(b):
            radius = 4.2 * unit
            pen.ellipse(
                (a - radius, b - radius, a + radius, b + radius), fill=color, outline=(255, 255, 255), width=round(unit)
            )


def _draw_boxes(pen: ImageDraw, boxes: Boxes, x: _Axis, y: _Axis, color: Color, unit: float) -> None:
    middles = x.at(boxes.x)
    spacing = float(np.diff(np.sort(middles)).min()) if middles.size > 1 else abs(x.end - x.start) / 4
    half = min(max(0.32 * spacing, 3 * unit), 34 * unit)
    for middle, sample in zip(middles.tolist(), boxes.samples, strict=True):
        numbers = box_statistics(sample)
        low, lower, median, upper, high = (float(v) for v in y.at(numbers[:5]))
        thick = round(1.8 * unit)
        for start, end in ((lower, low), (upper, high)):
            pen.line([(middle, start), (middle, end)], fill=color, width=thick)
            pen.line([(middle - half / 2, end), (middle + half / 2, end)], fill=color, width=thick)
        pen.rectangle(
            (middle - half, upper, middle + half, lower), fill=_paler(color, 0.28), outline=color, width=thick
        )
        pen.line([(middle - half, median), (middle + half, median)], fill=color, width=round(3 * unit))
        for value in y.at(numbers.outliers).tolist():
            radius = 3.2 * unit
            pen.ellipse((middle - radius, value - radius, middle + radius, value + radius), outline=color, width=thick)


def _spread(series: Sequence[Line | Points | Boxes]) -> tuple[list[NDArray[np.float64]], list[NDArray[np.float64]]]:
    """All x and all y that have to be seen; boxes get room at their sides."""
    across, up = [], []
    for one in series:
        x = np.asarray(one.x, np.float64)
        if isinstance(one, Boxes):
            if len(one.samples) != x.size:
                raise ValueError(f"{x.size} boxes have {len(one.samples)} samples")
            side = float(np.diff(np.sort(x)).min()) / 2 if x.size > 1 else 0.0
            across += [x - side, x + side]
            up += [np.asarray(sample, np.float64) for sample in one.samples]
        else:
            y = np.asarray(one.y, np.float64)
            if x.ndim != 1 or x.shape != y.shape:
                raise ValueError(f"x and y of a series must be equally long, got {x.shape} and {y.shape}")
            across.append(x)
            up.append(y)
    return across, up


def chart(
    series: Sequence[Line | Points | Boxes],
    *,
    title: str = "",
    x_label: str = "",
    y_label: str = "",
    size: tuple[int, int] = (960, 640),
    x_range: tuple[float, float] | None = None,
    y_range: tuple[float, float] | None = None,
    x_log: bool = False,
    y_log: bool = False,
    text_size: int = 18,
) -> NDArray[np.uint8]:
    """Draw series on common axes.

    Parameters
    ----------
    series : sequence of Line, Points or Boxes
        What is drawn, the first one at the bottom.
    title, x_label, y_label : str
        Texts above, below and at the left of the axes.
    size : (width, height)
        Size of the chart in pixels, 160 x 120 at least.
    x_range, y_range : (low, high), optional
        Ends of the axes; found from the data otherwise.
    x_log, y_log : bool
        Whether an axis is logarithmic. Values that aren't positive are then left out.
    text_size : int
        Height of the text in pixels; lines grow with it.

    Returns
    -------
    (height, width, 3) uint8
        The chart.

    Raises
    ------
    DesignError
        If the size is too small or a range isn't low to high.
    ValueError
        If the x and y of a series differ in length.
    """
    from PIL import Image, ImageDraw  # only pictures with text need Pillow

    if size[0] < 160 or size[1] < 120:
        raise DesignError(f"the chart is {size[0]} x {size[1]} pixels, at least 160 x 120 are needed")
    across, up = _spread(series)
    x_low, x_high = _reach(across, x_range, x_log, "x")
    y_low, y_high = _reach(up, y_range, y_log, "y")
    x_ticks, y_ticks = nice_ticks(x_low, x_high, x_log), nice_ticks(y_low, y_high, y_log)
    width, height = size[0] * _FINE, size[1] * _FINE
    text = text_size * _FINE
    unit = text / 18
    widest = max((text_width(_tick_text(tick), text) for tick in y_ticks), default=0)
    left = round(widest + text * (1.1 + (1.6 if y_label else 0.0)))
    bottom = round(height - text * (2.0 + (1.5 if x_label else 0.0)))
    top, right = round(text * (2.4 if title else 0.9)), round(width - 1.2 * text)
    x = _Axis(x_low, x_high, x_log, left, right)
    y = _Axis(y_low, y_high, y_log, bottom, top)
    canvas = Image.new("RGB", (width, height), (255, 255, 255))
    pen = ImageDraw.Draw(canvas)
    thin = max(round(1.2 * unit), 1)
    for tick, place in zip(x_ticks, x.at(x_ticks).tolist(), strict=True):
        pen.line([(place, top), (place, bottom)], fill=_GRID, width=thin)
        pen.text((place, bottom + 0.75 * text), _tick_text(tick), fill=_INK, font=font(text), anchor="mm")
    for tick, place in zip(y_ticks, y.at(y_ticks).tolist(), strict=True):
        pen.line([(left, place), (right, place)], fill=_GRID, width=thin)
        pen.text((left - 0.5 * text, place), _tick_text(tick), fill=_INK, font=font(text), anchor="rm")
    # The series are drawn on a copy of which only the part inside the axes is kept.
    inside = canvas.copy()
    brush = ImageDraw.Draw(inside)
    entries: list[tuple[Line | Points | Boxes, Color]] = []
    for one in series:
        color = one.color or _COLORS[len(entries) % len(_COLORS)]
        entries.append((one, color))
        if isinstance(one, Line):
            _draw_line(brush, one, x, y, color, unit)
        elif isinstance(one, Points):
            _draw_points(brush, one, x, y, color, unit)
        else:
            _draw_boxes(brush, one, x, y, color, unit)
    canvas.paste(inside.crop((left, top, right, bottom)), (left, top))
    pen.line([(left, top), (left, bottom), (right, bottom)], fill=_INK, width=round(1.6 * unit))
    _draw_legend(pen, entries, (left, top, right, bottom), np.asarray(canvas), text, unit)
    if title:
        heading = round(1.15 * text)
        pen.text((width / 2, 1.2 * text), printable(title), fill=_INK, font=font(heading), anchor="mm")
    if x_label:
        pen.text(((left + right) / 2, bottom + 2.4 * text), printable(x_label), fill=_INK, font=font(text), anchor="mm")
    if y_label:
        strip = Image.new("RGB", (bottom - top, round(1.6 * text)), (255, 255, 255))
        ImageDraw.Draw(strip).text(
            (strip.width / 2, strip.height / 2), printable(y_label), fill=_INK, font=font(text), anchor="mm"
        )
        canvas.paste(strip.rotate(90, expand=True), (round(0.4 * text), top))
    return np.asarray(canvas.reduce(_FINE), np.uint8).copy()


def _draw_legend(
    pen: ImageDraw,
    entries: list[tuple[Line | Points | Boxes, Color]],
    area: tuple[int, int, int, int],
    drawn: NDArray[np.uint8],
    text: int,
    unit: float,
) -> None:
    """Legend in the corner in which it hides least."""
    named = [(one, color) for one, color in entries if one.label]
    if not named:
        return
    left, top, right, bottom = area
    wide = max(text_width(one.label, text) for one, _ in named) + round(3.8 * text)
    high = round((1.45 * len(named) + 0.5) * text)
    pad = round(0.6 * text)
    corners = [(a, b) for b in (top + pad, bottom - pad - high) for a in (left + pad, right - pad - wide)]

    def hidden(corner: tuple[int, int]) -> int:
        a, b = max(corner[0], 0), max(corner[1], 0)
        return int(np.count_nonzero(drawn[b : b + high, a : a + wide].min(axis=2) < min(_GRID) - 10))

    a, b = min(corners, key=hidden)
    frame = (a, b, a + wide, b + high)
    pen.rounded_rectangle(frame, 0.4 * text, fill=(255, 255, 255), outline=_GRID, width=round(1.2 * unit))
    for number, (one, color) in enumerate(named):
        line = b + (1.45 * number + 0.98) * text
        start, end = a + 0.7 * text, a + 2.5 * text
        axis_x, axis_y = _Axis(0.0, 1.0, False, start, end), _Axis(0.0, 1.0, False, line + text / 2, line - text / 2)
        if isinstance(one, Line):
            _draw_line(pen, one._replace(x=(0.0, 1.0), y=(0.5, 0.5)), axis_x, axis_y, color, unit)
        elif isinstance(one, Points):
            _draw_points(pen, one._replace(x=(0.5,), y=(0.5,)), axis_x, axis_y, color, unit)
        else:
            box = (start, line - 0.34 * text, end, line + 0.34 * text)
            pen.rectangle(box, fill=_paler(color, 0.28), outline=color, width=round(1.8 * unit))
            pen.line([((start + end) / 2, box[1]), ((start + end) / 2, box[3])], fill=color, width=round(3 * unit))
        pen.text((a + 3.1 * text, line), printable(one.label), fill=_INK, font=font(text), anchor="lm")
