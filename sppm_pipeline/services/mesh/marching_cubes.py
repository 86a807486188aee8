"""Marching cubes (Lorensen and Cline, 1987) with consistent faces, over a whole field or slab by slab.

The signs of the samples are packed 64 to a word. Words show which cubes the surface passes; the numbers of the
vertices follow from running counts along the eight rows of edges of a row of cubes, as in flying edges (Schroeder,
Maynard and Geveci, 2015), so that no table from edges to vertices is kept.

Promised, for every field, noise and special values included:

* inside the box each directed edge of the mesh occurs once, and once in the opposite direction (a closed, oriented
  2-manifold); edges without a partner lie on the border of the box, and on none of it if the border is void;
* one vertex per edge of the grid that the surface crosses; no vertex without a triangle;
* no triangle without area: a sample equal to the level counts as void, and a vertex keeps `EDGE_MARGIN` of a grid edge
  away from both of its ends. A vertex is thereby at most that far from where linear interpolation puts it;
* the same bytes however the field is cut into slabs.

Not promised: that the surface inside one cube joins as the trilinear interpolant does. Solid samples that touch along
the diagonal of a face or of a cube are always separated.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

import numpy as np

from sppm_pipeline.errors import ResourceError
from sppm_pipeline.services.arrays import F32, F64, I32, I64, U8, U64
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.mesh.marching_tables import case_tables
from sppm_pipeline.services.mesh.sign_words import (
    ONE,
    cells_mask,
    lowest,
    mixed_cells,
    pack_signs,
    shifted_word,
    slab_counts,
)

Mesh = tuple[F64, I32]

#: Least distance of a vertex from the ends of its grid edge, as a fraction of that edge.
EDGE_MARGIN = 2.0**-10


@jit
def _share(a: float, b: float, level: float) -> float:
    """Place of the level between two samples, kept off both ends; NaN (an infinite sample) falls to the first."""
    t = (level - np.float64(a)) / (np.float64(b) - np.float64(a))
    if not t > EDGE_MARGIN:
        return EDGE_MARGIN
    return min(t, 1.0 - EDGE_MARGIN)


@jit
def _emit_plane(
    plane: F32,
    words: U64,
    z: float,
    level: float,
    frame: F64,
    n: int,
    start: int,
    base_x: I64,
    base_y: I64,
    vertices: F64,
) -> int:
    """Vertices on the edges along x and y of one plane; base_x and base_y get each row's first vertex."""
    ny, nx = plane.shape
    for j in range(ny):
        y = frame[1] + frame[4] * j
        base_x[j] = start + n
        for w in range(words.shape[1]):
            bits = (words[j, w] ^ shifted_word(words, j, w)) & cells_mask(w, nx)
            while bits != 0:
                i = 64 * w + lowest(bits)
                bits &= bits - ONE
                vertices[n, 0] = frame[0] + frame[3] * (i + _share(plane[j, i], plane[j, i + 1], level))
                vertices[n, 1] = y
                vertices[n, 2] = z
                n += 1
        base_y[j] = start + n
        if j + 1 == ny:
            break
        for w in range(words.shape[1]):
            bits = words[j, w] ^ words[j + 1, w]
            while bits != 0:
                i = 64 * w + lowest(bits)
                bits &= bits - ONE
                vertices[n, 0] = frame[0] + frame[3] * i
                vertices[n, 1] = frame[1] + frame[4] * (j + _share(plane[j, i], plane[j + 1, i], level))
                vertices[n, 2] = z
                n += 1
    return n


@jit
def _emit_pillars(
    low: F32,
    high: F32,
    words_low: U64,
    words_high: U64,
    k: int,
    level: float,
    frame: F64,
    n: int,
    start: int,
    base_z: I64,
    vertices: F64,
) -> int:
    """Vertices on the edges along z between planes k and k + 1."""
    for j in range(low.shape[0]):
        y = frame[1] + frame[4] * j
        base_z[j] = start + n
        for w in range(words_low.shape[1]):
            bits = words_low[j, w] ^ words_high[j, w]
            while bits != 0:
                i = 64 * w + lowest(bits)
                bits &= bits - ONE
                vertices[n, 0] = frame[0] + frame[3] * i
                vertices[n, 1] = y
                vertices[n, 2] = frame[2] + frame[5] * (k + _share(low[j, i], high[j, i], level))
                n += 1
    return n


