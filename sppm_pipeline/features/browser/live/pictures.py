"""Pictures of fields, meshes and tile sets: what is solid, seen by rays; cut faces in a color of their own."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.method.fields.microstructure import Microstructure
from sppm_pipeline.method.fields.scalar_field import ScalarField
from sppm_pipeline.method.fields.tileset import TileSet
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.nouns.voxels import Voxels
from sppm_pipeline.method.part.part import Part, node_grid
from sppm_pipeline.nouns.artifact import NOTEBOOK_SIZE, png_of
from sppm_pipeline.services.arrays import F32, F64, I64, U8
from sppm_pipeline.services.grid import VOXEL_FACES, Grid

if TYPE_CHECKING:
    from sppm_pipeline.features.browser.live.solid_view import Colors, Solid
    from sppm_pipeline.services.pictures.camera import Camera, Frame
    from sppm_pipeline.services.pictures.shading import Background, Color

MAX_SAMPLES = 64_000_000
"""Samples of a field for one picture; finer grids are coarsened, as no pixel would show the difference."""

MAX_TILES = 64
"""Tiles on a sheet."""

SLAB_SAMPLES = 2**20
"""Samples taken at a time."""

_BEYOND = 2  # samples around the box, so that the surface closes inside of the grid; more are empty

_BOX_FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
     [1, 5, 7], [1, 7, 3]]
)  # fmt: skip

TILE_COLORS: tuple[Color, ...] = ((204, 64, 54), (58, 104, 196), (62, 150, 74))
"""Red, blue and green as in the paper's figure of the tile set: the cut faces that show the first three face colors."""

PHASE_COLORS = np.array(
    [(226, 216, 196), (0, 114, 178), (230, 159, 0), (0, 158, 115), (204, 121, 167), (86, 180, 233), (213, 94, 0)],
    np.uint8,
)
"""Bone, then colors that all kinds of color vision tell apart (Okabe and Ito 2008); phase 8 begins again."""


@dataclass(frozen=True, eq=False)
class Scene:
    """Something to be seen, sampled once for any number of views."""

    solid: Solid  # in the unit of length of what is seen: cell sizes, or of a mesh millimeters
    unit_mm: float | None  # that unit, mm; None if it has no physical size
    removed_share: float  # islands that were left out, as a share of the solid samples
    colors: Colors
    held: F64 | None = None  # corners (n, 3) of triangles that hold the solid closer than those of its box

    def frame(self, size: tuple[int, int], camera: Camera, margin: float = 0.04) -> Frame:
        """The camera, pointed at the whole, cut or not."""
        from sppm_pipeline.services.pictures.camera import framed

        points = self.solid.vertices[np.unique(self.solid.faces)] if self.held is None else self.held
        return framed(camera, points, size, margin)

    def picture(
        self, size: tuple[int, int], camera: Camera, *, section: float | None = None, section_along: str = "y",
        annotate: bool = False, background: Background = "light", material: str = "bone", shadow: bool = False,
        threads: int = 1,
    ) -> U8:  # fmt: skip
        """A view (height, width, 3), or with a transparent background (height, width, 4) uint8, of `size` (width,
        height).

        With a `section` only this fraction along `section_along` is kept, the side away from the viewer, to look
        inside; along "corner" what is beyond it along both x and y is left out. `annotate` draws the axes and a scale
        bar; for `material` and `shadow` see `render_solid`.
        """
        from sppm_pipeline.features.browser.live.solid_view import render_solid
        from sppm_pipeline.services.pictures.shading import MATERIALS
        from sppm_pipeline.services.pictures.sheets import annotated

        frame, planes = self.frame(size, camera, 0.1 if shadow else 0.04), []  # a shadow needs room
        for axis in (
            () if section is None else ("xyz".index(a) for a in {"corner": "xy"}.get(section_along, section_along))
        ):
            side = 1.0 if frame.axes[2, axis] > 0 else -1.0
            corners = side * self.solid.vertices[np.unique(self.solid.faces), axis]
            normal = [0.0, 0.0, 0.0]
            normal[axis] = side
            low, high = float(corners.min()), float(corners.max())
            planes.append((normal, low + (section or 0.0) * (high - low)))
        picture = render_solid(
            self.solid, frame, size, section=planes, colors=self.colors, background=background,
            material=MATERIALS[material], shadow=shadow, threads=threads,
        )  # fmt: skip
        return annotated(picture, frame, self.unit_mm, dark=background == "dark") if annotate else picture


