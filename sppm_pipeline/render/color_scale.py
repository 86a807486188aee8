"""Colors for numbers, and the scale that explains them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.render.charts import nice_ticks
from sppm_pipeline.render.lettering import font, printable

_ANCHORS = np.array(
    [[42, 46, 112], [38, 92, 150], [36, 138, 152], [72, 178, 128], [160, 208, 96], [246, 226, 104]], np.float64
)
"""From low to high, each lighter than the one before, so that the order survives printing in gray."""


def colors_of(values: NDArray[np.float64], low: float, high: float) -> NDArray[np.uint8]:
    """Colors (n, 3) of values (n,) between two ends; what lies outside takes the color of the end."""
    span = high - low
    share = np.clip((values - low) / span if span > 0 else np.zeros_like(values), 0, 1) * (len(_ANCHORS) - 1)
    channels = [np.interp(share, np.arange(len(_ANCHORS)), _ANCHORS[:, channel]) for channel in range(3)]
    return np.round(np.stack(channels, axis=1)).astype(np.uint8)


def with_scale(picture: NDArray[np.uint8], low: float, high: float, title: str, width: int) -> NDArray[np.uint8]:
    """The picture (h, w, 3) with a bar of colors of some width to its right."""
    from PIL import Image, ImageDraw

    height = len(picture)
    panel = Image.new("RGB", (width, height), (255, 255, 255))
    pen = ImageDraw.Draw(panel)
    top, bottom, left, right = round(0.16 * height), round(0.9 * height), round(0.12 * width), round(0.28 * width)
    shares = np.linspace(1, 0, bottom - top)
    bar = np.repeat(colors_of(shares, 0, 1)[:, None], right - left, axis=1)
    panel.paste(Image.fromarray(bar), (left, top))
    pen.rectangle((left, top, right, bottom), outline=(60, 60, 60))
    letters = font(max(11, round(height / 50)))
    for tick in nice_ticks(low, high, most=6):
        if low <= tick <= high and high > low:
            y = bottom - (tick - low) / (high - low) * (bottom - top)
            pen.line((right, y, right + 5, y), fill=(60, 60, 60))
            pen.text((right + 9, y), f"{tick:.6g}", fill=(30, 30, 30), font=letters, anchor="lm")
    pen.text((left, top - 16), printable(title), fill=(30, 30, 30), font=letters, anchor="ls")
    return np.concatenate([picture, np.asarray(panel)], axis=1)
