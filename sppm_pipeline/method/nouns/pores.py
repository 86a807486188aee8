"""Pores of a cell, or of all the interiors and colored faces of a tile set."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sppm_pipeline.errors import DesignError
from sppm_pipeline.nouns.artifact import Artifact, frozen, in_rows, twin_rows, whole_numbers
from sppm_pipeline.nouns.length import Cell, parse_length
from sppm_pipeline.nouns.palette import Blocks
from sppm_pipeline.services.arrays import F64, I32, I64, distinct

_ROUNDING = 1e-9
"""Distance, in cell sizes, that a pore may lie outside of its cell by rounding."""


@dataclass(frozen=True, eq=False)
class PoreSet(Artifact):
    """Pore centers, grouped by the piece of the cell they belong to.

    Pieces are numbered: interior t is piece t; the face pattern perpendicular to `axis` with color k is piece
    ``interiors + sum(colors[:axis]) + k``. A face pore is listed once, in the plane coordinate 0 of its axis; its
    twin on the opposite face is its image at coordinate 1 (paper, section 2.1, "Boundary Periodicity Regulation").
    Pores on an edge or a corner belong to one face pattern that touches it, in the low planes: they have two or three
    coordinates 0 and images at both ends of each of these.

    Attributes
    ----------
    cell : Cell
    centers : (n, 3) float64, cell sizes
    piece : (n,) int32
    interiors : int
    colors : tuple of 3 ints
        Number of face patterns perpendicular to x, y, z; zeros where no pores were put on faces.
    spacing : float or None
        Smallest distance the sampler kept between pores, cell sizes.
    blocks : Blocks or None
        Where the interiors lie, if they are blocks of a lattice without faces. Pores are then sorted by interior.
    """

    reported: ClassVar[tuple[str, ...]] = ("pores", "face_pores", "interiors", "colors.#3", "pores_per_cell", "spacing")

    cell: Cell
    centers: F64
    piece: I32
    interiors: int = 1
    colors: tuple[int, int, int] = (0, 0, 0)
    spacing: float | None = None
    blocks: Blocks | None = None

    def __post_init__(self) -> None:
        centers = in_rows(np.asarray(self.centers, np.float64), 3, "pore centers")
        # a view is copied, so that the caller's array stays writable
        object.__setattr__(self, "centers", frozen(centers.reshape(-1, 3)))
        object.__setattr__(self, "piece", frozen(whole_numbers(self.piece, np.int32, "the pieces of pores")))

    @classmethod
    def from_array(
        cls, centers: ArrayLike, *, edge: str | float | None = None, spacing: float | None = None
    ) -> PoreSet:
        """The pores of one cell, none of them on a face.

        Parameters
        ----------
        centers : (n, 3) array_like
            In millimeters, from 0 to the edge; without an edge in cell sizes, from 0 to 1.
        edge : str or float, optional
            Edge of the cell with a unit, for instance ``"7.5 mm"``, or in mm; without it the cell has no physical size.
        spacing : float, optional
            Smallest distance between the pores, cell sizes.

        Raises
        ------
        ValueError
            If a center is not finite or outside of the cell, or two are equal.

        Examples
        --------
        >>> import sppm_pipeline as sppm
        >>> pores = sppm.PoreSet.from_array([[0.5, 2, 2], [4, 2, 3]], edge="5 mm")
        >>> pores.centers.tolist()
        [[0.1, 0.4, 0.4], [0.8, 0.4, 0.6]]
        """
        points = in_rows(np.array(centers, np.float64), 3, "pore centers")
        cell = Cell() if edge is None else Cell(parse_length(edge).mm(), physical=True)
        if edge is not None:
            low, high = (points.min(), points.max()) if points.size else (0.0, 0.0)
            if not -_ROUNDING <= low / cell.edge <= high / cell.edge <= 1 + _ROUNDING and np.isfinite(points).all():
                raise ValueError(
                    f"pore centers lie in the cell, from 0 to {cell.edge:g} mm, got {low:g} to {high:g} mm"
                )
            points = points / cell.edge
        pores = cls(cell, points, np.zeros(len(points), np.int32), spacing=spacing)
        pores.check()
        return pores

    def check(self) -> None:
        """Shapes, range of the pieces, centers inside the cell and all different, faces lying in their planes."""
        if self.interiors < 1 or len(self.colors) != 3 or min(self.colors) < 0:
            raise ValueError(
                f"a cell has an interior and face colors of 3 axes, got {self.interiors} and {self.colors}"
            )
        if self.piece.shape != (len(self.centers),):
            raise ValueError(f"{len(self.centers)} pores but {self.piece.shape} piece numbers")
        if not np.isfinite(self.centers).all():
            raise ValueError("pore centers must be finite")
        if len(self.centers) and not -_ROUNDING <= self.centers.min() <= self.centers.max() <= 1 + _ROUNDING:
            raise ValueError(
                f"pore centers lie in the cell, from 0 to 1 (cell sizes), got {self.centers.min():g} to "
                f"{self.centers.max():g}"
            )
        if len(self.piece) and not 0 <= self.piece.min() <= self.piece.max() < self.interiors + sum(self.colors):
            raise ValueError("a pore belongs to a piece that does not exist")
        if self.blocks is not None and (self.has_faces or (np.diff(self.piece) < 0).any()):
            raise ValueError("pores of blocks are sorted by block, and none lies on a face")
        for axis in range(3):
            on_face = self.axis_of_piece()[self.piece] == axis
            # exactly 0: both cells at a face add the same kernel, bit for bit
            if on_face.any() and np.abs(self.centers[on_face, axis]).max() > 0:
                raise ValueError(f"face pores perpendicular to axis {axis} must have coordinate 0 there")
        # 0.0 is added as -0.0 has other bytes than 0.0
        twins = twin_rows(*(self.centers + 0.0).T, self.piece.astype(np.int64)) if len(self.centers) else None
        if twins is not None:
            first, second = twins
            x, y, z = self.centers[first]
            raise ValueError(
                f"pores {first} and {second} of piece {self.piece[first]} are one: both lie at ({x:g}, {y:g}, {z:g})"
            )

    def to_numpy(self) -> F64:
        """Centers of the pores, (n, 3) float64: in millimeters, or in cell sizes if the cell has no physical size."""
        return self.centers * (self.cell.edge if self.cell.physical else 1.0)

    @property
    def centers_mm(self) -> F64:
        """Centers of the pores, (n, 3) float64, mm.

        Raises
        ------
        DesignError
            If the cell has no physical size.
        """
        if not self.cell.physical:
            raise DesignError(
                "the cell has no physical size", hint='give the sampler `edge="5 mm"`, or ask for `to_numpy()`'
            )
        return self.to_numpy()

    @property
    def has_faces(self) -> bool:
        """True if there are pores on the faces of the cell."""
        return sum(self.colors) > 0

    def axis_of_piece(self) -> I64:
        """For each piece its face axis 0, 1, 2, or -1 for interiors."""
        return np.repeat([-1, 0, 1, 2], [self.interiors, *self.colors])

    def around_edges(self) -> F64:
        """Places of all pores on edges and corners, of all colors, at all edges and corners of the cell, (k, 3)."""
        lying = (self.piece >= self.interiors) & ((self.centers == 0).sum(1) > 1)
        low = distinct(self.centers[lying], axis=0)
        for axis in range(3):
            # one of a face is seen on the opposite face as well
            low = np.concatenate([low, low[low[:, axis] == 0] + np.eye(3)[axis]])
        return low

    def face_piece(self, axis: int, color: int) -> int:
        """Piece number of a face pattern."""
        return self.interiors + sum(self.colors[:axis]) + color

    def face_pieces(self, axes: NDArray[np.integer], colors: NDArray[np.integer]) -> I64:
        """Piece numbers of many face patterns, (p,) int64."""
        first = self.interiors + np.cumsum([0, *self.colors[:2]])
        pieces: I64 = first[axes] + colors
        return pieces

    def indices(self, piece: int) -> I64:
        """Indices of the pores of one piece."""
        order, start = self.by_piece
        return order[start[piece] : start[piece + 1]]

    def of_piece(self, piece: int) -> F64:
        """Centers of one piece, (k, 3)."""
        return self.centers[self.indices(piece)]

    @cached_property
    def by_piece(self) -> tuple[I64, I64]:
        """Pores in the order of their pieces, (n,) int64, and where each piece begins there, (pieces + 1,) int64."""
        count = np.bincount(self.piece, minlength=self.interiors + sum(self.colors))
        # stable, so that pores of a piece keep the order in which they were thrown
        return np.argsort(self.piece, kind="stable"), np.concatenate([[0], np.cumsum(count)])

    def extended(self, centers: F64, piece: I32, **changes: Any) -> PoreSet:
        """The same set with more pores."""
        values: dict[str, Any] = {
            "cell": self.cell, "interiors": self.interiors, "colors": self.colors, "spacing": self.spacing,
            "blocks": self.blocks,
        } | changes  # fmt: skip
        return PoreSet(
            centers=np.concatenate([self.centers, centers]), piece=np.concatenate([self.piece, piece]), **values
        )

    @property
    def per_cell(self) -> float:
        """Mean number of pores of one cell, each face counted once."""
        axis_of_pore = self.axis_of_piece()[self.piece]
        # a cell shows one pattern of each axis
        faces = sum(float((axis_of_pore == axis).sum()) / self.colors[axis] for axis in range(3) if self.colors[axis])
        return faces + float((axis_of_pore < 0).sum()) / self.interiors

    def summary(self) -> dict[str, Any]:
        """Counts; `pores_per_cell` is the mean number of pores of one cell, each face counted once."""
        on_face = self.piece >= self.interiors
        return {
            "pores": len(self.centers),
            "face_pores": int(on_face.sum()),
            "interiors": self.interiors,
            "colors": list(self.colors),
            "pores_per_cell": self.per_cell,
            "spacing": self.spacing,
        }
