"""Pictures of fields and tile sets: the surface of the solid, cut faces in a color of their own."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.data.artifact import NOTEBOOK_SIZE, png_of
from sppm_pipeline.fields.field_surface import FieldSurface, node_grid
from sppm_pipeline.fields.microstructure import Microstructure
from sppm_pipeline.fields.part import Part
from sppm_pipeline.fields.scalar_field import ScalarField
from sppm_pipeline.fields.tileset import TileSet
from sppm_pipeline.numerics.grid import Grid, cell_nodes

if TYPE_CHECKING:
    from sppm_pipeline.render.camera import Camera

MAX_SAMPLES = 64_000_000
"""Samples of a field for one picture; finer grids are coarsened, as no pixel would show the difference."""

MAX_TILES = 64
"""Tiles on a sheet."""


def field_picture(
    field: ScalarField,
    resolution: int,
    size: tuple[int, int],
    camera: Camera,
    *,
    section: float | None = None,
    threads: int = 1,
    max_samples: int = MAX_SAMPLES,
) -> NDArray[np.uint8]:
    """The solid of a field as a picture (height, width, 3).

    Parameters
    ----------
    field : ScalarField
    resolution : int
        Samples along a cell edge; fewer if there were more than `max_samples`.
    size : (width, height)
    camera : Camera
    section : float, optional
        Keep only this fraction along y, the far side, to look inside; islands are those of the whole part.
    threads, max_samples : int
    """
    low, high = np.zeros(3), np.array(field.cells, float)
    if isinstance(field, Part):
        edge = field.physical_edge()
        low = (field.domain.lower - field.origin_mm) / edge
        high = (field.domain.upper - field.origin_mm) / edge
    at = None if section is None else float(high[1] - section * (high[1] - low[1]))
    if at is not None and not isinstance(field, Part):
        low[1] = at
    n = resolution
    while n > 4 and np.prod((high - low) * n + 1) > max_samples:
        n -= 1
    if isinstance(field, Part):
        return _surface_picture(
            FieldSurface(field, node_grid(field, n), field.islands, section=at), size, camera, threads
        )
    first, last = np.floor(low * n + 1e-6).astype(int), np.ceil(high * n - 1e-6).astype(int)
    nx, ny, nz = (int(v) for v in last - first + 1)
    x, y, z = (float(v) / n for v in first)
    grid = Grid((x, y, z), (1 / n,) * 3, (nx, ny, nz))
    return _surface_picture(FieldSurface(field, grid, "keep"), size, camera, threads)


def _surface_picture(surface: FieldSurface, size: tuple[int, int], camera: Camera, threads: int) -> NDArray[np.uint8]:
    """Picture of a surface; what lies on the domain of a part or on the border of the grid is colored as a cut."""
    from sppm_pipeline.numerics.surface.placing import DOMAIN
    from sppm_pipeline.render.mesh_view import render_mesh
    from sppm_pipeline.render.shading import BONE, CUT

    vertices, faces, _, kinds = surface.mesh_with_kinds(threads)
    cut = kinds == DOMAIN
    if not isinstance(surface.source, Part):
        place = (vertices - surface.grid.origin) / surface.grid.spacing
        border = np.concatenate([place < 1e-6, np.array(surface.grid.shape) - 1 - place < 1e-6], axis=1)
        cut = np.any(np.all(border[faces], axis=1), axis=1)
    colors = np.where(cut[:, None], np.array(CUT, np.uint8), np.array(BONE, np.uint8))
    return render_mesh(vertices, faces, camera=camera, size=size, face_colors=colors)


def tile_sheet(
    tileset: TileSet,
    resolution: int,
    camera: Camera,
    *,
    threads: int = 1,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> NDArray[np.uint8]:
    """Pictures of the tiles of a set, up to `MAX_TILES`, with their colors and porosities."""
    from sppm_pipeline.render.sheets import contact_sheet

    pictures, labels = [], []
    c = tileset.palette_colors
    shown = min(tileset.micro.interiors, MAX_TILES)
    for t in range(shown):
        colors = (t // c**2, t // c % c, t % c) if tileset.kind == "wang" else (0, 0, 0)
        surface = FieldSurface(tileset.micro.alone(t, colors), cell_nodes(resolution), "keep")
        pictures.append(_surface_picture(surface, (300, 270), camera, threads))
        share = f"  {tileset.porosity[t]:.1%}" if t < len(tileset.porosity) else ""
        name = "".join("xyz"[a] + str(colors[a] + 1) for a in range(3)) if tileset.kind == "wang" else str(t)
        labels.append(name + share)
        progress(t + 1, shown)
    return contact_sheet(pictures, labels, columns=9 if len(pictures) > 16 else 4)


NOTEBOOK_SAMPLES = 1_500_000
"""Samples of a field for a picture in a notebook."""


def notebook_png(what: ScalarField | TileSet) -> bytes | None:
    """A small picture for notebooks as PNG; None of kernels that have to be laid out before there is a field."""
    from sppm_pipeline.render.camera import Camera

    if isinstance(what, TileSet):
        return png_of(tile_sheet(what, 24, Camera()))
    if isinstance(what, Microstructure) and (what.interiors > 1 or max(what.colors) > 1):
        return None
    return png_of(field_picture(what, 40, NOTEBOOK_SIZE, Camera(), max_samples=NOTEBOOK_SAMPLES))
