"""Triangle meshes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.data.noun import Noun, frozen

__all__ = ["SurfaceMesh"]


@dataclass(frozen=True, eq=False)
class SurfaceMesh(Noun):
    """An indexed triangle mesh; faces are oriented so that their normals point out of the solid.

    Attributes
    ----------
    vertices : (n, 3) float64, mm
    faces : (m, 3) int32
    name : str
        What a person would call it, for messages.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    name: str = "mesh"

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices", frozen(np.asarray(self.vertices, np.float64).reshape(-1, 3)))
        object.__setattr__(self, "faces", frozen(np.asarray(self.faces, np.int32).reshape(-1, 3)))

    def check(self) -> None:
        """Finite vertices, indices in range."""
        if not np.isfinite(self.vertices).all():
            raise ValueError("mesh vertices must be finite")
        if len(self.faces) and not 0 <= self.faces.min() <= self.faces.max() < len(self.vertices):
            raise ValueError("a triangle names a vertex that does not exist")

    @cached_property
    def bounds_solid(self) -> bool:
        """Whether the triangles bound a volume; if not, what is inside is a matter of votes."""
        from sppm_pipeline.numerics.surface.measures import edge_counts

        return edge_counts(self.faces).bounds_solid

    @property
    def lower(self) -> NDArray[np.float64]:
        """Low corner of the bounding box of the triangles, (3,) mm."""
        return self.vertices[self.faces].reshape(-1, 3).min(0)  # type: ignore[no-any-return]

    @property
    def upper(self) -> NDArray[np.float64]:
        """High corner of the bounding box of the triangles, (3,) mm."""
        return self.vertices[self.faces].reshape(-1, 3).max(0)  # type: ignore[no-any-return]

    def summary(self) -> dict[str, Any]:
        """Counts, box and signed volume."""
        if not len(self.faces):
            return {"name": self.name, "vertices": len(self.vertices), "triangles": 0}
        p = self.vertices[self.faces] - self.vertices.mean(0)
        volume = float(np.einsum("ij,ij->", p[:, 0], np.cross(p[:, 1], p[:, 2])) / 6)
        return {
            "name": self.name,
            "vertices": len(self.vertices),
            "triangles": len(self.faces),
            "size_mm": [float(v) for v in self.upper - self.lower],
            "volume_mm3": volume,
        }
