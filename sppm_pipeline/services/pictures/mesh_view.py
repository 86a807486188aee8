"""Pictures of triangle meshes, by a z-buffer."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from sppm_pipeline.errors import DesignError
from sppm_pipeline.services.arrays import F32, F64, I32, I64, U8
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.pictures.camera import Camera, Frame, framed, projected
from sppm_pipeline.services.pictures.shading import (
    BONE,
    Background,
    Color,
    Seen,
    empty_seen,
    hidden_sky,
    lit,
    on_background,
)

# Corners at which a triangle and the mean of its neighbors differ by more are edges (of a cut, of a box), not noise.
_CREASE_COSINE = math.cos(math.radians(38.0))


@jit
def _nearest_triangles(places: F64, faces: I64, nearness: F32, owner: I32) -> None:
    """Write the nearest triangle at the center of each sample; the first of equally near ones stays."""
    height, width = nearness.shape
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ax, ay, an = places[a, 0], places[a, 1], places[a, 2]
        bx, by, bn = places[b, 0], places[b, 1], places[b, 2]
        cx, cy, cn = places[c, 0], places[c, 1], places[c, 2]
        # Samples are at half-integers: the first one inside the box of the triangle, and one beyond the last.
        first_column = max(math.ceil(min(ax, bx, cx) - 0.5), 0)
        last_column = min(math.floor(max(ax, bx, cx) - 0.5), width - 1)
        first_row = max(math.ceil(min(ay, by, cy) - 0.5), 0)
        last_row = min(math.floor(max(ay, by, cy) - 0.5), height - 1)
        if first_column > last_column or first_row > last_row:
            continue
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0.0:
            continue
        # Weights of corners b and c; each changes by a constant from sample to sample.
        b_step, b_row = (cy - ay) / area, -(cx - ax) / area
        c_step, c_row = -(by - ay) / area, (bx - ax) / area
        for r in range(first_row, last_row + 1):
            dx, dy = first_column + 0.5 - ax, r + 0.5 - ay
            wb = dx * b_step + dy * b_row
            wc = dx * c_step + dy * c_row
            for col in range(first_column, last_column + 1):
                if wb >= 0.0 and wc >= 0.0 and wb + wc <= 1.0:
                    near = np.float32(an + wb * (bn - an) + wc * (cn - an))
                    if near > nearness[r, col]:
                        nearness[r, col] = near
                        owner[r, col] = f
                wb += b_step
                wc += c_step


@jit
def vertex_normals(vertices: F64, faces: I64) -> F64:
    """Unit means of the normals of the triangles at each vertex.

    Weighted by the angle at the vertex (Thürmer and Wüthrich 1998, "Computing vertex normals from polygonal facets"),
    the mean doesn't depend on how a flat face is cut into triangles, so the corners of a box are recognized as such.
    """
    normals = np.zeros_like(vertices)
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ux, uy, uz = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
        vx, vy, vz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
        x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        size = math.sqrt(x * x + y * y + z * z)
        if size == 0.0:
            continue
        along = ux * vx + uy * vy + uz * vz
        at_a = math.atan2(size, along)
        at_b = math.atan2(size, ux * ux + uy * uy + uz * uz - along)
        for vertex, angle in ((a, at_a), (b, at_b), (c, math.pi - at_a - at_b)):
            normals[vertex, 0] += x * angle / size
            normals[vertex, 1] += y * angle / size
            normals[vertex, 2] += z * angle / size
    for n in range(normals.shape[0]):
        length = math.sqrt(normals[n, 0] ** 2 + normals[n, 1] ** 2 + normals[n, 2] ** 2)
        for axis in range(3):  # dividing the row would compile an array expression, for seconds
            normals[n, axis] /= max(length, 1e-300)
    return normals


@jit
def normal_on(
    vertices: F64, faces: I64, normals: F64, f: int, wb: float, wc: float, smooth: bool, flat: F64, mean: F64
) -> None:
    """Normal `flat` of triangle f, and `mean`, interpolated at the weights of its second and third corner.

    Corners where the surface has an edge have the normal of the triangle.
    """
    a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
    ux, uy, uz = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
    vx, vy, vz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
    flat[0], flat[1], flat[2] = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    length = math.sqrt(flat[0] ** 2 + flat[1] ** 2 + flat[2] ** 2)
    for axis in range(3):
        if length > 0.0:
            flat[axis] /= length
        mean[axis] = 0.0 if smooth else flat[axis]
    if not smooth:
        return
    for vertex, weight in ((a, 1.0 - wb - wc), (b, wb), (c, wc)):
        cosine = normals[vertex, 0] * flat[0] + normals[vertex, 1] * flat[1] + normals[vertex, 2] * flat[2]
        for axis in range(3):
            mean[axis] += weight * (normals[vertex, axis] if cosine > _CREASE_COSINE else flat[axis])
    length = math.sqrt(mean[0] ** 2 + mean[1] ** 2 + mean[2] ** 2)
    for axis in range(3):
        if length > 0.0:
            mean[axis] /= length


@jit
def _resolve(
    vertices: F64,
    faces: I64,
    normals: F64,
    smooth: bool,
    places: F64,
    axes: F64,
    distance: float,
    scale: float,
    colors: U8,
    nearness: F32,
    owner: I32,
    depth: F32,
    normal: F32,
    color: U8,
) -> None:
    """Depth, normal and color of the triangle that owns each sample."""
    height, width = owner.shape
    flat, mean = np.zeros(3), np.zeros(3)
    for r in range(height):
        for col in range(width):
            f = owner[r, col]
            if f < 0:
                continue
            a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
            ax, ay = places[a, 0], places[a, 1]
            bx, by = places[b, 0] - ax, places[b, 1] - ay
            cx, cy = places[c, 0] - ax, places[c, 1] - ay
            area = bx * cy - by * cx
            dx, dy = col + 0.5 - ax, r + 0.5 - ay
            normal_on(
                vertices, faces, normals, f, (dx * cy - dy * cx) / area, (dy * bx - dx * by) / area, smooth, flat, mean
            )
            facing = flat[0] * axes[2, 0] + flat[1] * axes[2, 1] + flat[2] * axes[2, 2]
            # The back of an open mesh, or of one turned inside out, is lit like its front.
            side = -1.0 if facing < 0.0 else 1.0
            for axis in range(3):
                along = mean[0] * axes[axis, 0] + mean[1] * axes[axis, 1] + mean[2] * axes[axis, 2]
                normal[r, col, axis] = side * along
                color[r, col, axis] = colors[f if colors.shape[0] > 1 else 0, axis]
            near = np.float64(nearness[r, col])
            depth[r, col] = scale * (near if distance == 0.0 else distance - 1.0 / near)


def _seen_mesh(vertices: F64, faces: I64, frame: Frame, size: tuple[int, int], smooth: bool, colors: U8) -> Seen:
    width, height = size
    vertices = vertices.view()
    vertices.flags.writeable = False  # of some meshes they are: one type, so that kernels are compiled once
    places = projected(frame, vertices)
    nearness = np.full((height, width), -np.inf, np.float32)
    owner = np.full((height, width), -1, np.int32)
    _nearest_triangles(places, faces, nearness, owner)
    seen = empty_seen(width, height)
    normals = vertex_normals(vertices, faces) if smooth else np.zeros((1, 3))
    _resolve(
        vertices,
        faces,
        normals,
        smooth,
        places,
        frame.axes,
        frame.distance,
        frame.scale,
        colors,
        nearness,
        owner,
        seen.depth,
        seen.normal,
        seen.color,
    )
    return seen


def render_mesh(
    vertices: ArrayLike,
    faces: ArrayLike,
    *,
    camera: Camera | None = None,
    size: tuple[int, int] = (1200, 900),
    smooth: bool = True,
    color: Color = BONE,
    face_colors: ArrayLike | None = None,
    supersampling: int = 2,
    occlusion: float = 1.0,
    background: Background = "light",
    margin: float = 0.04,
    threads: int = 1,
) -> U8:
    """Picture of a triangle mesh.

    Both sides of a triangle are seen and lit alike.

    Parameters
    ----------
    vertices : (n, 3) float
        Positions x, y, z, in any unit.
    faces : (m, 3) int
        Vertices of each triangle.
    camera : Camera, optional
        Direction of view; z is up.
    size : (width, height)
        Size of the picture in pixels.
    smooth : bool
        Whether normals are interpolated from the vertices; edges sharper than 38 degrees stay sharp. Otherwise every
        triangle is flat.
    color : (r, g, b)
        Color of the surface (sRGB).
    face_colors : (m, 3) uint8, optional
        Color of each triangle instead.
    supersampling : int
        Samples per pixel along each axis, 1..8.
    occlusion : float
        Strength of the darkening of pores and creases; 0 leaves it out.
    background : Background
        "light" or "dark", which are gradients, "transparent", or one color.
    margin : float
        Fraction of the picture left free on each side.
    threads : int

    Returns
    -------
    (height, width, 3) uint8
        The picture (sRGB); with a fourth channel, the opacity, if the background is transparent. A mesh without
        triangles gives the bare background.

    Raises
    ------
    DesignError
        If the camera, the size or the supersampling is out of bounds.
    ValueError
        If an array has another shape, a face names a vertex that isn't there, or a position isn't finite.
    """
    points = np.ascontiguousarray(vertices, np.float64)
    corners = np.ascontiguousarray(faces, np.int64)
    if points.ndim != 2 or points.shape[1:] != (3,) or corners.ndim != 2 or corners.shape[1:] != (3,):
        raise ValueError(f"vertices and faces must have shape (n, 3) and (m, 3), got {points.shape}, {corners.shape}")
    if corners.size and not (corners.min() >= 0 and corners.max() < len(points)):
        raise ValueError(f"a face names vertex {corners.max()}, but there are {len(points)} vertices")
    if not np.isfinite(points).all():
        raise ValueError("the position of a vertex is not finite")
    colors = np.array([color], np.uint8) if face_colors is None else np.ascontiguousarray(face_colors, np.uint8)
    if face_colors is not None and colors.shape != corners.shape:
        raise ValueError(f"face_colors must have shape {corners.shape}, got {colors.shape}")
    if not 1 <= supersampling <= 8:
        raise DesignError(f"supersampling is {supersampling}, allowed are 1 to 8")
    fine = (size[0] * supersampling, size[1] * supersampling)
    if not corners.size:
        return on_background(lit(empty_seen(*fine), None, 0.0, supersampling), background)
    used = points if len(points) < 3 * len(corners) else points[np.unique(corners)]
    frame = framed(camera or Camera(), used, fine, margin)
    seen = _seen_mesh(points, corners, frame, fine, smooth, colors)
    hidden = hidden_sky(seen, threads) if occlusion > 0.0 else None
    return on_background(lit(seen, hidden, occlusion, supersampling), background)
