"""Blocks of whole voxels: how a field becomes one, how it is turned, what of it carries nothing, and its frames."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import ScalarField

if TYPE_CHECKING:
    from sppm_pipeline.features.crushing.numerics.march import March

PERMUTED = {"x": (2, 0, 1), "y": (1, 2, 0), "z": (0, 1, 2)}
"""Axes of an image z, y, x in the order that turns the axis of compression into the first."""


class Frame(NamedTuple):
    """Strain, positions of the nodes, plastic strain of the elements and which of them have failed."""

    strain: float
    nodes: NDArray[np.float32]
    alpha: NDArray[np.float32]
    released: NDArray[np.bool_]


def frame_of(march: March) -> Frame:
    """The march as it is now."""
    return Frame(march.strain, march.x.astype(np.float32), march.plastic_strain.astype(np.float32), march.released)


def turned_corner(column: int, axis: int) -> int:
    """The corner of a turned voxel that is at the upper end along x, y, z where bits 0, 1, 2 of `column` are set."""
    low = [1 - (column >> c & 1) for c in range(3)]
    x, y, z = low if axis == 2 else (low[1], low[2], low[0]) if axis == 0 else (low[2], low[0], low[1])
    return x + 2 * y + 4 * z


def binary_image(field: ScalarField, resolution: int, threads: int) -> NDArray[np.uint8]:
    """Whole voxels of a field, (nz, ny, nx), cut at the level at which they have the density of a finer grid."""
    values = field.sample(resolution, threads).T
    density = float(field.solid(2 * resolution, threads).mean(dtype=np.float64))
    count = round(density * values.size)
    if not count:
        return np.zeros(values.shape, np.uint8)
    # voxels of one value go together, so that symmetry stays
    most = np.partition(values.reshape(-1), count - 1)[count - 1]
    with_them, without = values <= most, values < most
    fewer = count - np.count_nonzero(without) < np.count_nonzero(with_them) - count
    return np.asarray(without if fewer and without.any() else with_them).view(np.uint8)


def loose_pieces(image: NDArray[np.uint8]) -> list[str]:
    """Warnings for solid that carries nothing."""
    from sppm_pipeline.numerics import find_components

    found = find_components((image > 0).view(np.uint8), (False,) * 3, 6)
    spanning = found.faces[:, 4] & found.faces[:, 5]
    if not spanning.any():
        return ["no load path between the plates: the force is zero until pieces meet"]
    loose = float(found.sizes[~spanning].sum() / found.sizes.sum())
    return [f"{loose:.2g} of the solid is not connected to the load path between the plates"] if loose else []
