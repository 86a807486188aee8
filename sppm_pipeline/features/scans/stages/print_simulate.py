"""``print.simulate``: what light makes of layers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sppm_pipeline import Context, Headline, Length, Palette, Size, SliceStack, Stage, Voxels, option, options
from sppm_pipeline.engine.process.budget import require_memory


@dataclass(frozen=True, kw_only=True)
class PrintSimulate(Stage):
    """Cure layers as a resin printer does: voxels of what will be built, to be homogenized, measured and compared.

    Light spreads in the plane (a Gaussian) and decays along the height as exp(-depth / D_p), through the layers that
    were printed before (Jacobs 1992). A voxel is solid where the dose of its own layer and of all later ones, in its
    middle, reaches the critical one; one exposure alone reaches the depth C_d = D_p ln(E / E_c). Gray pixels are
    exposed as much less.
    """

    name: ClassVar[str] = "print.simulate"
    headline: ClassVar[tuple[Headline, ...]] = (
        Headline("porosity_exposed", "porosity as exposed"), Headline("porosity", "as cured"),
        Headline("grown", "solid gained, share"),
    )  # fmt: skip
    reported: ClassVar[tuple[str, ...]] = ("porosity_exposed", "porosity", "grown")

    spread: Length = option(help="standard deviation of the light in the plane", unit="mm", minimum=0, maximum=10)
    penetration: Length = options.penetration()
    cure_depth: Length = options.cure_depth()
    beyond: str = option(
        "dark", help="what is beyond the sides of the stack: nothing, or its mirror images, as of a piece of a part",
        choices=("dark", "mirror"),
    )  # fmt: skip

    def estimate(self, palette: Palette, stack: Size) -> Size:
        """Every pixel is blurred once."""
        return Size(pixels=stack.pixels, voxels=stack.pixels, resident=stack.pixels, geometry=stack.geometry)

    def run(self, context: Context, stack: SliceStack) -> Voxels:
        """Expose the layers, and add up the doses from the top down."""
        from scipy.ndimage import gaussian_filter

        nx, ny, nz = stack.shape
        require_memory(
            3.0 * nx * ny * nz, f"curing {nx} x {ny} x {nz} voxels", "take coarser pixels or a smaller part",
            limit=context.memory_limit,
        )  # fmt: skip
        layers = np.empty((nz, ny, nx), np.uint8)
        for start, slab in stack.slabs(context.threads):
            layers[start : start + len(slab)] = slab
        exposed = float(layers.mean(dtype=np.float64)) / 255
        h, depth = stack.layer_mm, self.penetration.mm()
        px, py = stack.pixel_mm
        sigma = self.spread.mm() / py, self.spread.mm() / px
        decay = math.exp(-h / depth)
        # Critical dose over that of one full exposure in the middle of its layer; 1e-35 is any light at all.
        critical = math.exp(min(max((h / 2 - self.cure_depth.mm()) / depth, -80.0), 80.0))
        if critical > 1:
            context.warn(
                f"one exposure cures {self.cure_depth.mm():g} mm, less than half a layer of {h:g} mm: only what later "
                "layers add holds them together"
            )
        dose, mode = np.zeros((ny, nx), np.float32), "constant" if self.beyond == "dark" else "reflect"
        for k in range(nz - 1, -1, -1):
            light = gaussian_filter(layers[k].astype(np.float32), sigma, mode=mode) if max(sigma) else layers[k]
            dose *= np.float32(decay)
            dose += light * np.float32(1 / 255)
            layers[k] = dose >= np.float32(critical)
            context.progress(nz - k, nz, "layers")
        solid = float(layers.mean(dtype=np.float64))
        context.report(porosity_exposed=1 - exposed, porosity=1 - solid, grown=solid / exposed - 1 if exposed else 0.0)
        return Voxels(layers.T, (px, py, h), True, (False,) * 3)
