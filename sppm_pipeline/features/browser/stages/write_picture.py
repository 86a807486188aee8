"""``write.picture``: a rendered view, without a display."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from sppm_pipeline import (
    ConfigError,
    Context,
    Palette,
    PoreSet,
    ScalarField,
    Size,
    Stage,
    SurfaceMesh,
    TileSet,
    TunnelGraph,
    Voxels,
    option,
    options,
)
from sppm_pipeline.features.browser.live.graph_picture import graph_shape
from sppm_pipeline.features.browser.live.pictures import (
    MAX_SAMPLES,
    MAX_TILES,
    mesh_picture,
    scene_of,
    tile_sheet,
    voxel_picture,
)
from sppm_pipeline.services.pictures.shading import CUT

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
    from the layers of a part are not shown, and their share of the solid is reported. Cut faces, and the skin, have
    colors of their own. Voxels have the color of their phase: bone, blue, orange, green, pink, sky, red.
    """

    name: ClassVar[str] = "write.picture"
    advice: ClassVar[str] = "lower `resolution` or `image_size`"
    version: ClassVar[int] = 4
    reported: ClassVar[tuple[str, ...]] = ("removed_share",)

    path: str = options.write_path("picture.png", suffixes=(".png",))
    resolution: int = options.resolution(32, note="fewer where the picture could not show them", minimum=4, maximum=512)
    image_size: tuple[int, int] = options.image_size((1200, 900), minimum=16, formerly="size")
    azimuth: float = options.azimuth(-60.0)
    elevation: float = options.elevation(25.0)
    section: float | None = options.section(None)
    section_along: str = option("y", help="axis across which `section` cuts", choices=("x", "y", "z"))
    cut: str = option("copper", help="color of the plane of `section`", choices=tuple(CUTS))
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
                what,
                self.resolution,
                camera,
                background=self.background,
                threads=threads,
                progress=lambda done, of: context.progress(done, of, "tiles drawn"),
            )
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
        elif isinstance(what, SurfaceMesh) and self.section is None:
            picture = mesh_picture(
                what.vertices, what.faces, self.image_size, camera, annotate=self.annotate,
                background=self.background, threads=threads,
            )  # fmt: skip
        else:
            if isinstance(what, SurfaceMesh) and not what.bounds_solid:
                raise ConfigError(
                    "`section` cuts solids, and this mesh has a border, so that nothing is inside of it",
                    hint="leave out `section`, or close the mesh",
                )
            scene = scene_of(what, self.resolution, threads=threads)
            if scene.removed_share:
                context.report(removed_share=scene.removed_share)
            scene = replace(scene, colors=scene.colors._replace(section=CUTS[self.cut]))
            picture = scene.picture(
                self.image_size, camera, section=self.section, section_along=self.section_along,
                annotate=self.annotate, background=self.background, threads=threads,
            )  # fmt: skip
        Image.fromarray(picture).save(context.output(self.path))
