"""``write.picture``: a rendered view, without a display."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.data.mesh import SurfaceMesh
from sppm_pipeline.data.palette import Palette
from sppm_pipeline.data.size import Size
from sppm_pipeline.fields.part import Part
from sppm_pipeline.fields.scalar_field import ScalarField
from sppm_pipeline.fields.tileset import TileSet
from sppm_pipeline.numerics.grid import Grid, cell_nodes
from sppm_pipeline.stage import Context, Stage, option

if TYPE_CHECKING:
    from sppm_pipeline.render.camera import Camera

MOST_SAMPLES = 64_000_000
"""Samples of a field for one picture; finer grids are coarsened, as no pixel would show the difference."""

MOST_TILES = 64
"""Tiles on a sheet."""


@dataclass(frozen=True, kw_only=True)
class WritePicture(Stage):
    """Render a mesh, a cell, a tiling or a part as PNG; a tile set becomes a sheet of all its tiles."""

    name: ClassVar[str] = "write.picture"
    advice: ClassVar[str] = "lower `resolution` or `size`"

    path: str = option("picture.png", help="file to write", output=True)
    resolution: int = option(
        32, help="samples along a cell edge; fewer where the picture could not show them", minimum=4, maximum=512
    )
    size: tuple[int, int] = option((1200, 900), help="width and height", unit="pixels", minimum=16, maximum=8192)
    azimuth: float = option(-60.0, help="direction of view around z", unit="degrees", minimum=-360, maximum=360)
    elevation: float = option(
        25.0, help="height of the view above the xy plane", unit="degrees", minimum=-90, maximum=90
    )
    section: float | None = option(
        None, help="keep only this share along y, the far side, to look inside", above=0, maximum=1
    )

    def estimate(self, palette: Palette, what: Size) -> Size:
        pixels, n, tiles, share = float(self.size[0] * self.size[1]), self.resolution, 1.0, self.section or 1.0
        if what.triangles:
            return Size(pixels=pixels, triangles=what.triangles)
        body = what.body
        if what.cells > body.volume:  # a sheet of a tile set
            tiles, pixels = min(what.cells, MOST_TILES), 300.0 * 270
        while n > 4 and body.samples(n) * share > MOST_SAMPLES:
            n -= 1
        grid, shown = what.grid(n), share * tiles
        return Size(
            pixels=tiles * pixels, triangles=shown * body.triangles(n), samples=shown * grid.samples,
            sums=shown * grid.sums, resident=share * grid.samples,
        )  # fmt: skip

    def run(self, context: Context, what: SurfaceMesh | ScalarField | TileSet) -> None:
        """Render and write."""
        from PIL import Image

        if isinstance(what, TileSet):
            picture = self._sheet(context, what)
        elif isinstance(what, SurfaceMesh):
            from sppm_pipeline.render.mesh_view import render_mesh

            picture = render_mesh(what.vertices, what.faces, camera=self._camera(), size=self.size)
        else:
            picture = self._field(context, what)
        Image.fromarray(picture).save(context.output(self.path))

    def _camera(self) -> Camera:
        from sppm_pipeline.render.camera import Camera

        return Camera(azimuth=self.azimuth, elevation=self.elevation)

    def _field(self, context: Context, field: ScalarField) -> NDArray[np.uint8]:
        """The surface of a field on as fine a grid as the picture needs."""
        from sppm_pipeline.render.mesh_view import render_field

        low, high = np.zeros(3), np.array(field.cells, float)
        if isinstance(field, Part):
            edge = field.physical_edge()
            low = (field.domain.lower - field.origin_mm) / edge
            high = (field.domain.upper - field.origin_mm) / edge
        if self.section is not None:
            low[1] = high[1] - self.section * (high[1] - low[1])
        n = self.resolution
        while n > 4 and np.prod((high - low) * n + 1) > MOST_SAMPLES:
            n -= 1
        first, last = np.floor(low * n + 1e-6).astype(int), np.ceil(high * n - 1e-6).astype(int)
        nx, ny, nz = (int(v) for v in last - first + 1)
        x, y, z = (float(v) / n for v in first)
        grid = Grid((x, y, z), (1 / n,) * 3, (nx, ny, nz))
        if isinstance(field, Part):
            inner, outer = field.sample_apart(grid, context.threads)
            return render_field(inner, outer, grid, camera=self._camera(), size=self.size)
        return render_field(field.sample(grid, context.threads), None, grid, camera=self._camera(), size=self.size)

    def _sheet(self, context: Context, tileset: TileSet) -> NDArray[np.uint8]:
        """All tiles, each with its porosity."""
        from sppm_pipeline.render.mesh_view import render_field
        from sppm_pipeline.render.sheets import contact_sheet

        pictures, labels = [], []
        c = tileset.palette_colors
        shown = min(tileset.micro.interiors, MOST_TILES)
        for t in range(shown):
            colors = (t // c**2, t // c % c, t % c) if tileset.kind == "wang" else (0, 0, 0)
            grid = cell_nodes(self.resolution)
            values = tileset.micro.alone(t, colors).sample(grid, context.threads)
            pictures.append(render_field(values, None, grid, camera=self._camera(), size=(300, 270)))
            share = f"  {tileset.porosity[t]:.1%}" if t < len(tileset.porosity) else ""
            name = "".join("xyz"[a] + str(colors[a] + 1) for a in range(3)) if tileset.kind == "wang" else str(t)
            labels.append(name + share)
            context.progress(t + 1, shown, "tiles drawn")
        return contact_sheet(pictures, labels, columns=9 if len(pictures) > 16 else 4)
