"""Annotation of pictures: sheets of several of them, labels, color bars, axes, scale bars; sections of a mean cell."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from sppm_pipeline.errors import DesignError
from sppm_pipeline.services.arrays import F64, U8
from sppm_pipeline.services.pictures.shading import Color

if TYPE_CHECKING:
    from PIL.Image import Image
    from PIL.ImageFont import FreeTypeFont, ImageFont

    from sppm_pipeline.services.pictures.camera import Frame

INK: Color = (52, 58, 66)
PAPER: Color = (255, 255, 255)
_SOLID: Color = (255, 255, 255)
_VOID: Color = (0, 0, 0)
_AROUND_LAYERS: Color = (206, 211, 218)

AXES: tuple[Color, ...] = ((213, 94, 0), (0, 158, 115), (0, 114, 178))
"""Colors of the axes x, y, z, which all kinds of color vision tell apart (Okabe and Ito 2008)."""

DARK_PAPER: Color = (32, 36, 43)
LIGHT_INK: Color = (226, 230, 235)

_SECTION = 300  # pixels along a section of two cells
_LINE: Color = (200, 60, 60)  # of the borders of cells
_FINE = 4  # lines are drawn larger by this, and averaged down

_ANCHORS = np.array(
    [[42, 46, 112], [38, 92, 150], [36, 138, 152], [72, 178, 128], [160, 208, 96], [246, 226, 104]], np.float64
)
"""From low to high, each lighter than the one before, so that the order survives printing in gray."""

# The font has the letters and signs of ASCII and little more; what it lacks is spelt out, not shown as empty boxes.
_SPELT = {
    "α": "alpha", "β": "beta", "γ": "gamma", "δ": "delta", "ε": "epsilon", "θ": "theta", "κ": "kappa", "λ": "lambda",
    "μ": "u", "µ": "u", "ν": "nu", "ξ": "xi", "ρ": "rho", "σ": "sigma", "φ": "phi", "ω": "omega", "−": "-", "–": "-",
    "—": "-", "×": "x", "²": "^2", "³": "^3", "≤": "<=", "≥": ">=", "≈": "~", "…": "...",
}  # fmt: skip


@lru_cache(maxsize=32)
def font(size: int) -> FreeTypeFont | ImageFont:
    """The font at a size in pixels."""
    from PIL import ImageFont as fonts  # only pictures with text need Pillow

    return fonts.load_default(size)


def printable(text: str) -> str:
    """`text` with Greek letters and signs that the font lacks spelt out."""
    return "".join(_SPELT.get(letter, letter) for letter in text)


def text_width(text: str, size: int) -> int:
    """Width of a line of text in pixels, rounded up."""
    return int(-(-font(size).getlength(printable(text)) // 1))


def contact_sheet(
    images: Sequence[ArrayLike],
    labels: Sequence[str] | None = None,
    *,
    columns: int | None = None,
    title: str = "",
    gap: int = 20,
    text_size: int = 20,
    background: Color = PAPER,
    ink: Color = INK,
) -> U8:
    """Place pictures in a grid, row by row, with labels beneath.

    Parameters
    ----------
    images : sequence of (h, w, 3) or (h, w, 4) uint8
        Pictures; smaller ones stand in the middle of their place. With a fourth channel, the opacity, the sheet is
        transparent, too.
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
    background, ink : (r, g, b)
        Colors of the sheet and of the letters.

    Returns
    -------
    (height, width, 3) or (height, width, 4) uint8
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
    channels = pictures[0].shape[-1]
    if channels not in (3, 4) or any(picture.ndim != 3 or picture.shape[2] != channels for picture in pictures):
        raise ValueError(
            f"pictures must have shape (h, w, 3) or all (h, w, 4), got {[picture.shape for picture in pictures]}"
        )
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
    sheet = np.empty((head + gap + rows * (high + caption + gap), gap + columns * (wide + gap), channels), np.uint8)
    sheet[:] = background if channels == 3 else (*background, 0)
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
        pen.text((middle, line), printable(text), fill=ink, font=font(size), anchor="mm")

    for (top, left), label in zip(corners, labels or (), strict=False):
        write(label, left + wide / 2, top + high + caption / 2, text_size, wide + gap // 2)
    if title:
        write(title, sheet.shape[1] / 2, gap / 2 + head / 2, int(text_size * 1.5), sheet.shape[1] - gap)
    return np.asarray(canvas, np.uint8).copy()


def layer_sheet(
    layers: Sequence[ArrayLike],
    labels: Sequence[str] | None = None,
    *,
    width: int = 320,
    pixel: tuple[float, float] = (1.0, 1.0),
    solid: Color = _SOLID,
    void: Color = _VOID,
) -> U8:
    """Show printing layers side by side, as they are printed, (h, w) with row 0 on top; gray values are mixed.

    `width` is that of the widest layer on the sheet in pixels. Larger layers are averaged down; smaller ones are
    enlarged by the nearest whole factor, so that every pixel of a column is as wide as the others. Of the `pixel` pitch
    along x and y the ratio counts: a round part is shown round. Colors are white and black, as in the files of the
    layers.
    """
    from PIL import Image  # only sheets need Pillow

    if width < 1:
        raise DesignError(f"layers are {width} pixels wide, at least one is needed")
    shares = [np.asarray(layer) for layer in layers]
    if any(layer.ndim != 2 or 0 in layer.shape for layer in shares):
        raise ValueError(f"layers must have shape (h, w), got {[layer.shape for layer in shares]}")
    widest = max((layer.shape[1] for layer in shares), default=1)
    scale = width / widest if widest > width else float(round(width / widest))
    pictures = []
    for layer in shares:
        gray = layer.astype(np.uint8) * np.uint8(255) if layer.dtype == np.bool_ else layer.astype(np.uint8)
        wide, high = (layer.shape[1] * scale, layer.shape[0] * scale * pixel[1] / pixel[0])
        size = (max(1, math.floor(wide + 1e-9)), max(1, math.floor(high + 1e-9)))
        gray = np.asarray(Image.fromarray(gray).resize(size, Image.Resampling.BOX))
        share = gray[..., None] / 255.0
        mixed = share * np.array(solid) + (1.0 - share) * np.array(void)
        pictures.append(np.rint(mixed).astype(np.uint8))
    return contact_sheet(pictures, labels, background=_AROUND_LAYERS)


def colors_of(values: F64, low: float, high: float) -> U8:
    """Colors (n, 3) of values (n,) between two ends; what lies outside takes the color of the end."""
    span = high - low
    share = np.clip((values - low) / span if span > 0 else np.zeros_like(values), 0, 1) * (len(_ANCHORS) - 1)
    channels = [np.interp(share, np.arange(len(_ANCHORS)), _ANCHORS[:, channel]) for channel in range(3)]
    return np.round(np.stack(channels, axis=1)).astype(np.uint8)


def _round_numbers(low: float, high: float) -> list[float]:
    """At most seven multiples of 1, 2, 2.5 or 5 times a power of ten within low..high."""
    power = 10.0 ** math.floor(math.log10((high - low) / 6))
    step = next(m * power for m in (1.0, 2.0, 2.5, 5.0, 10.0) if m * power >= (high - low) / 6 * (1 - 1e-9))
    return [n * step for n in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)]


