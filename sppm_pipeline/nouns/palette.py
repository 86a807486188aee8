"""The number of interiors and face colors that a recipe draws together, and what scattered pores may follow."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.nouns.artifact import Artifact


class Maps(Artifact):
    """Base of artifacts by which scattered pores vary from place to place; `tile.scattered` takes them without
    importing the feature that makes them.

    `scattered_by` names, as ``module:function``, what scatters pores as the maps say, imported when it is needed: a
    function of the context, the maps and a `families.tiler.Scattering`. It returns the tiling, or None if no map
    changes what is scattered.
    """

    scattered_by: ClassVar[str]


class KeptPores:
    """Pores of scattered blocks that are there already, handed over to the sampler that adds more to them.

    There may be millions: the caller drops them once they are handed over, so that they are held only once.

    Parameters
    ----------
    centers : (n, 3) float64
        In block edges, from the low corner of their block.
    piece : (n,) int32
        Interior of each, ascending.
    """

    def __init__(self, centers: NDArray[np.float64], piece: NDArray[np.int32]) -> None:
        self._pores: list[tuple[NDArray[np.float64], NDArray[np.int32]]] = [(centers, piece)]

    def handed_over(self) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
        """Centers and interiors, once."""
        return self._pores.pop()


@dataclass(frozen=True, eq=False)
class Blocks:
    """A lattice of blocks without faces, whose pores are thrown and joined across them (`tile.scattered`).

    Attributes
    ----------
    mask : (nx, ny, nz) bool
        Blocks that hold pores; interior t is the t-th of them in C order of (x, y, z).
    periodic : bool
        Whether the lattice repeats.
    density : (m nx + 1, m ny + 1, m nz + 1) float64 or None
        Pores per volume over what the recipe's samplers state, at m nodes along the edge of a block; spacings go with
        its power -1/3, which is linear between nodes. None for 1 everywhere.
    kept : KeptPores or None
        Pores that are there already: samplers then only add `added`.
    added : (interiors,) int64 or None
        Pores that are thrown beside those kept.
    """

    mask: NDArray[np.bool_]
    periodic: bool
    density: NDArray[np.float64] | None = None
    kept: KeptPores | None = None
    added: NDArray[np.int64] | None = None

    @property
    def metric(self) -> NDArray[np.float64] | None:
        """Metrics at the nodes of `density`, (..., 6), if pores are stretched: see `StretchedBlocks`."""
        return None

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of blocks along x, y, z."""
        nx, ny, nz = self.mask.shape
        return nx, ny, nz

    @property
    def sites(self) -> NDArray[np.int64]:
        """Place of each interior in the lattice, (interiors, 3)."""
        return np.argwhere(self.mask)

    @property
    def numbers(self) -> NDArray[np.int32]:
        """Interior of each block, (nx, ny, nz); -1 = none."""
        # cumsum counts in C order, which is that of `sites`
        return np.where(self.mask, np.cumsum(self.mask).reshape(self.mask.shape) - 1, -1).astype(np.int32)


@dataclass(frozen=True, eq=False)
class StretchedBlocks(Blocks):
    """Blocks whose pores are stretched.

    Attributes
    ----------
    metric : (m nx + 1, m ny + 1, m nz + 1, 6) float64
        Metrics, at the nodes of `density`, in which distances of pores are measured; see `numerics.metric`.
    """

    metric: NDArray[np.float64] | None = None


@dataclass(frozen=True, eq=False)
class Palette:
    """The interiors and face patterns that samplers and connectors have to supply.

    A single periodic cell asks for one interior and one color. Interior t may meet any color on each of its six
    sides, unless `meetings` lists the combinations that occur.

    Attributes
    ----------
    interiors : int
        K, the number of interiors.
    colors : tuple of 3 ints
        The number of face patterns perpendicular to x, y, z.
    meetings : (p, 4) int64 or None
        Rows (interior, axis, side, color); side 0 is the low face. None: all combinations.
    blocks : Blocks or None
        Where the interiors lie, if they are blocks of a lattice without faces; there are no colors then.
    totals : (interiors,) int64 or None
        Pores of the cell of each interior, faces and interior, in place of the samplers' own `total` or `count`.
    draws : (interiors,) int64 or None
        Which draw of each interior is wanted: others than the first, 0, are drawn from generators of their own.
    spacings : (interiors,) float64 or None
        Factors of the spacing in each interior.
    face_totals : tuple of 3 int64 arrays (colors,), or None
        For each axis and color the `total` of a cell that has as many pores on its faces as this pattern.
    """

    interiors: int = 1
    colors: tuple[int, int, int] = (1, 1, 1)
    meetings: NDArray[np.int64] | None = None
    blocks: Blocks | None = None
    totals: NDArray[np.int64] | None = None
    draws: NDArray[np.int64] | None = None
    spacings: NDArray[np.float64] | None = None
    face_totals: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]] | None = None

    def key(self, interior: int) -> tuple[int, ...]:
        """Key of the generator of an interior's pores, beside the run's seed and the stage."""
        draw = 0 if self.draws is None else int(self.draws[interior])
        return (interior, draw) if draw else (interior,)

    def all_meetings(self) -> NDArray[np.int64]:
        """The rows of `meetings`, written out, (p, 4) int64."""
        if self.meetings is not None:
            return self.meetings
        rows = [
            np.stack(
                np.meshgrid(np.arange(self.interiors), [axis], [0, 1], np.arange(self.colors[axis]), indexing="ij"), -1
            )
            for axis in range(3)
        ]
        return np.concatenate([r.reshape(-1, 4) for r in rows]).astype(np.int64)
