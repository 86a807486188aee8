"""Pictures of deformed voxels: the same view of every frame, in colors of a value of each voxel."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics import VOXEL_FACES
from sppm_pipeline.pictures import Camera, render_mesh

UPRIGHT = {"z": (0, 1, 2), "x": (1, 2, 0), "y": (2, 0, 1)}
"""Axes in the order that puts the axis of compression on top."""


def exposed_triangles(
    voxels: NDArray[np.int32], grid: tuple[int, int, int], elements: NDArray[np.int32]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Triangles (n, 3) of the faces that no other voxel covers, normals outwards, and the voxel (n,) of each.

    `voxels` (m, 3) are places in the grid (nx, ny, nz), `elements` (m, 8) nodes at the corners, in the order of
    `VOXEL_FACES`.
    """
    solid = np.zeros(tuple(n + 2 for n in grid), bool)
    places = voxels.astype(np.int64) + 1
    solid[tuple(places.T)] = True
    triangles, owners = [], []
    for beyond, corners in VOXEL_FACES:
        bare = np.flatnonzero(~solid[tuple((places + beyond).T)])
        quads = elements[bare][:, corners].astype(np.int64)
        triangles += [quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]
        owners += [bare, bare]
    return np.concatenate(triangles), np.concatenate(owners)


def frame_pictures(
    voxels: NDArray[np.int32],
    grid: tuple[int, int, int],
    elements: NDArray[np.int32],
    frames: NDArray[np.float32],
    colors: Iterator[NDArray[np.uint8]],
    *,
    released: NDArray[np.bool_] | None = None,
    axis: str,
    camera: Camera,
    size: tuple[int, int],
    section: float | None,
) -> Iterator[NDArray[np.uint8]]:
    """A picture (height, width, 3) of each frame, all at one scale, the axis of compression upright.

    `frames` (f, p, 3) are positions of the nodes, `colors` those of the voxels (m, 3), frame by frame; `released`
    (f, m) says which voxels have failed and are not drawn, if any can. The camera is in the turned axes. `section` is
    the share of the undeformed block that is kept, along the second of the turned axes, the far side; a layer of voxels
    at least.
    """
    turned = list(UPRIGHT[axis])
    kept = np.ones(len(voxels), bool)
    if section is not None:
        along = voxels[:, turned[1]]
        kept = along >= min((1 - section) * grid[turned[1]] - 0.5, along.max())  # the farthest layer at least
    shown = [kept] * len(frames) if released is None or not len(released) else [kept & ~gone for gone in released]
    drawn: list[tuple[NDArray[Any], NDArray[Any], NDArray[Any]]] = []
    for number, here in enumerate(shown):
        if number and np.array_equal(here, shown[number - 1]):
            drawn.append(drawn[-1])
            continue
        triangles, owners = exposed_triangles(voxels[here], grid, elements[here])
        nodes, faces = np.unique(triangles, return_inverse=True)
        drawn.append((nodes, faces.reshape(triangles.shape), np.flatnonzero(here)[owners]))
    positions = [frame[nodes][:, turned].astype(np.float64) for frame, (nodes, _, _) in zip(frames, drawn, strict=True)]
    every = np.concatenate(positions)
    low, high = every.min(axis=0), every.max(axis=0)
    # the corners of a box around all frames belong to no triangle: they hold the view still
    corners = np.array([[(low, high)[(c >> a) & 1][a] for a in range(3)] for c in range(8)])
    for here, (_, faces, owners), color in zip(positions, drawn, colors, strict=True):
        points = np.concatenate([here, corners])
        yield render_mesh(points, faces, camera=camera, size=size, face_colors=color[owners])