def with_scale(picture: U8, low: float, high: float, title: str, width: int) -> U8:
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
    for tick in _round_numbers(low, high):
        if low <= tick <= high and high > low:
            y = bottom - (tick - low) / (high - low) * (bottom - top)
            pen.line((right, y, right + 5, y), fill=(60, 60, 60))
            pen.text((right + 9, y), f"{tick:.6g}", fill=(30, 30, 30), font=letters, anchor="lm")
    pen.text((left, top - 16), printable(title), fill=(30, 30, 30), font=letters, anchor="ls")
    return np.concatenate([picture, np.asarray(panel)], axis=1)


def annotated(picture: U8, frame: Frame, unit_mm: float | None, *, bar: bool = True, dark: bool = False) -> U8:
    """A picture with the directions of the axes at its lower left, and a scale bar at its lower right.

    The bar is as long as the frame says at the middle of the part; `unit_mm` is the frame's unit of length, None for
    cells without a physical size. `dark` is the background.
    """
    from PIL import Image

    canvas = Image.fromarray(picture)
    ink, halo = (LIGHT_INK, INK) if dark else (INK, PAPER)
    _draw_axes(canvas, frame, ink)
    if bar:
        _draw_bar(canvas, frame.scale / (unit_mm or 1.0), "mm" if unit_mm else "cell sizes", ink, halo)
    return np.asarray(canvas, np.uint8).copy()


def bar_length(pixels_per_unit: float, width: int) -> float:
    """The longest of 1, 2, 5, 10, ... units that takes at most a fifth of a picture's width."""
    power = 10.0 ** math.floor(math.log10(0.2 * width / pixels_per_unit))
    return max(m * power for m in (1.0, 2.0, 5.0) if m * power * pixels_per_unit <= 0.2 * width)


