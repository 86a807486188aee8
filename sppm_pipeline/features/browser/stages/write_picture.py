"""``write.picture``: a rendered view, without a display."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import numpy as np

from sppm_pipeline import Palette, PoreSet, ScalarField, Size, SurfaceMesh, TileSet, TunnelGraph, Voxels, options
from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.browser.live.pictures import (
    MAX_SAMPLES,
    MAX_TILES,
    mesh_picture,
    scene_of,
    tile_sheet,
    voxel_picture,
)
from sppm_pipeline.services.arrays import F64, I64, U8
from sppm_pipeline.services.pictures.shading import CUT, MATERIALS
from sppm_pipeline.stage import Context, Stage, option

MAX_SHOWN = 20_000
"""Pores and tunnels of a picture; more would hide each other, and take minutes."""

BALL, ROD, FRAME = 0.024, 0.007, 0.005
"""Radii in cell sizes of a pore, a tunnel and an edge of the frame."""

INTERIOR, FACES = (0, 114, 178), ((213, 94, 0), (0, 158, 115), (204, 121, 167))
TUNNEL, CONNECTOR, EDGE, INNER = (86, 180, 233), (150, 150, 150), (40, 120, 80), (30, 90, 150)

_SIDES = 8


class Shape(NamedTuple):
    """Triangles with a color each."""

    vertices: F64
    faces: I64
    colors: U8


def graph_shape(what: PoreSet | TunnelGraph) -> Shape:
    """The pores of one cell and their tunnels, in cell sizes; `DesignError` if there are more than `MAX_SHOWN`, or they
    have no cell.

    Of a tile set the first interior and the first color of each axis are shown. Pores of the interior are blue; those
    of faces across x, y and z orange, green and pink, on both sides of the cell. Tunnels are light blue, those between
    the interior and a face gray. The outer frame is the cell; the inner one, of cells with face pores, is the smallest
    box that holds the pores of the interior.
    """
    pores = what if isinstance(what, PoreSet) else what.pores
    if pores.blocks is not None:
        raise DesignError("pores of blocks without faces have no cell to be drawn in", hint="draw the field they make")
    shown = [0, *(pores.face_piece(axis, 0) for axis in range(3) if pores.colors[axis])]
    kept, axis_of, place = np.isin(pores.piece, shown), pores.axis_of_piece()[pores.piece], pores.centers
    edges, shift = np.zeros((0, 2), np.int64), np.zeros((0, 3))
    if isinstance(what, TunnelGraph):
        there = kept[what.edges].all(1)
        edges, shift = what.edges[there].astype(np.int64), what.shift[there].astype(np.float64)
    if kept.sum() + len(edges) > MAX_SHOWN:
        raise DesignError(
            f"a picture shows up to {MAX_SHOWN} pores and tunnels, there are {kept.sum()} and {len(edges)}",
            hint="draw the field that is made of them",
        )
    shapes = [_rods(*_box_edges(np.zeros(3), np.ones(3)), FRAME, EDGE)]
    inside = kept & (axis_of < 0)
    if pores.has_faces and inside.sum() > 1:
        shapes.append(_rods(*_box_edges(place[inside].min(0), place[inside].max(0)), FRAME, INNER))
    shapes.append(_balls(place[inside], BALL, INTERIOR))
    for axis in range(3):
        # a pore is seen at every place of the cell that is the same by periodicity
        images = np.concatenate([place[kept & (axis_of == axis)] + np.array(s) for s in np.ndindex(2, 2, 2)])
        shapes.append(_balls(images[(images <= 1).all(1)], BALL, FACES[axis]))
    starts, ends = place[edges[:, 0]], place[edges[:, 1]] + shift
    across = pores.piece[edges[:, 0]] != pores.piece[edges[:, 1]]
    for chosen, color in ((~across, TUNNEL), (across, CONNECTOR)):
        # a tunnel that leaves the cell comes in again on the other side; one of a face is seen on both sides
        moves = [np.array(s) - 1.0 for s in np.ndindex(3, 3, 3)]
        parts = [_clipped(starts[chosen] + move, ends[chosen] + move) for move in moves]
        first, last = (np.concatenate([part[end] for part in parts]) for end in (0, 1))
        shapes.append(_rods(first, last, ROD, color))
    return _together(shapes)


def _together(shapes: list[Shape]) -> Shape:
    firsts = np.cumsum([0, *(len(shape.vertices) for shape in shapes)])
    return Shape(
        np.concatenate([shape.vertices for shape in shapes]),
        np.concatenate([shape.faces + first for shape, first in zip(shapes, firsts, strict=False)]),
        np.concatenate([shape.colors for shape in shapes]),
    )


def _many(points: F64, faces: I64, color: tuple[int, int, int]) -> Shape:
    """Copies of one body with vertices `points` (copies, n, 3)."""
    copies, n = points.shape[:2]
    triangles = (faces[None] + n * np.arange(copies)[:, None, None]).reshape(-1, 3)
    return Shape(points.reshape(-1, 3), triangles, np.full((len(triangles), 3), color, np.uint8))


def _balls(centers: F64, radius: float, color: tuple[int, int, int]) -> Shape:
    from sppm_pipeline.services.elastic.directional import sphere_mesh

    sphere, faces = sphere_mesh(2)
    return _many(centers[:, None, :] + radius * sphere, np.asarray(faces, np.int64), color)


def _rods(starts: F64, ends: F64, radius: float, color: tuple[int, int, int]) -> Shape:
    """Open prisms around segments."""
    along = ends - starts
    along = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    helper = np.eye(3)[np.abs(along).argmin(1)]
    u = np.cross(along, helper)
    u /= np.maximum(np.linalg.norm(u, axis=1, keepdims=True), 1e-12)
    v = np.cross(along, u)
    angle = np.arange(_SIDES) * 2 * np.pi / _SIDES
    ring = radius * (np.cos(angle)[None, :, None] * u[:, None] + np.sin(angle)[None, :, None] * v[:, None])
    points = np.concatenate([starts[:, None] + ring, ends[:, None] + ring], axis=1)
    here = np.arange(_SIDES)
    there = (here + 1) % _SIDES
    faces = np.concatenate(
        [np.stack([here, there, there + _SIDES], 1), np.stack([here, there + _SIDES, here + _SIDES], 1)]
    )
    return _many(points, faces, color)


def _clipped(starts: F64, ends: F64) -> tuple[F64, F64]:
    """The parts of segments in the unit cube (Liang and Barsky 1984), those of some length."""
    along = ends - starts
    with np.errstate(divide="ignore", invalid="ignore"):
        enter, leave = -starts / along, (1 - starts) / along
    flat = along == 0
    outside = (flat & ((starts < 0) | (starts > 1))).any(1)
    enter, leave = np.minimum(enter, leave), np.maximum(enter, leave)
    first = np.where(flat, 0.0, enter).max(1).clip(0.0)
    last = np.where(flat, 1.0, leave).min(1).clip(max=1.0)
    there = ((last - first) * np.linalg.norm(along, axis=1) > 1e-9) & ~outside
    first, last = (t[there, None] for t in (first, last))
    return starts[there] + first * along[there], starts[there] + last * along[there]


def _box_edges(low: F64, high: F64) -> tuple[F64, F64]:
    """Starts and ends of the 12 edges of a box."""
    corners = np.array(list(np.ndindex(2, 2, 2)))
    pairs = [(a, b) for a in range(8) for b in range(a) if np.abs(corners[a] - corners[b]).sum() == 1]
    places = low + corners * (high - low)
    return places[[a for a, _ in pairs]], places[[b for _, b in pairs]]


VALUES_OF_A_PIXEL = 15.5
"""Values of five bytes that are held for each pixel of the picture that is drawn, as measured."""

CUTS = {"copper": CUT, "red": (204, 64, 54), "green": (62, 150, 74), "blue": (58, 104, 196)}
"""Colors of planes by name."""

TRIANGLES_OF_A_PORE, TRIANGLES_OF_A_TUNNEL = 320.0, 16.0
"""Triangles of a ball, and of a rod."""


@dataclass(frozen=True, kw_only=True)
class WritePicture(Stage):
    """Render a mesh, a cell, a tiling, a part or voxels as PNG; a tile set becomes a sheet of all its tiles.

    The cut faces of Wang tiles of up to three colors are red, blue and green, as their pattern of pores is the first,
    second or third. Pores become balls and tunnels rods, within the frame of their cell: interior pores blue, those
    of faces across x, y and z orange, green and pink on both sides, tunnels light blue, those between interior and
    faces gray. The inner frame holds the interior pores. Of a tile set's pores those of the first tile are shown.
    Give `from` to choose them.

    What is solid of a field is seen by rays, within the triangles of the part: rims are exact. Islands that are removed
    from the layers of a part are not shown, and their share of the solid is reported. Cut faces have a color of their
    own, and with the material "bone" the skin; `cut: plain` gives all of them that of the material. Voxels have the
    color of their phase: bone, blue, orange, green, pink, sky, red.
    """

    name: ClassVar[str] = "write.picture"
    advice: ClassVar[str] = "lower `resolution` or `image_size`"
    version: ClassVar[int] = 5
    reported: ClassVar[tuple[str, ...]] = ("removed_share",)

    path: str = options.write_path("picture.png", suffixes=(".png",))
    resolution: int = options.resolution(32, note="fewer where the picture could not show them", minimum=4, maximum=512)
    image_size: tuple[int, int] = options.image_size((1200, 900), minimum=16, formerly="size")
    azimuth: float = options.azimuth(-60.0)
    elevation: float = options.elevation(25.0)
    section: float | None = options.section(None)
    section_along: str = option(
        "y",
        help="axis across which `section` cuts; at a corner only what is beyond it along x and y is left out",
        choices=("x", "y", "z", "corner"),
    )
    cut: str = option("copper", help="color of cut faces; plain is that of the material", choices=(*CUTS, "plain"))
    material: str = option("bone", help="color and shine of a solid", choices=tuple(MATERIALS))
    shadow: bool = option(False, help="soft shadows of a solid, on itself and on the ground, and depth")
    annotate: bool = option(True, help="draw the directions of the axes and a scale bar; not on sheets of tiles")
    background: str = option("light", help="what is behind the part", choices=("light", "dark", "transparent"))

    def estimate(self, palette: Palette, what: Size) -> Size:
        pixels, n = float(self.image_size[0] * self.image_size[1]), self.resolution
        tiles, held = 1.0, VALUES_OF_A_PIXEL * pixels
        if what.geometry is None or what.triangles or what.voxels:
            cell = what.design
            shown = cell.interior_pores + 2 * cell.face_pores if cell else what.pores
            balls = TRIANGLES_OF_A_PORE * shown + TRIANGLES_OF_A_TUNNEL * (cell.tunnels if cell else what.tunnels)
            # an image of pores and walls that are eight voxels wide has half as many triangles as voxels
            return Size(pixels=pixels, triangles=what.triangles or what.voxels / 2 or balls, resident=held)
        body = what.body
        if what.cells > body.volume:  # a sheet of a tile set
            tiles, pixels = min(what.cells, MAX_TILES), 300.0 * 270
            held = VALUES_OF_A_PIXEL * pixels
        while n > 4 and body.samples(n) > MAX_SAMPLES:
            n -= 1
        grid = what.grid(n)
        return Size(
            pixels=tiles * pixels, samples=tiles * grid.samples, sums=tiles * grid.sums, resident=grid.samples + held
        )

    def run(self, context: Context, what: SurfaceMesh | ScalarField | TileSet | Voxels | TunnelGraph | PoreSet) -> None:
        """Render and write."""
        from PIL import Image

        from sppm_pipeline.services.pictures.camera import Camera

        camera, threads = Camera(azimuth=self.azimuth, elevation=self.elevation), context.threads
        if isinstance(what, TileSet):
            picture = tile_sheet(
                what, self.resolution, camera, background=self.background, threads=threads,
                progress=lambda done, of: context.progress(done, of, "tiles drawn"),
            )  # fmt: skip
        elif isinstance(what, (TunnelGraph, PoreSet)):
            if self.section is not None:
                raise ConfigError("`section` cuts solids, not pores and tunnels", hint="leave it out")
            shape, cell = graph_shape(what), (what if isinstance(what, PoreSet) else what.pores).cell
            picture = mesh_picture(
                shape.vertices, shape.faces, self.image_size, camera, colors=shape.colors,
                unit_mm=cell.edge if cell.physical else None, annotate=self.annotate, background=self.background,
                threads=threads,
            )  # fmt: skip
        elif isinstance(what, Voxels):
            picture = voxel_picture(
                what, self.image_size, camera, section=self.section, section_along=self.section_along,
                annotate=self.annotate, background=self.background, threads=threads,
            )  # fmt: skip
        elif isinstance(what, SurfaceMesh) and self.section is None and self.material == "bone" and not self.shadow:
            picture = mesh_picture(
                what.vertices, what.faces, self.image_size, camera, annotate=self.annotate,
                background=self.background, threads=threads,
            )  # fmt: skip
        else:
            if isinstance(what, SurfaceMesh) and not what.bounds_solid:
                raise ConfigError(
                    "`section`, `material` and `shadow` are for solids, and this mesh has a border, so that nothing is "
                    "inside of it",
                    hint="leave them out, or close the mesh",
                )
            scene = scene_of(what, self.resolution, threads=threads)
            if scene.removed_share:
                context.report(removed_share=scene.removed_share)
            material, colors = MATERIALS[self.material], scene.colors
            cut, own = CUTS.get(self.cut, material.own), colors.domain == CUT
            colors = colors._replace(field=material.color, domain=cut if own else material.own, section=cut)
            colors = colors if self.material == "bone" and self.cut != "plain" else colors._replace(skin=material.own)
            scene = replace(scene, colors=colors)
            picture = scene.picture(
                self.image_size, camera, section=self.section, section_along=self.section_along,
                annotate=self.annotate, background=self.background, material=self.material, shadow=self.shadow,
                threads=threads,
            )  # fmt: skip
        Image.fromarray(picture).save(context.output(self.path))
