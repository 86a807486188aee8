"""Sections through the mean cell of an assembly: what repeats from cell to cell, at one glance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.pictures.sheets import colors_of, contact_sheet, with_scale

_SECTION = 300  # pixels along a section of two cells
_LINE = (200, 60, 60)


def folded_sections(folded: NDArray[np.float64], mean: float, expected: float) -> NDArray[np.uint8]:
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


def _two_by_two(section: NDArray[np.float64], high: float) -> NDArray[np.uint8]:
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