@jit
def _emit_faces(low: U64, high: U64, nx: int, base: I64, counts: U8, table: U8, m: int, faces: I32) -> int:
    """Triangles of the cubes between two planes.

    The rows of `base` hold the first vertex of each row on: x edges below, y edges below, x edges above, y edges
    above, z edges.
    """
    ids = np.empty(12, np.int64)
    for j in range(low.shape[0] - 1):
        x0, x1, x2, x3 = base[0, j], base[0, j + 1], base[2, j], base[2, j + 1]
        y0, y1 = base[1, j], base[3, j]
        z0, z1 = base[4, j], base[4, j + 1]
        for w in range(low.shape[1]):
            bits = mixed_cells(low, high, j, w, nx)
            if bits == 0:
                continue
            s0, s1, s2, s3 = low[j, w], low[j + 1, w], high[j, w], high[j + 1, w]
            n0, n1, n2, n3 = (
                shifted_word(low, j, w),
                shifted_word(low, j + 1, w),
                shifted_word(high, j, w),
                shifted_word(high, j + 1, w),
            )
            while bits != 0:
                k = np.uint64(lowest(bits))
                bits &= bits - ONE
                a, b = np.int64((s0 >> k) & ONE), np.int64((n0 >> k) & ONE)
                c, d = np.int64((s1 >> k) & ONE), np.int64((n1 >> k) & ONE)
                e, f = np.int64((s2 >> k) & ONE), np.int64((n2 >> k) & ONE)
                g, h = np.int64((s3 >> k) & ONE), np.int64((n3 >> k) & ONE)
                case = a | b << 1 | c << 2 | d << 3 | e << 4 | f << 5 | g << 6 | h << 7
                ids[0], ids[1], ids[2], ids[3] = x0, x1, x2, x3
                ids[4], ids[6], ids[8], ids[10] = y0, y1, z0, z1
                x0 += a ^ b
                x1 += c ^ d
                x2 += e ^ f
                x3 += g ^ h
                y0 += a ^ c
                y1 += e ^ g
                z0 += a ^ e
                z1 += c ^ g
                ids[5], ids[7], ids[9], ids[11] = y0, y1, z0, z1
                for t in range(counts[case]):
                    faces[m, 0] = ids[table[case, 3 * t]]
                    faces[m, 1] = ids[table[case, 3 * t + 1]]
                    faces[m, 2] = ids[table[case, 3 * t + 2]]
                    m += 1
    return m


@jit
def _emit(
    carry: F32,
    slab: F32,
    words: U64,
    first: bool,
    k0: int,
    level: float,
    frame: F64,
    counts: U8,
    table: U8,
    start: int,
    base: I64,
    vertices: F64,
    faces: I32,
) -> tuple[int, int]:
    """Fill the vertices and faces of a slab; words[0] and `carry` are the plane before it, k0 its first plane's number.

    Vertices are numbered from `start`; `base` keeps the row starts of the last plane for the slab that follows.
    """
    nx = slab.shape[2]
    n = int(np.int64(0))  # for a literal 0 the kernels below would be compiled once more
    m = int(np.int64(0))
    for p in range(slab.shape[0]):
        k = k0 + p
        z = frame[2] + frame[5] * k
        if first and p == 0:
            n = _emit_plane(slab[p], words[1], z, level, frame, n, start, base[2], base[3], vertices)
            continue
        low = carry if p == 0 else slab[p - 1]
        for j in range(base.shape[1]):
            base[0, j] = base[2, j]
            base[1, j] = base[3, j]
        n = _emit_pillars(low, slab[p], words[p], words[p + 1], k - 1, level, frame, n, start, base[4], vertices)
        n = _emit_plane(slab[p], words[p + 1], z, level, frame, n, start, base[2], base[3], vertices)
        m = _emit_faces(words[p], words[p + 1], nx, base, counts, table, m, faces)
    return n, m


def marching_cubes(
    field: F32,
    level: float = 0.0,
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
    spacing: tuple[float, float, float] = (1.0, 1.0, 1.0),
) -> Mesh:
    """Surface between the solid (below the level) and the void (at or above it) of a sampled field.

    Parameters
    ----------
    field : (nz, ny, nx) float32
        Samples; at least two along each axis. Other types are converted. NaN counts as void.
    level : float
        Value on the surface; rounded to float32.
    origin, spacing : 3 floats, x, y, z
        Position of the first sample and distance between samples, in the unit that the vertices shall have.

    Returns
    -------
    vertices : (n, 3) float64
        x, y, z, layer after layer.
    faces : (m, 3) int32
        Counter-clockwise for a viewer in the void: normals point to larger values.

    Raises
    ------
    ValueError
        If the field is not three-dimensional or has fewer than two samples along an axis.
    ResourceError
        If the surface has more than 2^31 - 1 vertices.
    """
    if np.ndim(field) != 3 or min(np.shape(field)) < 2:
        raise ValueError(f"marching cubes need at least 2 x 2 x 2 samples, not an array of shape {np.shape(field)}")
    return next(marching_cubes_slabs([field], level, origin, spacing))


