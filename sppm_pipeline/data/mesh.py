"""Triangle meshes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.data.artifact import Artifact, frozen


@dataclass(frozen=True, eq=False)
class SurfaceMesh(Artifact):
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
        object.__setattr__(self, "vertices", frozen(_rows_of_three(np.asarray(self.vertices, np.float64))))
        object.__setattr__(self, "faces", frozen(_rows_of_three(np.asarray(self.faces, np.int32))))

    def check(self) -> None:
        """Finite vertices, indices in range."""
        if not np.isfinite(self.vertices).all():
            raise ValueError("mesh vertices must be finite")
        # a negative index is a large one when its sign is not looked at
        if len(self.faces) and int(self.faces.view(np.uint32).max()) >= len(self.vertices):
            raise ValueError("a triangle names a vertex that does not exist")

    @cached_property
    def bounds_solid(self) -> bool:
        """Whether the triangles bound a volume; if not, what is inside is a matter of votes."""
        from sppm_pipeline.numerics.meshcheck.measures import edge_counts

        return edge_counts(self.faces).bounds_solid

    @cached_property
    def _bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        from sppm_pipeline.numerics.meshcheck.measures import bounds

        return bounds(self.vertices, self.faces)

    @property
    def lower(self) -> NDArray[np.float64]:
        """Low corner of the bounding box of the triangles, (3,) mm."""
        return self._bounds[0]

    @property
    def upper(self) -> NDArray[np.float64]:
        """High corner of the bounding box of the triangles, (3,) mm."""
        return self._bounds[1]

    def summary(self) -> dict[str, Any]:
        """Counts, box and signed volume."""
        if not len(self.faces):
            return {"name": self.name, "vertices": len(self.vertices), "triangles": 0}
        from sppm_pipeline.numerics.meshcheck.measures import volume

        return {
            "name": self.name,
            "vertices": len(self.vertices),
            "triangles": len(self.faces),
            "size_mm": [float(v) for v in self.upper - self.lower],
            "volume_mm3": volume(self.vertices, self.faces),
        }


def _rows_of_three(array: NDArray[Any]) -> NDArray[Any]:
    """(n, 3); an array that has the shape already stays the same object, so that a large one is not copied."""
    return array if array.ndim == 2 and array.shape[1] == 3 else array.reshape(-1, 3)
