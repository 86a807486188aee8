"""Several pictures on one sheet."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sppm_pipeline.errors import DesignError
from sppm_pipeline.render.lettering import font, printable, text_width
from sppm_pipeline.render.shading import Color

_INK: Color = (52, 58, 66)
_PAPER: Color = (255, 255, 255)
_SOLID: Color = (64, 74, 88)
_VOID: Color = (238, 240, 243)


def contact_sheet(
    images: Sequence[ArrayLike],
    labels: Sequence[str] | None = None,
    *,
    columns: int | None = None,
    title: str = "",
    gap: int = 20,
    text_size: int = 20,
    background: Color = _PAPER,
) -> NDArray[np.uint8]:
    """Place pictures in a grid, row by row, with labels beneath.

    Parameters
    ----------
    images : sequence of (h, w, 3) uint8
        Pictures; smaller ones stand in the middle of their place.
    labels : sequence of str, optional
        One for each picture; a label wider than its picture is set smaller.
    columns : int, optional
        Pictures in a row; without it the sheet is about as wide as high.
    title : str
        Line above all pictures.
    gap : int
        Free pixels around each picture.
    text_size : int
        Size of the labels in pixels; the title is larger by half.
    background : (r, g, b)
        Color of the sheet.

    Returns
    -------
    (height, width, 3) uint8
        The sheet.

    Raises
    ------
    DesignError
        If there is no picture or `columns` is below 1.
    ValueError
        If a picture has another shape or the number of labels differs.
    """
    from PIL import Image, ImageDraw  # only pictures with text need Pillow

    pictures = [np.asarray(image, np.uint8) for image in images]
    if not pictures:
        raise DesignError("there is no picture to place on the sheet")
    if any(picture.ndim != 3 or picture.shape[2] != 3 for picture in pictures):
        raise ValueError(f"pictures must have shape (h, w, 3), got {[picture.shape for picture in pictures]}")
    if labels is not None and len(labels) != len(pictures):
        raise ValueError(f"{len(pictures)} pictures have {len(labels)} labels")
    high = max(picture.shape[0] for picture in pictures)
    wide = max(picture.shape[1] for picture in pictures)
    if columns is None:
        columns = max(1, round(math.sqrt(len(pictures) * high / wide)))
    if columns < 1:
        raise DesignError(f"the sheet has {columns} columns, at least one is needed")
    columns = min(columns, len(pictures))
    rows = -(-len(pictures) // columns)
    caption = int(text_size * 1.7) if labels is not None else 0
    head = int(text_size * 2.4) if title else 0
    sheet = np.empty((head + gap + rows * (high + caption + gap), gap + columns * (wide + gap), 3), np.uint8)
    sheet[:] = background
    corners = []
    for number, picture in enumerate(pictures):
        top = head + gap + number // columns * (high + caption + gap)
        left = gap + number % columns * (wide + gap)
        corners.append((top, left))
        row, column = top + (high - picture.shape[0]) // 2, left + (wide - picture.shape[1]) // 2
        sheet[row : row + picture.shape[0], column : column + picture.shape[1]] = picture
    if labels is None and not title:
        return sheet
    canvas = Image.fromarray(sheet)
    pen = ImageDraw.Draw(canvas)

    def write(text: str, middle: float, line: float, size: int, room: int) -> None:
        while size > 8 and text_width(text, size) > room:
            size -= 1
        pen.text((middle, line), printable(text), fill=_INK, font=font(size), anchor="mm")

    for (top, left), label in zip(corners, labels or (), strict=False):
        write(label, left + wide / 2, top + high + caption / 2, text_size, wide + gap // 2)
    if title:
        write(title, sheet.shape[1] / 2, gap / 2 + head / 2, int(text_size * 1.5), sheet.shape[1] - gap)
    return np.asarray(canvas, np.uint8).copy()


def layer_sheet(
    layers: Sequence[ArrayLike],
    labels: Sequence[str] | None = None,
    *,
    columns: int | None = None,
    title: str = "",
    width: int = 320,
    solid: Color = _SOLID,
    void: Color = _VOID,
) -> NDArray[np.uint8]:
    """Show printing layers side by side.

    Parameters
    ----------
    layers : sequence of (h, w) bool or uint8
        Images as they are printed, row 0 on top: true or 255 is solid, gray values are mixed.
    labels : sequence of str, optional
        One for each layer.
    columns : int, optional
        Layers in a row.
    title : str
        Line above all layers.
    width : int
        Width of the widest layer on the sheet in pixels. Larger layers are averaged down; smaller ones are enlarged by
        the nearest whole factor, so that every pixel stays a square.
    solid, void : (r, g, b)
        Colors of material and of nothing.

    Returns
    -------
    (height, width, 3) uint8
        The sheet.

    Raises
    ------
    DesignError
        If there is no layer, or `width` or `columns` is below 1.
    ValueError
        If a layer hasn't two axes, or the number of labels differs.
    """
    from PIL import Image  # only sheets need Pillow

    if width < 1:
        raise DesignError(f"layers are {width} pixels wide, at least one is needed")
    shares = [np.asarray(layer) for layer in layers]
    if any(layer.ndim != 2 or 0 in layer.shape for layer in shares):
        raise ValueError(f"layers must have shape (h, w), got {[layer.shape for layer in shares]}")
    widest = max((layer.shape[1] for layer in shares), default=1)
    pictures = []
    for layer in shares:
        gray = layer.astype(np.uint8) * np.uint8(255) if layer.dtype == np.bool_ else layer.astype(np.uint8)
        if widest > width:
            size = (max(1, layer.shape[1] * width // widest), max(1, layer.shape[0] * width // widest))
            gray = np.asarray(Image.fromarray(gray).resize(size, Image.Resampling.BOX))
        else:
            factor = round(width / widest)
            gray = gray.repeat(factor, axis=0).repeat(factor, axis=1)
        share = gray[..., None] / 255.0
        mixed = share * np.array(solid) + (1.0 - share) * np.array(void)
        pictures.append(np.rint(mixed).astype(np.uint8))
    return contact_sheet(pictures, labels, columns=columns, title=title)
