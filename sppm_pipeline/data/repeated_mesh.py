"""A triangle mesh and the places where copies of it stand."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.data.artifact import Artifact, frozen
from sppm_pipeline.data.mesh import SurfaceMesh


@dataclass(frozen=True, eq=False)
class RepeatedMesh(Artifact):
    """A mesh that stands at several places; copies may touch each other, each is closed by itself.

    Attributes
    ----------
    mesh : SurfaceMesh
    offsets : (k, 3) float64, mm
        Shifts of the copies.
    """

    mesh: SurfaceMesh
    offsets: NDArray[np.float64]

    def __post_init__(self) -> None:
        object.__setattr__(self, "offsets", frozen(np.asarray(self.offsets, np.float64).reshape(-1, 3)))

    def check(self) -> None:
        """A sound mesh, and finite places."""
        self.mesh.check()
        if not np.isfinite(self.offsets).all():
            raise ValueError("the places of copies must be finite")

    def whole(self) -> SurfaceMesh:
        """One mesh of all copies; surfaces at which copies touch stay within it."""
        n, m = len(self.mesh.vertices), len(self.mesh.faces)
        copies = len(self.offsets)
        vertices = (self.offsets[:, None] + self.mesh.vertices[None]).reshape(copies * n, 3)
        faces = (n * np.arange(copies, dtype=np.int64)[:, None, None] + self.mesh.faces).reshape(copies * m, 3)
        return SurfaceMesh(vertices, faces.astype(np.int32), name=self.mesh.name)

    def summary(self) -> dict[str, Any]:
        """The mesh's numbers and the number of copies."""
        return {"copies": len(self.offsets), "mesh": self.mesh.summary()}
