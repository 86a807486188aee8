"""Which voxels are inside a part: one way for meshes that close, another for those that almost do."""

from __future__ import annotations

from numpy.typing import ArrayLike

from sppm_pipeline.numerics.domain.scanline import Occupancy, Scan, prepare_scan, scan_layers
from sppm_pipeline.numerics.domain.three_axis import ThreeAxisScan, prepare_three_axis, vote_layers
from sppm_pipeline.numerics.grid import Grid

__all__ = ["inside_layers", "prepare_inside"]


def prepare_inside(vertices: ArrayLike, faces: ArrayLike, grid: Grid, closed: bool = True) -> Scan | ThreeAxisScan:
    """Sort the triangles of a mesh for `inside_layers`.

    Parameters
    ----------
    vertices : (n, 3) floats
        In the unit of the grid.
    faces : (m, 3) integers
        Wound outwards.
    grid : Grid
        The samples of the whole part.
    closed : bool
        Whether the mesh bounds a solid (`EdgeCounts.bounds_solid`); then rays along x decide, otherwise the vote of
        rays along all three axes.
    """
    return prepare_scan(vertices, faces, grid) if closed else prepare_three_axis(vertices, faces, grid)


def inside_layers(scan: Scan | ThreeAxisScan, start: int, stop: int) -> Occupancy:
    """The occupancy of layers start <= k < stop, the same bit for bit however the part is cut into slabs.

    The vote looks at all triangles for every slab, so its slabs should not be thin.
    """
    return vote_layers(scan, start, stop) if isinstance(scan, ThreeAxisScan) else scan_layers(scan, start, stop)
