"""The inside test: which voxels and cells are inside a part, for meshes that close and for those that do not."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sppm_pipeline.method.part.ray_crossings import Scan, prepare_scan
from sppm_pipeline.method.part.scanline import Occupancy, ThreeAxisScan, prepare_three_axis, scan_layers, vote_layers
from sppm_pipeline.method.part.spanned import SpannedScan, prepare_spanned, spanned_layers
from sppm_pipeline.services.arrays import F64, I32, Bools
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.mesh.measures import balanced_edges, bounds
from sppm_pipeline.services.mesh.orientation import orient

Method = Literal["scanline", "winding", "vote"]
"""The method of the inside test: rays along x, the generalized winding number, or rays along all three axes."""

PROBED = 48
"""Samples along the longest side of the box on which a mesh is tested."""


class InsideTest(NamedTuple):
    """The result of `inside_test`."""

    faces: I32  # (m, 3), wound outwards
    turned: int  # triangles that were turned
    method: Method
    closed: bool  # they bound a solid; then nothing is undecided
    undecided_share: float  # voxels about which the method is not sure, over those inside; at most 1
    disagreement: float  # voxels that winding number and vote see differently, over those that one of them calls inside


def way_for(closed: bool) -> Method:
    """The method of choice for a mesh, according to whether it bounds a solid (`EdgeCounts.bounds_solid`)."""
    return "scanline" if closed else "winding"


def inside_test(vertices: F64, faces: I32, method: Method | None = None) -> InsideTest:
    """Wind a mesh outwards, choose its inside test unless given, and estimate on a coarse grid how reliable that is."""
    wound = orient(vertices, faces)
    closed = balanced_edges(wound.faces)
    chosen = method or way_for(closed)
    if closed:
        return InsideTest(wound.faces, wound.turned, chosen, True, 0.0, 0.0)
    low, high = bounds(vertices, wound.faces)
    # an open mesh: how far do three methods agree on a coarse grid
    h = float((high - low).max()) / PROBED
    nx, ny, nz = (int(v) for v in np.ceil((high - low) / h) + 1)
    x, y, z = ((low + high - (np.array([nx, ny, nz]) - 1) * h) / 2).tolist()
    grid = Grid((x, y, z), (h, h, h), (nx, ny, nz))
    ways: tuple[Method, ...] = ("winding", "vote", "scanline")
    found = {
        way: inside_layers(prepare_inside(vertices, wound.faces, grid, way), 0, nz)
        for way in ways
        if way != "scanline" or way == chosen
    }
    inside = max(1, int(found[chosen].mask.sum()))
    doubt = found[chosen].undecided
    if chosen == "scanline":  # rays along x alone decide every voxel: where the others differ is doubt
        doubt = int(np.count_nonzero(found[chosen].mask != found["winding"].mask))
    one, other = found["winding"].mask, found["vote"].mask
    either = max(1, int(np.count_nonzero(one | other)))
    apart = int(np.count_nonzero(one != other))
    return InsideTest(wound.faces, wound.turned, chosen, False, min(1.0, doubt / inside), apart / either)


def prepare_inside(
    vertices: ArrayLike, faces: ArrayLike, grid: Grid, method: Method = "scanline"
) -> Scan | SpannedScan | ThreeAxisScan:
    """Sort the triangles of a mesh, wound outwards, for `inside_layers`; "scanline" is for those that bound a solid."""
    if method == "scanline":
        return prepare_scan(vertices, faces, grid)
    if method == "winding":
        return prepare_spanned(vertices, faces, grid)
    return prepare_three_axis(vertices, faces, grid)


def inside_layers(scan: Scan | SpannedScan | ThreeAxisScan, start: int, stop: int) -> Occupancy:
    """The occupancy of layers start <= k < stop, the same bit for bit however the part is cut into slabs.

    The vote looks at all triangles for every slab, so its slabs should not be thin.
    """
    if isinstance(scan, ThreeAxisScan):
        return vote_layers(scan, start, stop)
    return spanned_layers(scan, start, stop) if isinstance(scan, SpannedScan) else scan_layers(scan, start, stop)


def cells_touched(
    vertices: ArrayLike, faces: ArrayLike, origin: F64, edge: float, shape: tuple[int, int, int], closed: bool = True
) -> Bools:
    """Cells (nx, ny, nz) that contain a piece of the part: those met by a triangle, and those inside.

    Of a triangle no larger than two cells, those met by its box: some may be listed in vain, and none is left out. A
    mesh that bounds a solid (`closed`, see `EdgeCounts.bounds_solid`) is wound outwards; others are turned first.
    """
    points = np.ascontiguousarray(vertices, np.float64)
    if not closed:
        faces = orient(points, np.asarray(faces, np.int32)).faces
    # a cell that no triangle touches lies wholly inside or outside, so its center decides; but where a mesh is open,
    # the border of the inside runs through cells without a triangle
    n = 1 if closed else 4
    (nx, ny, nz), h = (n * s for s in shape), edge / n
    x, y, z = (float(o) + h / 2 for o in origin)
    samples = Grid((x, y, z), (h, h, h), (nx, ny, nz))
    found = inside_layers(prepare_inside(points, faces, samples, way_for(closed)), 0, nz).mask.transpose(2, 1, 0)
    inside = found.reshape(shape[0], n, shape[1], n, shape[2], n).any(axis=(1, 3, 5))
    touched = np.zeros(shape, np.bool_)
    _touch(points[np.asarray(faces, np.int64)], np.asarray(origin, np.float64), edge, touched)
    touched |= inside
    return touched


@jit
def _touch(triangles: F64, origin: F64, edge: float, touched: Bools) -> None:
    low, high, middle = np.empty(3, np.int64), np.empty(3, np.int64), np.empty(3)
    for f in range(triangles.shape[0]):
        large = False
        for a in range(3):
            least = min(triangles[f, 0, a], triangles[f, 1, a], triangles[f, 2, a])
            most = max(triangles[f, 0, a], triangles[f, 1, a], triangles[f, 2, a])
            low[a] = min(max(np.int64(np.floor((least - origin[a]) / edge)), 0), touched.shape[a] - 1)
            high[a] = min(max(np.int64(np.floor((most - origin[a]) / edge)), 0), touched.shape[a] - 1)
            # the box of a small triangle wastes a cell or two; that of a large one would fill the part
            large |= high[a] - low[a] > 1
        for i in range(low[0], high[0] + 1):
            for j in range(low[1], high[1] + 1):
                for k in range(low[2], high[2] + 1):
                    middle[0] = origin[0] + (i + 0.5) * edge
                    middle[1] = origin[1] + (j + 0.5) * edge
                    middle[2] = origin[2] + (k + 0.5) * edge
                    if not touched[i, j, k] and (not large or _meets(triangles[f], middle, 0.5 * edge)):
                        touched[i, j, k] = True


@jit
def _meets(triangle: F64, middle: F64, half: float) -> bool:
    """Test a triangle against a cube that its box meets, by separating axes (Akenine-Moeller 2001); in doubt they meet.

    The axes are the normal of the triangle, and the products of its edges with those of the cube.
    """
    room = half * (1.0 + 1e-9) + 1e-15 * (abs(middle[0]) + abs(middle[1]) + abs(middle[2]))
    for e in range(3):
        g = (e + 1) % 3
        for a in range(3):  # along a x edge: (0, -d_c, d_b) in the plane of the axes b and c
            b, c = (a + 1) % 3, (a + 2) % 3
            along_b = -(triangle[g, c] - triangle[e, c])
            along_c = triangle[g, b] - triangle[e, b]
            # both ends of the edge are at one place along it
            one = along_b * (triangle[e, b] - middle[b]) + along_c * (triangle[e, c] - middle[c])
            h = (e + 2) % 3
            two = along_b * (triangle[h, b] - middle[b]) + along_c * (triangle[h, c] - middle[c])
            if max(-max(one, two), min(one, two)) > room * (abs(along_b) + abs(along_c)):
                return False
    reach, height, rounding = 0.0, 0.0, 0.0
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        one = (triangle[1, b] - triangle[0, b]) * (triangle[2, c] - triangle[0, c])
        two = (triangle[1, c] - triangle[0, c]) * (triangle[2, b] - triangle[0, b])
        reach += abs(one - two)
        height += (one - two) * (triangle[0, a] - middle[a])
        rounding += (abs(one) + abs(two)) * abs(triangle[0, a] - middle[a])
    # of corners that lie in a line nothing but rounding is left in the normal, which points anywhere
    return bool(abs(height) <= room * reach + 1e-15 * rounding)
