"""``write.picture``: a rendered view, without a display."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline.data.mesh import SurfaceMesh
from sppm_pipeline.data.palette import Palette
from sppm_pipeline.data.size import Size
from sppm_pipeline.families import options
from sppm_pipeline.fields.picture import MAX_SAMPLES, MAX_TILES, field_picture, tile_sheet
from sppm_pipeline.fields.scalar_field import ScalarField
from sppm_pipeline.fields.tileset import TileSet
from sppm_pipeline.stage import Context, Stage


@dataclass(frozen=True, kw_only=True)
class WritePicture(Stage):
    """Render a mesh, a cell, a tiling or a part as PNG; a tile set becomes a sheet of all its tiles."""

    name: ClassVar[str] = "write.picture"
    advice: ClassVar[str] = "lower `resolution` or `image_size`"
    version: ClassVar[int] = 2

    path: str = options.write_path("picture.png", suffixes=(".png",))
    resolution: int = options.resolution(32, note="fewer where the picture could not show them", minimum=4, maximum=512)
    image_size: tuple[int, int] = options.image_size((1200, 900), minimum=16, formerly="size")
    azimuth: float = options.azimuth(-60.0)
    elevation: float = options.elevation(25.0)
    section: float | None = options.section(None)

    def estimate(self, palette: Palette, what: Size) -> Size:
        pixels, n = float(self.image_size[0] * self.image_size[1]), self.resolution
        tiles, share = 1.0, self.section or 1.0
        if what.triangles:
            return Size(pixels=pixels, triangles=what.triangles)
        body = what.body
        if what.cells > body.volume:  # a sheet of a tile set
            tiles, pixels = min(what.cells, MAX_TILES), 300.0 * 270
        while n > 4 and body.samples(n) * share > MAX_SAMPLES:
            n -= 1
        grid, shown = what.grid(n), share * tiles
        return Size(
            pixels=tiles * pixels, triangles=shown * body.triangles(n), samples=shown * grid.samples,
            sums=shown * grid.sums, resident=share * grid.samples,
        )  # fmt: skip

    def run(self, context: Context, what: SurfaceMesh | ScalarField | TileSet) -> None:
        """Render and write."""
        from PIL import Image

        from sppm_pipeline.render.camera import Camera
        from sppm_pipeline.render.mesh_view import render_mesh

        camera, threads = Camera(azimuth=self.azimuth, elevation=self.elevation), context.threads
        if isinstance(what, SurfaceMesh):
            picture = render_mesh(what.vertices, what.faces, camera=camera, size=self.image_size)
        elif isinstance(what, TileSet):
            picture = tile_sheet(
                what,
                self.resolution,
                camera,
                threads=threads,
                progress=lambda done, of: context.progress(done, of, "tiles drawn"),
            )
        else:
            picture = field_picture(
                what, self.resolution, self.image_size, camera, section=self.section, threads=threads
            )
        Image.fromarray(picture).save(context.output(self.path))
