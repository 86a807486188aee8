"""Which voxels are inside a mesh with holes: where its generalized winding number is above one half.

The number is not computed for every voxel. The open edges are spanned by triangles to the middle of each loop, however
badly these fit. Together with them the mesh is closed, so that signed scanlines count exactly how often it goes around
a voxel, and the winding number of the mesh alone is that count less the winding number of the spanning triangles. There
are few of these, and from some way off they are seen under less than half of everything: there the count decides, and
that is nearly everywhere. Only in the blocks that are left, near the holes, voxels are looked at one by one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sppm_pipeline.method.part.ray_crossings import Scan, as_mesh, prepare_scan
from sppm_pipeline.method.part.scanline import Occupancy, scan_layers
from sppm_pipeline.services.arrays import F64, I32, I64, U8
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.mesh.box_tree import DEPTH, box_tree
from sppm_pipeline.services.mesh.measures import components
from sppm_pipeline.services.mesh.winding_number import FAR_RADII, Dipoles, dipoles, winding_at
from sppm_pipeline.services.nearest import squared_to_triangle

UNDECIDED = 0.25
"""A voxel is undecided if its winding number is nearer than this to one half."""

_CALM = 0.2  # bounds below this are not looked into
_QUICK = 1.5  # radii beyond which dipoles are taken at first; their sum is then right to 0.15
_CLEAR = 0.35  # numbers of spanning triangles below this leave the count alone: a half, less the error
_CLOSE = 0.2  # numbers of the mesh nearer than this to one half are computed again, better
_LARGE, _SMALL = 32, 4  # edges of blocks, in voxels
_OFF = (0.00131, -0.00173, 0.00097)  # keeps spanning triangles out of the planes that voxels and boundary loops share


class SpannedScan(NamedTuple):
    """A mesh made ready for `spanned_layers`."""

    scan: Scan  # of the mesh and the triangles that span its holes
    mesh: Dipoles
    spans: Dipoles | None  # None if there are no holes
    areas: F64  # area of the spanning triangles below each node
    grid: Grid


def spanning_triangles(vertices: F64, faces: NDArray[np.integer]) -> tuple[F64, I32]:
    """Triangles that make a mesh closed: from each edge that is left over to the middle of its boundary loop.

    An edge is left over as often as it runs more in one direction than in the other. At every vertex as many of them
    arrive as leave, so whatever loops they make, triangles to any common point cancel each other's sides. The inside
    does not depend on the point; it is a little off the middle, as a hole often lies in a plane of voxels. Returned are
    the vertices, with such a point for each boundary loop (one for loops that touch), and the triangles (k, 3).
    """
    triangles = np.asarray(faces, np.int64)
    ends = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2)
    ends = ends[ends[:, 0] != ends[:, 1]]
    n = len(vertices)
    keys, which = np.unique(ends.min(1) * n + ends.max(1), return_inverse=True)
    # an edge of a closed mesh runs as often forward as backward
    excess = np.bincount(which, np.where(ends[:, 0] < ends[:, 1], 1, -1), len(keys)).astype(np.int64)
    left = np.repeat(keys, np.abs(excess))
    if left.size == 0:
        return vertices, np.empty((0, 3), np.int32)
    forward = np.repeat(excess > 0, np.abs(excess))
    low, high = left // n, left % n
    start, end = np.where(forward, low, high), np.where(forward, high, low)
    count, loop = components(np.stack([start, end, end], axis=1))
    weights = np.bincount(loop, minlength=count)[:, None]
    middles = np.stack([np.bincount(loop, vertices[start, a], count) for a in range(3)], axis=1) / weights
    sizes = np.sqrt(np.bincount(loop, np.square(vertices[start] - middles[loop]).sum(axis=1), count))
    # relative to the size of the hole
    middles += np.multiply.outer(sizes, _OFF)
    spans = np.stack([end, start, n + loop], axis=1)
    return np.concatenate([vertices, middles]), spans.astype(np.int32)


def prepare_spanned(vertices: ArrayLike, faces: ArrayLike, grid: Grid) -> SpannedScan:
    """Span the holes of a mesh, and sort its triangles; see `prepare_scan`."""
    points, triangles = as_mesh(vertices, faces)
    more, spans = spanning_triangles(points, triangles)
    scan = prepare_scan(more, np.concatenate([triangles, spans]), grid)
    mesh = dipoles(box_tree(points[triangles]))
    if not len(spans):
        return SpannedScan(scan, mesh, None, np.empty(0), grid)
    tree = box_tree(more[spans])
    return SpannedScan(scan, mesh, dipoles(tree), _node_areas(tree.triangles, tree.starts), grid)


def spanned_layers(scan: SpannedScan, start: int, stop: int) -> Occupancy:
    """The occupancy of layers start <= k < stop, the same bit for bit however the part is cut into slabs."""
    found = scan_layers(scan.scan, start, stop)
    if scan.spans is None:
        return found
    undecided = _correct(
        scan.mesh.triangles,
        scan.mesh.boxes,
        scan.mesh.starts,
        scan.mesh.poles,
        scan.spans.triangles,
        scan.spans.boxes,
        scan.spans.starts,
        scan.spans.poles,
        scan.areas,
        np.array(scan.grid.origin),
        np.array(scan.grid.spacing),
        start,
        found.mask,
    )
    return found._replace(undecided=int(undecided))


@jit
def _node_areas(triangles: F64, starts: I64) -> F64:
    leaves = starts.size - 1
    areas = np.zeros(2 * leaves - 1)
    # from the leaves up: the children of a node come after it
    for node in range(2 * leaves - 2, -1, -1):
        if node < leaves - 1:
            areas[node] = areas[2 * node + 1] + areas[2 * node + 2]
            continue
        for i in range(starts[node - leaves + 1], starts[node - leaves + 2]):
            t = triangles[i]
            ux, uy, uz = t[1, 0] - t[0, 0], t[1, 1] - t[0, 1], t[1, 2] - t[0, 2]
            vx, vy, vz = t[2, 0] - t[0, 0], t[2, 1] - t[0, 1], t[2, 2] - t[0, 2]
            nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
            areas[node] += np.sqrt(nx * nx + ny * ny + nz * nz) / 2
    return areas


@jit
def _seen_under(boxes: F64, areas: F64, waiting: I64, low: F64, high: F64) -> float:
    """A bound of the winding number of triangles at all points of a box."""
    leaves = (areas.size + 1) // 2
    bound = 0.0
    waiting[0] = 0
    left = 1
    while left > 0:
        left -= 1
        node = waiting[left]
        if areas[node] == 0.0:
            continue
        box = boxes[node]
        square, extent = 0.0, 0.0
        for a in range(3):
            gap = max(box[a] - high[a], low[a] - box[a + 3], 0.0)
            square += gap * gap
            extent += (box[a + 3] - box[a]) ** 2
        if node < leaves - 1 and square < 4.0 * extent:
            waiting[left], waiting[left + 1] = 2 * node + 2, 2 * node + 1
            left += 2
            continue
        # the box touches triangles: no useful bound
        if square == 0.0:
            return 1.0
        # the solid angle of an area at a distance is at most area / distance^2, of 4 pi
        bound += areas[node] / (4 * np.pi * square)
    return bound


@jit
def _within(triangles: F64, boxes: F64, starts: I64, waiting: I64, point: F64, limit: float) -> bool:
    """Test whether a triangle lies nearer to a point than a distance, given squared."""
    leaves = starts.size - 1
    waiting[0] = 0
    left = 1
    while left > 0:
        left -= 1
        node = waiting[left]
        square = 0.0
        for a in range(3):
            gap = max(boxes[node, a] - point[a], point[a] - boxes[node, a + 3], 0.0)
            square += gap * gap
        if square >= limit:
            continue
        if node < leaves - 1:
            waiting[left], waiting[left + 1] = 2 * node + 2, 2 * node + 1
            left += 2
            continue
        for i in range(starts[node - leaves + 1], starts[node - leaves + 2]):
            if squared_to_triangle(triangles[i], point[0], point[1], point[2]) < limit:
                return True
    return False


@jit
def _range(triangles: F64, starts: I64, poles: F64, waiting: I64, low: F64, high: F64) -> tuple[float, float, float]:
    """Least and largest winding number at the corners and in the middle of a box, and that in the middle.

    Half a diagonal off all triangles the number is smooth (it solves Laplace's equation), so that these tell how far
    it may go in between.
    """
    least, most, middle = np.inf, -np.inf, 0.0
    for corner in range(9):
        x = (low[0] + high[0]) / 2 if corner == 8 else (high[0] if corner & 1 else low[0])
        y = (low[1] + high[1]) / 2 if corner == 8 else (high[1] if corner & 2 else low[1])
        z = (low[2] + high[2]) / 2 if corner == 8 else (high[2] if corner & 4 else low[2])
        middle = winding_at(triangles, starts, poles, waiting, x, y, z, _QUICK)
        least, most = min(least, middle), max(most, middle)
    return least, most, middle


@jit
def _correct(
    triangles: F64,
    mesh_boxes: F64,
    starts: I64,
    poles: F64,
    spans: F64,
    span_boxes: F64,
    span_starts: I64,
    span_poles: F64,
    areas: F64,
    origin: F64,
    spacing: F64,
    start: int,
    mask: U8,
) -> int:
    """Decide the voxels near spanning triangles by the winding number of the mesh; how many remain undecided.

    Blocks are counted from the first layer of the part, so that slabs do not change what they are.
    """
    nz, ny, nx = mask.shape
    waiting = np.empty(DEPTH, np.int64)
    low, high, center = np.empty(3), np.empty(3), np.empty(3)
    blocks = np.empty((8 * 4, 4), np.int64)  # an edge is halved three times
    first = start // _LARGE * _LARGE
    undecided = 0
    across = (ny + _LARGE - 1) // _LARGE * ((nx + _LARGE - 1) // _LARGE)
    for top in range((start + nz - first + _LARGE - 1) // _LARGE * across):
        blocks[0, 0] = top % across % ((nx + _LARGE - 1) // _LARGE) * _LARGE
        blocks[0, 1] = top % across // ((nx + _LARGE - 1) // _LARGE) * _LARGE
        blocks[0, 2] = first + top // across * _LARGE
        blocks[0, 3] = _LARGE
        left = 1
        while left > 0:
            left -= 1
            edge = blocks[left, 3]
            i0, j0, k0 = blocks[left, 0], blocks[left, 1], blocks[left, 2]
            if i0 >= nx or j0 >= ny or k0 >= start + nz or k0 + edge <= start:
                continue
            for a in range(3):
                low[a] = origin[a] + blocks[left, a] * spacing[a]
                high[a] = origin[a] + (blocks[left, a] + edge - 1) * spacing[a]
            if _seen_under(span_boxes, areas, waiting, low, high) < _CALM:
                continue
            i1, j1, k1 = min(i0 + edge, nx), min(j0 + edge, ny), min(k0 + edge, start + nz)
            size = 0.0
            for a in range(3):
                size += (high[a] - low[a]) ** 2
                center[a] = (low[a] + high[a]) / 2
            # a diagonal off from the middle is half a diagonal off from all the block
            if not _within(spans, span_boxes, span_starts, waiting, center, size):
                least, most, middle = _range(spans, span_starts, span_poles, waiting, low, high)
                if max(most, -least) + (most - least) / 2 < _CLEAR:
                    if abs(middle) > UNDECIDED:
                        for k in range(max(k0, start), k1):
                            for j in range(j0, j1):
                                for i in range(i0, i1):
                                    undecided += (mask[k - start, j, i] > 0) == (middle > 0.0)
                    continue
            if not _within(triangles, mesh_boxes, starts, waiting, center, size):
                least, most, middle = _range(triangles, starts, poles, waiting, low, high)
                reach = (most - least) / 2
                if least - reach > 1 - _CLEAR or most + reach < _CLEAR:
                    inside = least > 0.5
                    for k in range(max(k0, start), k1):
                        for j in range(j0, j1):
                            for i in range(i0, i1):
                                mask[k - start, j, i] = inside
                    if abs(middle - 0.5) < UNDECIDED:
                        undecided += (i1 - i0) * (j1 - j0) * (k1 - max(k0, start))
                    continue
            # undecided as a whole: look at its eighths
            if edge > _SMALL:
                half = edge // 2
                for child in range(8):
                    blocks[left, 0] = i0 + half * (child & 1)
                    blocks[left, 1] = j0 + half * (child >> 1 & 1)
                    blocks[left, 2] = k0 + half * (child >> 2)
                    blocks[left, 3] = half
                    left += 1
                continue
            for k in range(max(k0, start), k1):
                z = origin[2] + k * spacing[2]
                for j in range(j0, j1):
                    y = origin[1] + j * spacing[1]
                    for i in range(i0, i1):
                        x = origin[0] + i * spacing[0]
                        number = winding_at(spans, span_starts, span_poles, waiting, x, y, z, _QUICK)
                        if abs(number) >= _CLEAR:
                            own = winding_at(triangles, starts, poles, waiting, x, y, z, _QUICK)
                            if abs(own - 0.5) < _CLOSE:
                                own = winding_at(triangles, starts, poles, waiting, x, y, z, FAR_RADII)
                            mask[k - start, j, i] = own > 0.5
                            undecided += abs(own - 0.5) < UNDECIDED
                        elif abs(number) > UNDECIDED:
                            # the number draws the count towards one half if it has the count's sign
                            undecided += (mask[k - start, j, i] > 0) == (number > 0.0)
    return undecided
