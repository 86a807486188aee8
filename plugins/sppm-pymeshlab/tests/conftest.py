"""Small meshes, whole and broken."""

from __future__ import annotations

import numpy as np
import pytest

from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.part.primitive_meshes import ball_mesh, box_mesh


@pytest.fixture(scope="session")
def ball() -> SurfaceMesh:
    """1280 triangles, radius 5 mm."""
    return SurfaceMesh(*ball_mesh((0.0, 0.0, 0.0), 5.0, 3), name="ball")


@pytest.fixture(scope="session")
def boxes():
    """Make one mesh of several boxes, each a (center, size, inside out)."""

    def make(*parts: tuple[tuple[float, ...], tuple[float, ...], bool]) -> SurfaceMesh:
        vertices, faces, count = [], [], 0
        for center, size, turned in parts:
            v, f = box_mesh(center, size)
            vertices.append(v)
            faces.append((f[:, ::-1] if turned else f) + count)
            count += len(v)
        return SurfaceMesh(np.concatenate(vertices), np.concatenate(faces), "boxes")

    return make


@pytest.fixture(scope="session")
def soup() -> SurfaceMesh:
    """Triangles that have nothing to do with each other."""
    rng = np.random.default_rng(3)
    corners = rng.random((30, 1, 3)) * 10 + rng.random((30, 3, 3)) * 4
    return SurfaceMesh(corners.reshape(-1, 3), np.arange(90).reshape(-1, 3), "soup")
