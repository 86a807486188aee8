"""What cells are put together from: interiors, colored faces, and connectors between the two."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from sppm_pipeline.numerics.kernels.kernels import Kernels


@dataclass(frozen=True, eq=False)
class Pieces:
    """Kernel sets from which every cell of a tiling is put together; all lengths in cell edges.

    Attributes
    ----------
    interiors : tuple of K Kernels
        Pores and tunnels inside a cell, relative to its low corner.
    faces : tuple of 3 tuples of c Kernels
        ``faces[axis][color]``: pores and tunnels in the plane ``coordinate[axis] = 0``, relative to the low corner of
        the cell on the high side of the plane.
    connectors : mapping of (interior, axis, side, color) to Kernels
        Tunnels that join interior `interior` to the face of that color on its low (side 0) or high (side 1) side,
        relative to the low corner of the cell; those of side 1 end in the plane ``coordinate[axis] = 1``. Absent means
        none.
    """

    interiors: tuple[Kernels, ...]
    faces: tuple[tuple[Kernels, ...], tuple[Kernels, ...], tuple[Kernels, ...]]
    connectors: Mapping[tuple[int, int, int, int], Kernels]

    @property
    def colors(self) -> int:
        """Number of face colors, c."""
        return len(self.faces[0])

    @property
    def squared(self) -> bool:
        """Whether the tunnels take the squared distance; one form holds for all pieces."""
        for kernels in (*self.interiors, *(face for axis in self.faces for face in axis)):
            return kernels.squared
        return False
