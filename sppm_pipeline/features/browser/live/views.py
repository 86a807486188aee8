"""View files of all that can be shown live; surfaces with coordinates of 16 bits, and of large ones fewer triangles."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import DesignError
from sppm_pipeline.features.browser.live.page import encode_view
from sppm_pipeline.nouns.artifact import Artifact, Viewable
from sppm_pipeline.nouns.viewers import viewer_of
from sppm_pipeline.services.arrays import F64, I64

SAMPLES = 3_500_000
"""Samples of a field that is not summed in the browser; packed they take one to two megabytes."""

TRIANGLES = 80_000
"""Maximum number of triangles for the browser, about 2 MB in a report of at most 5 MB."""

STEPS = 65535
"""Steps of a coordinate along the longest edge of the box."""


def view_of(what: Artifact, *, samples: int = SAMPLES, threads: int = 1) -> bytes:
    """The view file of an artifact: by the viewer of its type, with at most so many samples of a field, as far as it
    fills its box; else of the surface that stands for it. `DesignError` if nothing is there to be shown.
    """
    viewer = viewer_of(type(what))
    if viewer is not None:
        return bytes(viewer.maker("view")(what, samples, threads))
    if not isinstance(what, Viewable):
        raise DesignError(f"a {type(what).__name__} has no live view")
    surface = what.live_view()
    if not len(surface.faces):
        raise DesignError(f"the {surface.title} has no triangles, so that there is nothing to be shown")
    return mesh_view(*surface, most=TRIANGLES * min(samples, SAMPLES) // SAMPLES)


def mesh_view(
    vertices: NDArray[np.floating[Any]], faces: NDArray[np.integer[Any]], title: str, unit: str,
    still: NDArray[np.floating[Any]] | None = None, magnified: float = 1.0, *, most: int = TRIANGLES,
) -> bytes:  # fmt: skip
    """The view file of a mesh, vertices (n, 3) and at least one of faces (m, 3).

    `unit` says of what its coordinates are: "mm", or what the modulus surface of a stiffness has. Of over `most`
    triangles, vertices in small cubes are merged, and triangles that vanish are left out. With `still` (n, 3), where
    the vertices were before they moved, these are merged as the others are, and the view has a slider between both.
    """
    from sppm_pipeline.services.mesh.measures import balanced_edges

    used, corners = np.unique(faces, return_inverse=True)
    points, triangles = np.asarray(vertices, float)[used], corners.reshape(-1, 3)
    if still is not None:
        points = np.concatenate([points, np.asarray(still, float)[used]], axis=1)
    # 16 bits along the longest edge resolve more than a screen does
    box = points.reshape(-1, 3)
    low, size = box.min(0), np.ptp(box, axis=0)
    kept, shown = clustered(points, triangles, most)
    longest = float(size.max()) or 1.0
    steps = np.rint((kept.reshape(len(kept), -1, 3) - low) / longest * STEPS).astype(np.uint16)
    head = {
        "kind": "mesh", "title": title, "unit": unit, "edge_mm": None, "periodic": False, "explore": None,
        "triangles": len(faces), "shown": len(shown), "closed": balanced_edges(shown),
        "size": size.tolist(), "origin": low.tolist(), "level": 0.0, "base": 0.0, "top": 1.0, "porosity": None,
        "magnified": None if still is None else magnified,
    }  # fmt: skip
    arrays = {"vertices": steps[:, 0].T, "faces": shown.astype(np.uint32).T}
    return encode_view(head, arrays if still is None else arrays | {"still": steps[:, 1].T})


def clustered(points: F64, faces: NDArray[np.integer[Any]], most: int) -> tuple[F64, I64]:
    """Vertices (n, 3 or more) and triangles, at most `most` of them, as the vertices in cubes of a grid are merged into
    their mean.

    The grid is that of the first three columns, and the finest of those tried, each coarser by 15 %; vertices are
    sorted by cubes, triangles by vertices.
    Method: vertex clustering (Rossignac and Borrel 1993).
    """
    first = points[:, :3]
    low, longest = first.min(0), float(np.ptp(first, axis=0).max()) or 1.0
    cells = 2048.0 if len(faces) <= most else 2.0 * most**0.5
    while True:
        n = max(1, int(cells))
        cube = np.minimum((first - low) * (n / longest), n - 1).astype(np.int64)
        key = (cube[:, 2] * n + cube[:, 1]) * n + cube[:, 0]
        if len(faces) <= most:
            key = key * len(points) + np.arange(len(points))  # none are merged, and neighbors still stand together
        _, group, count = np.unique(key, return_inverse=True, return_counts=True)
        corners = group[faces]
        a, b, c = corners.T
        corners = corners[(a != b) & (b != c) & (c != a)]
        # each begins at its lowest vertex, which keeps its side
        corners = np.take_along_axis(corners, (corners.argmin(1)[:, None] + np.arange(3)) % 3, 1)
        if len(corners) <= most:
            break
        cells /= 1.15
    mean = np.stack([np.bincount(group, points[:, axis]) / count for axis in range(points.shape[1])], 1)
    return mean, corners[np.lexsort(corners.T[::-1])]