def _draw_bar(canvas: Image, pixels_per_unit: float, unit: str, ink: Color, halo: Color) -> None:
    from PIL import ImageDraw

    width, height = canvas.size
    length = bar_length(pixels_per_unit, width)
    thick, edge = max(2, round(height / 200)), max(4, round(0.025 * height))
    right, bottom = width - 1 - edge, height - 1 - edge
    left = right - round(length * pixels_per_unit) + 1
    pen = ImageDraw.Draw(canvas)
    pen.rectangle((left - 1, bottom - thick, right + 1, bottom + 1), fill=halo)
    pen.rectangle((left, bottom - thick + 1, right, bottom), fill=ink)
    place = ((left + right) / 2, bottom - thick - max(2, height // 150))
    letters = font(max(9, round(height / 40)))
    pen.text(place, f"{length:g} {unit}", fill=ink, font=letters, anchor="mb", stroke_width=2, stroke_fill=halo)


def _draw_axes(canvas: Image, frame: Frame, ink: Color) -> None:
    from PIL import Image, ImageDraw

    width, height = canvas.size
    arm = max(8.0, 0.055 * min(width, height))
    side = round(3.2 * arm)
    patch = Image.new("RGBA", (side * _FINE, side * _FINE), (*ink, 0))
    pen = ImageDraw.Draw(patch)
    middle = side / 2
    line, head = max(1.5, arm / 18), max(3.0, arm / 6)
    for axis in np.argsort(frame.axes[2]):  # those that point away first
        along = np.array([frame.axes[0, axis], -frame.axes[1, axis]])
        tip, size = middle + arm * along, float(np.hypot(*along))
        pen.line([*(np.array([middle] * 2) * _FINE), *(tip * _FINE)], fill=AXES[axis], width=round(line * _FINE))
        if size > 0.15:  # else it points at the viewer, or away
            back, across = along / size * head, np.array([-along[1], along[0]]) / size * head / 2.2
            corners = [tip + back / 3, tip - back + across, tip - back - across]
            pen.polygon([tuple(corner * _FINE) for corner in corners], fill=AXES[axis])
        place = tip + (along / size if size > 0.15 else np.array([-0.7, 0.7])) * 1.3 * head
        letters = font(round(max(9.0, arm / 3) * _FINE))
        pen.text(tuple(place * _FINE), "xyz"[axis], fill=AXES[axis], font=letters, anchor="mm")
    patch = patch.resize((side, side), Image.Resampling.BOX)
    left, top = round(0.01 * width), height - side - round(0.01 * height)
    if canvas.mode == "RGBA":
        canvas.alpha_composite(patch, (left, top))
    else:
        canvas.paste(patch, (left, top), patch)


def folded_sections(folded: F64, mean: float, expected: float) -> U8:
    """Three sections (height, width, 3) of two by two cells, with the cells' borders and a scale around the mean.

    From left to right the plane of the faces z = 0, with corners, edges and faces; the plane z = 1/2, with edges, faces
    and the center; and the diagonal plane x = y, with all of them. `folded` (nx, ny, nz) is the solid share of each
    voxel of the mean cell, `mean` that of the assembly; its color is the middle of the scale, which ends at zero and at
    twice the mean. `expected` is the standard deviation that the mean of independent cells would have, stated above.
    """
    n = folded.shape
    here, half = (0, n[2] - 1), ((n[2] - 1) // 2, n[2] // 2)
    along, up = np.arange(n[0]), np.arange(n[2])
    diagonal = folded[along[:, None], (along * n[1] // n[0])[:, None], up[None, :]]
    sections = [folded[:, :, here].mean(2), folded[:, :, half].mean(2), diagonal]
    high = 2 * mean if mean > 0 else 1.0
    pictures = [_two_by_two(section, high) for section in sections]
    labels = ["z = 0: corners, edges, faces", "z = 1/2: edges, faces, center", "x = y: all of them"]
    title = f"solid share, mean {mean:.3f}, deviation {folded.std():.3f}; of independent cells {expected:.3f}"
    return with_scale(contact_sheet(pictures, labels, columns=3, title=title), 0.0, high, "solid share", 120)


def _two_by_two(section: F64, high: float) -> U8:
    """The section from -1/2 to 3/2 in both directions, the second one upward, with lines on the cells' borders."""
    (width, height), size = section.shape, _SECTION
    place = (np.arange(size) + 0.5) / size * 2 + 0.5  # in cells, positive
    x, y = (np.floor(place * n).astype(int) % n for n in (width, height))
    values = section[x[None, :], y[::-1, None]]
    picture = colors_of(values.ravel(), 0.0, high).reshape(size, size, 3)
    for border in (size // 4, 3 * size // 4):  # dashed, so that what lies below is seen
        dashes = np.arange(size) % 12 < 4
        picture[border, dashes] = picture[dashes, border] = _LINE
    return picture
