"""Which voxels are inside a part: one way for meshes that close, two others for those that do not."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sppm_pipeline.numerics.domain.scanline import Occupancy, Scan, prepare_scan, scan_layers
from sppm_pipeline.numerics.domain.spanned import SpannedScan, prepare_spanned, spanned_layers
from sppm_pipeline.numerics.domain.three_axis import ThreeAxisScan, prepare_three_axis, vote_layers
from sppm_pipeline.numerics.grid import Grid
from sppm_pipeline.numerics.meshcheck.measures import bounds, edge_counts
from sppm_pipeline.numerics.meshcheck.orientation import orient

Method = Literal["scanline", "winding", "vote"]
"""How it is decided what is inside: rays along x, the generalized winding number, or rays along all three axes."""

PROBED = 48
"""Samples along the longest side of the box on which a mesh is judged."""


class Judgement(NamedTuple):
    """What `judge` makes of a mesh.

    Attributes
    ----------
    faces : (m, 3) int32
        The triangles, wound outwards.
    turned : int
        How many of them were turned.
    method : Method
    closed : bool
        Whether they bound a solid; then nothing is open to judgement.
    undecided_share : float
        Voxels about which the method is not sure, over those inside; at most 1.
    disagreement : float
        Voxels that winding number and vote see differently, over those that one of them calls inside.
    """

    faces: NDArray[np.int32]
    turned: int
    method: Method
    closed: bool
    undecided_share: float
    disagreement: float


def way_for(closed: bool) -> Method:
    """The method of choice for a mesh, according to whether it bounds a solid (`EdgeCounts.bounds_solid`)."""
    return "scanline" if closed else "winding"


def judge(vertices: NDArray[np.float64], faces: NDArray[np.int32], method: Method | None = None) -> Judgement:
    """Wind a mesh outwards, choose how its inside is told, and find out on a coarse grid how sure that is.

    Parameters
    ----------
    vertices : (n, 3) float64
    faces : (m, 3) int32
    method : Method, optional
        Instead of `way_for`.
    """
    wound = orient(vertices, faces)
    closed = edge_counts(wound.faces).bounds_solid
    chosen = method or way_for(closed)
    if closed:
        return Judgement(wound.faces, wound.turned, chosen, True, 0.0, 0.0)
    low, high = bounds(vertices, wound.faces)
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
    if chosen == "scanline":  # rays along x alone know no doubt: what the others see differently is one
        doubt = int(np.count_nonzero(found[chosen].mask != found["winding"].mask))
    one, other = found["winding"].mask, found["vote"].mask
    either = max(1, int(np.count_nonzero(one | other)))
    apart = int(np.count_nonzero(one != other))
    return Judgement(wound.faces, wound.turned, chosen, False, min(1.0, doubt / inside), apart / either)


def prepare_inside(
    vertices: ArrayLike, faces: ArrayLike, grid: Grid, method: Method = "scanline"
) -> Scan | SpannedScan | ThreeAxisScan:
    """Sort the triangles of a mesh for `inside_layers`.

    Parameters
    ----------
    vertices : (n, 3) floats
        In the unit of the grid.
    faces : (m, 3) integers
        Wound outwards.
    grid : Grid
        The samples of the whole part.
    method : Method
        "scanline" is for meshes that bound a solid.
    """
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
