"""Tetrahedral meshes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sppm_pipeline.nouns.artifact import Surface, Viewable, frozen, optional_module


@dataclass(frozen=True, eq=False)
class VolumeMesh(Viewable):
    """A mesh of tetrahedra with positive volume, straight (4 nodes) or quadratic (10 nodes).

    Attributes
    ----------
    nodes : (n, 3) float64, mm
    cells : (m, 4) or (m, 10) int32
        The first four nodes are the corners, the fourth on the side of the first three that their normal by the right
        hand points to; the mid-edge nodes follow in the order 01, 12, 02, 03, 13, 23.
    box : (2, 3) float64, mm, or None
        Low and high corner of the periodic cell that the mesh fills, if it is one.
    matched : bool
        Whether nodes on opposite faces of the box are copies of each other, shifted by its edge, so that the mesh
        repeats without a seam.
    materials : (m,) uint8
        Index of the material of each cell, from 1.
    name : str
        What a person would call it, for messages.
    """

    reported: ClassVar[tuple[str, ...]] = ("nodes", "cells", "order", "volume_mm3", "matched", "porosity")

    nodes: NDArray[np.float64]
    cells: NDArray[np.int32]
    box: NDArray[np.float64] | None = None
    matched: bool = False
    materials: NDArray[np.uint8] | None = None
    name: str = "volume mesh"

    def __post_init__(self) -> None:
        cells = np.asarray(self.cells, np.int32)
        object.__setattr__(self, "nodes", frozen(np.asarray(self.nodes, np.float64)))
        object.__setattr__(self, "cells", frozen(cells))
        if self.box is not None:
            object.__setattr__(self, "box", frozen(np.asarray(self.box, np.float64)))
        materials = np.ones(len(cells), np.uint8) if self.materials is None else self.materials
        object.__setattr__(self, "materials", frozen(np.asarray(materials, np.uint8)))

    @classmethod
    def from_arrays(cls, nodes: ArrayLike, cells: ArrayLike, **details: Any) -> VolumeMesh:
        """A mesh of nodes (n, 3), mm, and tetrahedra (m, 4) or (m, 10); `details` are further fields.

        Raises
        ------
        ValueError
            If shapes do not fit or an index is out of range.
        """
        mesh = cls(np.array(nodes, np.float64), np.array(cells, np.int32), **details)
        mesh.check()
        return mesh

    def to_pyvista(self) -> Any:
        """A `pyvista.UnstructuredGrid`.

        Raises
        ------
        ResourceError
            If pyvista is not installed.
        """
        straight = self.cells.shape[1] == 4
        kind = 10 if straight else 24  # VTK_TETRA, VTK_QUADRATIC_TETRA
        grid = optional_module("pyvista").UnstructuredGrid({kind: self.cells}, self.nodes)
        grid.cell_data["material"] = self.material_of_cells
        return grid

    def check(self) -> None:
        """Shapes that fit each other, finite nodes, indices in range."""
        if self.nodes.ndim != 2 or self.nodes.shape[1] != 3 or not np.isfinite(self.nodes).all():
            raise ValueError("nodes must be finite points in space")
        if self.cells.ndim != 2 or self.cells.shape[1] not in (4, 10):
            raise ValueError(f"cells need 4 or 10 nodes, got shape {self.cells.shape}")
        if len(self.cells) and int(self.cells.view(np.uint32).max()) >= len(self.nodes):
            raise ValueError("a cell names a node that does not exist")
        if self.box is not None and not (self.box.shape == (2, 3) and (self.box[1] > self.box[0]).all()):
            raise ValueError("the box needs a low and a high corner")
        if self.matched and self.box is None:
            raise ValueError("a mesh without a box has no opposite faces")
        if self.materials is None or self.materials.shape != (len(self.cells),):
            raise ValueError("each cell needs a material")

    @property
    def volume(self) -> float:
        """Sum over the cells, as if their edges were straight, mm^3."""
        a, b, c, d = (self.nodes[self.cells[:, corner]] for corner in range(4))
        return float(np.einsum("ij,ij->", np.cross(b - a, c - a), d - a)) / 6

    @property
    def material_of_cells(self) -> NDArray[np.uint8]:
        """`materials`, which are always there once the mesh is made."""
        assert self.materials is not None
        return self.materials

    @property
    def around(self) -> NDArray[np.float64]:
        """The box, or else the bounding box of the nodes, (2, 3) mm."""
        return self.box if self.box is not None else np.array([self.nodes.min(axis=0), self.nodes.max(axis=0)])

    def live_view(self) -> Surface:
        """The triangles of its boundary."""
        from sppm_pipeline.services.mesh.faces import boundary_triangles, face_neighbors

        faces = boundary_triangles(self.cells, face_neighbors(self.cells))
        return Surface(self.nodes, faces, f"surface of the {self.name}", "mm")

    def summary(self) -> dict[str, Any]:
        """Nodes, cells, volume, and for a periodic cell its porosity."""
        summary: dict[str, Any] = {
            "nodes": len(self.nodes), "cells": len(self.cells), "order": 1 if self.cells.shape[1] == 4 else 2,
            "volume_mm3": self.volume, "matched": self.matched,
        }  # fmt: skip
        if self.box is not None:
            summary["porosity"] = 1 - self.volume / float(np.prod(self.box[1] - self.box[0]))
        return summary
