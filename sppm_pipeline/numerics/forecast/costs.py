"""Bytes and seconds of the kernels, as measured on one core at about 3 GHz.

The constants were fitted to runs of the example configurations (tests/endurance/estimates.py repeats them) and hold
within a factor of three for time and of one and a half for memory and files.
"""

from __future__ import annotations

import math

TRIANGLES = 2.6
"""Triangles of marching cubes for a surface of one squared voxel edge, at random orientation."""

SLAB_VOXELS = 2**22
"""Voxels that are sliced together."""

LAYER_BYTES = 80
"""Bytes of a layer's file beside its pixels."""

PICTURE_BYTES = 0.5
"""Bytes of a pixel of a rendered PNG."""

CHILD_BYTES = 150e6
"""Bytes of a child process with the program's libraries."""

BOOLEAN_BYTES = 600
"""Bytes for each triangle that goes into a Boolean, its own arrays and those of the result included."""

SUM_NS, KERNEL_NS, PATCH_NS = 8.0, 1.1, 8.0
"""Nanoseconds of a voxel whose kernels are summed, of each of its kernels, and of one put together from patches."""


def field_seconds(voxels: float, kernels: float, *, patched: bool = False) -> float:
    """Seconds for sampling a field of so many kernels at a point."""
    return voxels * 1e-9 * (PATCH_NS if patched else SUM_NS + KERNEL_NS * kernels)


def surface_triangles(surface: float, voxels_along: float) -> float:
    """Triangles of a surface given in cell edges^2, at so many voxels along a cell edge."""
    return TRIANGLES * surface * voxels_along**2


def body_triangles(surface: float, volume: float, envelope: float, porosity: float, voxels_along: float) -> float:
    """Triangles of marching cubes of a body: its pores, and the solid parts of the box or skin that it ends at.

    Parameters
    ----------
    surface : float
        Area of the pores, cell edges^2 for each cell.
    volume, envelope : float
        Of the body, in cells and cell edges^2.
    porosity : float
    voxels_along : float
        Voxels along a cell edge.
    """
    return surface_triangles(surface, voxels_along) * volume + 2 * envelope * (1 - porosity) * voxels_along**2


def boolean_seconds(triangles: float) -> float:
    """Seconds of a Boolean of so many triangles in a child process."""
    return 0.6 + 3e-6 * triangles


def tetrahedra(
    surface: float, volume: float, porosity: float, voxels_along: float, order: int
) -> tuple[float, float, float]:
    """Tetrahedra, their nodes, and boundary triangles of isosurface stuffing.

    A cube of the body-centered lattice is worth twelve tetrahedra; the numbers of the surface were fitted. Nodes of
    quadratic tetrahedra follow from Euler's formula, as there is one on each edge.
    """
    cubes, crossed = volume * (1 - porosity) * voxels_along**3, surface * volume * voxels_along**2
    cells = 12 * cubes + crossed
    triangles = 4.2 * crossed
    corners = cells * (0.17 + 1.9 / voxels_along)
    return cells, corners if order == 1 else 2 * corners + cells + triangles / 2, triangles


def layer_bytes(pixels: float, surface: float, voxels_along: float) -> float:
    """Bytes of compressed black and white pixels inside of a part.

    They follow the length of the outlines, ``pi / 4`` of the surface in a volume. Where outlines come closer than the
    pixels show, pixels grow more alike again.
    """
    outline = math.pi / 4 * surface / voxels_along
    return pixels * 0.65 * outline / (1 + 20.8 * outline**2)


def patch_bytes(patches: float, reach: float, voxels_along: float) -> float:
    """Bytes of sampled patches that reach so many cell edges beyond their cell."""
    return patches * 4 * (voxels_along * (1 + 2 * reach)) ** 3


def picture_memory(pixels: float, triangles: float, voxels: float, *, part: bool) -> float:
    """Bytes for rendering the surface of a field."""
    return 110 * pixels + (115 if part else 62) * triangles + (12 if part else 8) * voxels


def picture_seconds(pixels: float, triangles: float, *, part: bool) -> float:
    """Seconds for extracting and rendering a surface."""
    return 1e-6 * (pixels + (2.0 if part else 0.5) * triangles)
