"""What goes wrong when a block of cells is printed upwards along z, on its voxels: one voxel is a pixel and a layer."""

from __future__ import annotations

import numpy as np
from scipy import ndimage


def islands(solid):
    """Pieces of layers that begin in air, (number, pixels); pixels touch at edges, and the first layer is held."""
    number = pixels = 0
    for below, layer in zip(solid.transpose(2, 0, 1)[:-1], solid.transpose(2, 0, 1)[1:], strict=True):
        labels, count = ndimage.label(layer)
        held = np.zeros(count + 1, bool)
        held[labels[below]] = True
        held[0] = True
        areas = np.bincount(labels.ravel(), minlength=count + 1)[~held]
        number, pixels = number + len(areas), pixels + int(areas.sum())
    return number, pixels


def overhang(solid):
    """Share of the solid above the first layer with no solid below it, nor below its four neighbors."""
    cross = ndimage.generate_binary_structure(2, 1)[:, :, None]
    reach = ndimage.binary_dilation(solid[:, :, :-1], cross)
    above = solid[:, :, 1:]
    return float((above & ~reach).sum() / max(above.sum(), 1))


def trapped(solid):
    """Share of the void from which resin can't flow out of the block; voxels of void touch at faces."""
    labels, _ = ndimage.label(np.pad(~solid, 1, constant_values=True))
    inside = labels[1:-1, 1:-1, 1:-1]
    return float(((inside > 0) & (inside != labels[0, 0, 0])).sum() / max((~solid).sum(), 1))


def check(cells, inputs, truth):
    """Means over the draws; the best there is, and what a printer wants, is 0 of each."""
    blocks = [np.tile(cell, [truth["cells"]] * 3) for cell in cells]
    found = [islands(block) for block in blocks]
    return {
        "islands a cell": float(np.mean([number for number, _ in found])) / truth["cells"] ** 3,
        "their share of solid": float(np.mean([n / b.sum() for (_, n), b in zip(found, blocks, strict=True)])),
        "overhang": float(np.mean([overhang(block) for block in blocks])),
        "trapped share of void": float(np.mean([trapped(block) for block in blocks])),
    }
