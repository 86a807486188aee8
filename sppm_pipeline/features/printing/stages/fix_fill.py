"""``fix.fill``: closed voids too small for a drain are made solid."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import Context, Headline, Length, Palette, Part, Size, Stage, option, options
from sppm_pipeline.errors import ResourceError
from sppm_pipeline.features.printing.print_report import rounded
from sppm_pipeline.method.part.part import coarse_size
from sppm_pipeline.services.arrays import F64, I32
from sppm_pipeline.services.grid import Grid

MAX_VOXELS = 2**27
"""Most voxels of the grid, which is held in memory, some bytes each."""

MAX_LISTED = 1000
"""Filled voids that are listed one by one, the largest first."""

FILL_RADIUS = 0.95
"""Radius of what fills a voxel, in edges of voxels: above the half diagonal of 0.87, so that no gap is left between
voxels, and below 1, so that it reaches the center of no other."""


@dataclass(frozen=True, kw_only=True)
class FixFill(Stage):
    """Make closed voids solid that are too small to be worth a drain, and tell how much solid that adds.

    The part is sampled on a grid; void that opens nowhere across faces of its voxels, and is no larger than `largest`,
    is filled by balls around its voxels, which stay in the part and lose against `drains`. The part is then sampled
    again, by the same check that `fix.drains` uses, and what is still closed is said. Voids finer than a voxel are not
    seen: for those that `check.print` finds, give a `voxel` near to the pitch of the layers.
    """

    name: ClassVar[str] = "fix.fill"
    advice: ClassVar[str] = "give a larger `voxel`"
    headline: ClassVar[tuple[Headline, ...]] = (
        Headline("filled_voids", "filled voids"), Headline("added_mm3", "solid added", "mm^3"),
        Headline("trapped_mm3", "still trapped", "mm^3"),
    )  # fmt: skip

    largest: float = option(1.0, help="closed void up to which it is filled", unit="mm3", above=0, maximum=1e9)
    voxel: Length | None = options.voxel(
        None, minimum=1e-4, note="of the grid; about a hundredth of the part if omitted"
    )
    report: str = options.write_path("fills", note="with fills.json")

    def estimate(self, palette: Palette, part: Size) -> Size:
        return coarse_size(part, self.voxel)

    def run(self, context: Context, part: Part) -> Part:
        """Find, fill, and look again."""
        from sppm_pipeline.features.printing.numerics.routes import find_small_voids

        pitch = self.voxel.mm() if self.voxel is not None else part.coarse_pitch()
        voxels = float(np.prod((part.domain.upper - part.domain.lower) / pitch + 2))
        if voxels > MAX_VOXELS:
            raise ResourceError(
                f"a grid of voxels of {pitch:g} mm has {voxels:.3g} of them, and {MAX_VOXELS} are allowed",
                hint=f"give a `voxel` of {pitch * math.cbrt(voxels / MAX_VOXELS) * 1.01:.2g} mm or more",
            )
        solid, world = part.coarse_solid(context.threads, pitch)
        voxel = pitch**3
        found = find_small_voids(solid, self.largest / voxel)
        made = replace(part, fills=np.concatenate([part.fills, _balls(world, found.runs)]))
        after, _ = made.coarse_solid(context.threads, pitch) if len(found.sizes) else (solid, world)
        left = find_small_voids(after, self.largest / voxel)
        trapped = np.concatenate([left.sizes, left.left])
        context.report(
            filled_voids=len(found.sizes) - len(left.sizes),
            added_mm3=float((int(after.sum()) - int(solid.sum())) * voxel),
            trapped_before_mm3=float((found.sizes.sum() + found.left.sum()) * voxel),
            trapped_mm3=float(trapped.sum() * voxel),
            traps_left=len(trapped),
            grid_mm=pitch,
        )
        if len(left.sizes):
            context.warn(f"{len(left.sizes)} closed voids of up to {self.largest:g} mm3 are still there")
        if len(left.left):
            context.warn(
                f"{len(left.left)} closed voids are larger than `largest`, the largest of "
                f"{left.left[0] * voxel:.4g} mm3: drill them by `fix.drains`"
            )
        self._write(context, found.places, found.sizes * voxel, world)
        return made

    def _write(self, context: Context, places: I32, volumes: NDArray[np.floating], world: Grid) -> None:
        at = np.array(world.origin) + places[:MAX_LISTED, ::-1] * world.spacing
        fills: list[dict[str, Any]] = [
            {"place_mm": rounded(place), "volume_mm3": float(f"{volume:.6g}")}
            for place, volume in zip(at, volumes[:MAX_LISTED].tolist(), strict=True)
        ]
        folder = context.output(self.report)
        folder.mkdir()
        (folder / "fills.json").write_text(json.dumps({"fills": fills}, indent=1) + "\n", encoding="utf-8")


def _balls(world: Grid, runs: I32) -> F64:
    """A capsule for each run of voxels, (m, 7)."""
    first = np.array(world.origin) + runs[:, [2, 1, 0]] * world.spacing
    last = np.array(world.origin) + runs[:, [3, 1, 0]] * world.spacing
    radius = np.full((len(runs), 1), FILL_RADIUS * world.spacing[0])
    return np.concatenate([first, last, radius], 1)