def scene_of(
    what: ScalarField | SurfaceMesh, resolution: int, *, threads: int = 1, max_samples: int = MAX_SAMPLES
) -> Scene:
    """Solid of a field, of up to `max_samples`, `resolution` along a cell edge; or the inside of a closed mesh."""
    from sppm_pipeline.features.browser.live.solid_view import COLORS, Solid

    if isinstance(what, SurfaceMesh):
        grid = Grid((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (2, 2, 2))
        filled = Solid(grid, what.vertices, what.faces, np.full((2, 2, 2), -1, np.float32))
        return Scene(filled, 1.0, 0.0, COLORS._replace(domain=COLORS.field))
    n, grid = resolution, node_grid(what, resolution)
    while n > 4 and math.prod(grid.shape) > max_samples:
        n -= 1
        grid = node_grid(what, n)
    colors = COLORS
    if isinstance(what, Part):
        solid, removed = _part_solid(what, grid, threads)
    else:
        colors = COLORS._replace(domain=COLORS.section)  # a cell ends where it is cut out of its copies
        solid, removed = Solid(grid, *_box(grid), _smooth(what, what.sample_zyx(grid, 0, grid.shape[2], threads))), 0.0
    held = None
    if isinstance(what, Part) and what.border is not None:  # which ends the solid within the domain
        held = (what.domain.vertices[np.unique(what.domain.faces)] - what.origin_mm) / what.physical_edge()
    return Scene(solid, what.edge_mm, removed, colors, held)


def _box(grid: Grid) -> tuple[F64, NDArray[np.integer]]:
    """Vertices and triangles of the box that a grid fills, wound outwards."""
    ends = [(grid.origin[a], grid.origin[a] + (grid.shape[a] - 1) * grid.spacing[a]) for a in range(3)]
    return np.array([[x, y, z] for x in ends[0] for y in ends[1] for z in ends[2]]), _BOX_FACES


def _smooth(field: ScalarField, values: F32) -> F32:
    """Logarithms in place of sums of kernels, as less happens between their samples; in place."""
    from sppm_pipeline.method.kernels.profiles import log_of_sums

    return values if field.sum_level is None else log_of_sums(values, field.sum_level)


def _part_solid(part: Part, grid: Grid, threads: int) -> tuple[Solid, float]:
    """Solid of a part, without the islands that it leaves out, and their share."""
    from sppm_pipeline.features.browser.live.solid_view import Solid

    nx, ny, nz = grid.shape
    # by scan lines the triangles themselves bound the part; otherwise its surface is sampled, too
    closed = part.method == "scanline" and part.border is None
    field = np.empty((nz, ny, nx), np.float32)
    skin = np.empty_like(field) if part.has_skin and part.border is None else None
    outer = None if closed else np.empty_like(field)
    held = np.empty(field.shape if part.islands != "keep" else (0, 0, 0), np.uint8)
    step = max(1, SLAB_SAMPLES // (nx * ny))
    for start in range(0, nz, step):
        layers = slice(start, min(start + step, nz))
        if outer is None:
            inner, shell, inside = part.within_zyx(grid, threads, layers.start, layers.stop)
        else:
            inner, shell, outer[layers] = part.fields_zyx(grid, threads, layers.start, layers.stop)
            inside = outer[layers] < 0
        if held.size:
            held[layers] = ((inner < 0) if shell is None else (np.minimum(inner, shell) < 0)) & inside
        field[layers] = inner if part.border else _smooth(part.base, inner)
        if skin is not None:
            skin[layers] = shell
    removed = _remove_islands((field,) if skin is None else (field, skin), held) if held.size else 0.0
    vertices, faces = _box(grid)
    if closed:
        vertices, faces = (part.domain.vertices - part.origin_mm) / part.physical_edge(), part.domain.faces
    solid = Solid(grid, vertices, faces, field)
    if skin is not None:
        solid = solid._replace(skin=skin)
    return solid if outer is None else solid._replace(outer=outer), removed


def _remove_islands(fields: tuple[F32, ...], held: U8) -> float:
    """Make void, in place, what the largest component of the samples held by the part does not reach; its share."""
    # beyond the surface of the part solid stays near what does, enough for its edges; chips without a sample vanish
    from sppm_pipeline.method.connectivity.components import find_components
    from sppm_pipeline.method.connectivity.islands import clear_runs
    from sppm_pipeline.method.tiling.lattice import dilated

    found = find_components(held)
    total, largest = int(found.sizes.sum()), int(found.sizes[:1].sum())
    beyond = np.logical_and.reduce([field >= 0 for field in fields])
    np.logical_not(beyond, out=beyond)
    beyond &= held == 0
    if largest < total:
        clear_runs(found.runs.rows, found.runs.bounds, found.of_run == 0, held)
    stays = held.view(np.bool_)
    for _ in range(_BEYOND):
        stays = (dilated(stays) & beyond) | held.view(np.bool_)
    for field in fields:
        np.negative(field, out=field, where=(field < 0) & ~stays)
    return (total - largest) / max(1, total)


def mesh_picture(
    vertices: F64, faces: NDArray[np.integer], size: tuple[int, int], camera: Camera, *, colors: U8 | None = None,
    unit_mm: float | None = 1.0, annotate: bool = False, background: Background = "light", threads: int = 1,
) -> U8:  # fmt: skip
    """Triangles, seen from both sides; (height, width, 3), or 4 with a transparent background."""
    from sppm_pipeline.services.pictures.camera import framed
    from sppm_pipeline.services.pictures.mesh_view import render_mesh
    from sppm_pipeline.services.pictures.sheets import annotated

    picture = render_mesh(
        vertices, faces, camera=camera, size=size, face_colors=colors, background=background, threads=threads
    )
    if not (annotate and len(faces)):
        return picture
    frame = framed(camera, vertices[np.unique(faces)], size)
    return annotated(picture, frame, unit_mm, dark=background == "dark")


def voxel_picture(
    image: Voxels, size: tuple[int, int], camera: Camera, *, section: float | None = None, section_along: str = "y",
    annotate: bool = False, background: Background = "light", threads: int = 1,
) -> U8:  # fmt: skip
    """The voxels of an image that are not void, in colors of their phases, as `mesh_picture` shows triangles."""
    phases = image.solid().view(np.uint8) if image.fractions else np.asarray(image.values, np.uint8)
    # only every second or third voxel of larger images is looked at; no pixel would show the rest
    step = math.ceil((phases.size / MAX_SAMPLES) ** (1 / 3))
    phases = phases[::step, ::step, ::step]
    if section is not None:
        axis = "xyz".index(section_along)
        n = phases.shape[axis]
        phases = np.take(phases, range(min(n - 1, round((1 - section) * n)), n), axis)
    x, y, z = (step * h for h in image.spacing)
    vertices, faces, colors = phase_surface(phases, (x, y, z))
    return mesh_picture(
        vertices, faces, size, camera, colors=colors, unit_mm=1.0 if image.physical else None, annotate=annotate,
        background=background, threads=threads,
    )  # fmt: skip


def phase_surface(phases: U8, spacing: tuple[float, float, float]) -> tuple[F64, I64, U8]:
    """Faces of voxels, `phases` (nx, ny, nz) with edges `spacing`, that border on void (0) or on the outside.

    Vertices (p, 3), triangles (n, 3) with normals outwards, and for each the color of the phase behind it.
    """
    solid = np.pad(phases > 0, 1)
    inner = tuple(slice(1, -1) for _ in range(3))
    nodes = np.array(phases.shape) + 1
    triangles, colors = [], []
    for beyond, corners in VOXEL_FACES:
        bare = np.argwhere(solid[inner] & ~np.roll(solid, [-step for step in beyond], (0, 1, 2))[inner])
        ends = np.array([[c & 1, c >> 1 & 1, c >> 2] for c in corners])
        quads = np.ravel_multi_index(tuple(np.moveaxis(bare[:, None] + ends, 2, 0)), tuple(nodes))
        color = PHASE_COLORS[(phases[tuple(bare.T)].astype(np.int64) - 1) % len(PHASE_COLORS)]
        triangles += [quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]
        colors += [color, color]
    used, faces = np.unique(np.concatenate(triangles), return_inverse=True)
    vertices = np.stack(np.unravel_index(used, tuple(nodes)), axis=1) * np.array(spacing)
    return vertices, faces.reshape(-1, 3), np.concatenate(colors)


def tile_sheet(
    tileset: TileSet, resolution: int, camera: Camera, *, background: Background = "light", threads: int = 1,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> U8:  # fmt: skip
    """Pictures of the tiles of a set, up to `MAX_TILES`, with their colors and porosities.

    The cut faces of Wang tiles of up to three colors are red, blue or green.
    """
    from sppm_pipeline.services.pictures.sheets import DARK_PAPER, INK, LIGHT_INK, PAPER, contact_sheet

    pictures, labels = [], []
    c = tileset.palette_colors
    shown = min(tileset.micro.interiors, MAX_TILES)
    for t in range(shown):
        colors = (t // c**2, t // c % c, t % c) if tileset.kind == "wang" else (0, 0, 0)
        scene = scene_of(tileset.micro.alone(t, colors), resolution, threads=threads)
        own = colors if tileset.kind == "wang" and c <= len(TILE_COLORS) else None
        pictures.append(_tile_picture(scene, own, camera, background, threads))
        share = f"  {tileset.porosity[t]:.1%}" if t < len(tileset.porosity) else ""
        name = "".join("xyz"[a] + str(colors[a] + 1) for a in range(3)) if tileset.kind == "wang" else str(t)
        labels.append(name + share)
        progress(t + 1, shown)
    paper, ink = (DARK_PAPER, LIGHT_INK) if background == "dark" else (PAPER, INK)
    columns = 9 if len(pictures) > 16 else 4
    return contact_sheet(pictures, labels, columns=columns, background=paper, ink=ink)


def _tile_picture(
    scene: Scene, colors: tuple[int, int, int] | None, camera: Camera, background: Background, threads: int
) -> U8:
    """A tile whose cut faces across each axis show a color: each is taken from a picture with cuts of its color."""
    from PIL import Image, ImageDraw

    from sppm_pipeline.services.pictures.camera import projected

    size = (300, 270)
    if colors is None:
        return scene.picture(size, camera, background=background, threads=threads)
    made = {
        color: replace(scene, colors=scene.colors._replace(domain=TILE_COLORS[color])).picture(
            size, camera, background=background, threads=threads
        )
        for color in set(colors)
    }
    frame, corners, picture = scene.frame(size, camera), scene.solid.vertices, made[colors[0]].copy()
    for axis in range(3):
        toward = frame.axes[2, axis]
        end = corners[:, axis].max() if toward > 0 else corners[:, axis].min()
        seen = projected(frame, corners[corners[:, axis] == end])[:, :2]
        outline = [tuple(seen[place]) for place in (0, 1, 3, 2)]  # corners of a box are listed in binary order
        mask = Image.new("1", size)
        ImageDraw.Draw(mask).polygon(outline, fill=1)
        there = np.asarray(mask)
        picture[there] = made[colors[axis]][there]
    return picture


NOTEBOOK_SAMPLES = 1_500_000
"""Samples of a field for a picture in a notebook."""


def notebook_png(what: ScalarField | TileSet) -> bytes | None:
    """A small picture for notebooks as PNG; None of kernels that have to be laid out before there is a field."""
    from sppm_pipeline.services.pictures.camera import Camera

    if isinstance(what, TileSet):
        return png_of(tile_sheet(what, 24, Camera()))
    if isinstance(what, Microstructure) and (what.interiors > 1 or max(what.colors) > 1):
        return None
    return png_of(scene_of(what, 40, max_samples=NOTEBOOK_SAMPLES).picture(NOTEBOOK_SIZE, Camera()))
