"""``write.view``: what a browser needs to show a structure live."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline import Context, Palette, ScalarField, Size, Stage, TileSet, Viewable, option, options
from sppm_pipeline.features.browser.live.page import head_of
from sppm_pipeline.features.browser.live.views import SAMPLES, view_of


@dataclass(frozen=True, kw_only=True)
class WriteView(Stage):
    """Write the live view that ``sppm report`` shows: a cell or tile set by its kernels, other fields by samples.

    Of a mesh its triangles are shown, of more than 80,000 fewer with merged vertices; of a volume mesh its boundary, of
    a stiffness the surface of Young's modulus by direction, of any other result the surface that stands for it. Give
    `from` to choose among what earlier stages make.

    Without this stage a report takes the last field of the run from the cache, if it is still there.
    """

    name: ClassVar[str] = "write.view"
    advice: ClassVar[str] = "ask for fewer `grid_samples`"

    path: str = options.write_path("part.view", suffixes=(".view",))
    grid_samples: int = option(
        SAMPLES, help="samples of a field that the browser does not sum itself", minimum=1000, maximum=64_000_000
    )

    def estimate(self, palette: Palette, field: Size) -> Size:
        if field.triangles or field.tetrahedra or field.geometry is None:
            return Size(triangles=field.triangles)
        share = self.grid_samples / max(1.0, field.body.samples(1.0))
        return field.grid(max(1.0, share ** (1 / 3)), voxels=float(self.grid_samples))

    def run(self, context: Context, field: ScalarField | TileSet | Viewable) -> None:
        """Write the file."""
        data = view_of(field, samples=self.grid_samples, threads=context.threads)
        context.output(self.path).write_bytes(data)
        head = head_of(data)
        context.report(bytes=len(data), kind=head["kind"])
        if head["porosity"] is not None:
            context.report(porosity=head["porosity"])