def marching_cubes_slabs(
    slabs: Iterable[F32],
    level: float = 0.0,
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
    spacing: tuple[float, float, float] = (1.0, 1.0, 1.0),
) -> Iterator[Mesh]:
    """`marching_cubes` of a field that arrives as consecutive slabs of planes, one piece of the mesh for each slab.

    Slabs (k, ny, nx) come in the order of z, without overlap; k may vary, ny and nx (at least 2) may not. One may be
    overwritten once the next piece is asked for. A piece is its new vertices (n, 3), whose numbers follow those of the
    pieces before, and the faces (m, 3) between this slab's planes and the plane before them, in vertex numbers of the
    whole mesh. The pieces, concatenated, are what `marching_cubes` makes of the whole field.
    """
    tables = case_tables()
    frame = np.array([*origin, *spacing], np.float64)
    if frame.shape != (6,) or not np.isfinite(frame).all() or not (frame[3:] > 0).all():
        raise ValueError(f"origin and spacing are three finite numbers each, the spacing positive: {origin}, {spacing}")
    level32 = np.float32(level)
    carry = np.empty((0, 0), np.float32)
    base = np.empty((5, 0), np.int64)
    words_before = np.empty((0, 0), np.uint64)
    planes, start = 0, 0
    for given in slabs:
        slab = np.ascontiguousarray(given, np.float32)
        first = planes == 0
        if first and slab.ndim == 3:
            if min(slab.shape[1:]) < 2:
                raise ValueError(f"a slab has at least 2 x 2 samples a plane, not the shape {slab.shape}")
            carry = np.empty(slab.shape[1:], np.float32)
            words_before = np.zeros((slab.shape[1], -(-slab.shape[2] // 64)), np.uint64)
            base = np.zeros((5, slab.shape[1]), np.int64)
        if slab.ndim != 3 or slab.shape[1:] != carry.shape:
            raise ValueError(f"slabs of (k, {carry.shape[0]}, {carry.shape[1]}) samples expected, got {slab.shape}")
        if slab.shape[0] == 0:
            yield np.empty((0, 3)), np.empty((0, 3), np.int32)
            continue
        words = np.empty((slab.shape[0] + 1, *words_before.shape), np.uint64)
        words[0] = words_before
        pack_signs(slab, level32, words[1:])
        n_vertices, n_faces = slab_counts(words[1:] if first else words, slab.shape[2], first)
        if start + n_vertices > np.iinfo(np.int32).max:
            raise ResourceError(
                f"the surface has more than {np.iinfo(np.int32).max} vertices",
                hint="sample the field more coarsely, or extract the part in pieces",
            )
        vertices = np.empty((n_vertices, 3))
        faces = np.empty((n_faces, 3), np.int32)
        n, m = _emit(
            carry, slab, words, first, planes, float(level32), frame, *tables, start, base, vertices, faces
        )  # fmt: skip
        carry[:], words_before = slab[-1], words[-1]
        start += n
        planes += slab.shape[0]
        yield vertices, faces[:m]


def joined_mesh(pieces: Iterable[Mesh], expected: Callable[[], tuple[int, int]] = lambda: (0, 0)) -> Mesh:
    """Mesh whose vertices and faces come in pieces; the faces name vertices by their number in the whole mesh.

    A list of pieces, concatenated at the end, would need the memory of two meshes. `expected` is asked for about how
    many vertices and faces there will be when the first piece is there. Memory that is reserved at once is mapped in
    large pages and so filled in less time; what is too little grows, what is too much is given back untouched.
    """
    vertices, faces = np.empty((0, 3)), np.empty((0, 3), np.int32)
    n, m = 0, 0
    for more_vertices, more_faces in pieces:
        if n == m == 0:
            room = expected()
            vertices, faces = np.empty((room[0], 3)), np.empty((room[1], 3), np.int32)
        n, m = n + len(more_vertices), m + len(more_faces)
        # no other reference exists yet, whatever a debugger or a profiler counts
        if n > len(vertices):
            vertices.resize((n, 3), refcheck=False)
        if m > len(faces):
            faces.resize((m, 3), refcheck=False)
        vertices[n - len(more_vertices) : n], faces[m - len(more_faces) : m] = more_vertices, more_faces
    vertices.resize((n, 3), refcheck=False)
    faces.resize((m, 3), refcheck=False)
    return vertices, faces
