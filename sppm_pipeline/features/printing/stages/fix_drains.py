"""``fix.drains``: holes through which trapped void opens, each of them checked."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import ConfigError, Context, Headline, Length, Palette, Part, Size, Stage, option, options
from sppm_pipeline.features.printing.print_report import rounded
from sppm_pipeline.method.part.part import coarse_size
from sppm_pipeline.services.grid import Grid

LOW = 3
"""Layers of the grid above the lowest void of a trap up to which a hole vents it while it is printed; higher up it
would suck until the hole is reached."""

LOW_COSTS = 3.0
"""A low hole may go through so many times the solid that the shortest one goes through: a choice."""

Drain = tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class FixDrains(Stage):
    """Drill holes until no resin is trapped, and list them; a hole is kept only if what it was drilled for is open.

    The part is sampled on a coarse grid. For each closed void, the largest first, the way out through the least solid
    is searched; one near the lowest place of the void is preferred, as it also lets air in while the part is printed
    there, and none leaves through the build plate. The straightened way becomes a drain of the part, which wins over
    skin and microstructure. Beside the list, the holes are written as a mesh, for plugs.
    """

    name: ClassVar[str] = "fix.drains"
    headline: ClassVar[tuple[Headline, ...]] = (
        Headline("holes"), Headline("trapped_before_mm3", "trapped before", "mm^3"),
        Headline("trapped_mm3", "now", "mm^3"),
    )  # fmt: skip

    diameter: Length = option(Length(1.5), help="diameter of the holes", unit="mm", above=0, maximum=1e3)
    most: int = option(6, help="maximum number of holes", minimum=1, maximum=1000)
    smallest: float = option(1.0, help="closed void that is worth a hole", unit="mm3", minimum=0, maximum=1e9)
    report: str = options.write_path("drains", note="with drains.json and plugs.stl")

    def estimate(self, palette: Palette, part: Size) -> Size:
        return coarse_size(part)

    def run(self, context: Context, part: Part) -> Part:
        """Drill, look again, and drill the next."""
        from sppm_pipeline.features.printing.numerics.routes import find_traps
        from sppm_pipeline.method.connectivity.components import find_components
        from sppm_pipeline.method.part.capsules import depths_in_capsules

        solid, world = part.coarse_solid(context.threads)
        if self.diameter.mm() < world.spacing[0]:
            raise ConfigError(
                f"holes of {self.diameter.mm():g} mm are narrower than the voxels on which they are checked, "
                f"{world.spacing[0]:.3g} mm",
                hint="give a larger `diameter`; resin wants a millimeter or more",
            )
        voxel = world.spacing[0] ** 3
        before = traps = find_traps(solid)
        pieces = _pieces(find_components(solid, (False,) * 3, 6).sizes)
        holes: list[dict[str, Any]] = []
        given_up = set()
        while len(holes) < self.most:
            worth = [
                i for i, n in enumerate(traps.sizes) if n * voxel >= self.smallest and _place(traps, i) not in given_up
            ]
            if not worth:
                break
            drain = self._drain(solid, world, traps, worth[0])
            place = _place(traps, worth[0])
            drilled = solid.copy()
            for window, depth in depths_in_capsules(world, [drain] if drain else []):
                drilled[window][depth > 0] = 0
            found = find_traps(drilled)
            if drain is None or found.labels[place] != 1:
                given_up.add(place)
                continue
            holes.append({
                "from_mm": rounded(np.array(drain[:3])), "to_mm": rounded(np.array(drain[3:6])),
                "diameter_mm": 2 * drain[6], "drains_mm3": float(f"{traps.sizes[worth[0]] * voxel:.6g}"),
                "capsule": list(drain),
            })  # fmt: skip
            solid, traps = drilled, found
        context.report(
            holes=len(holes),
            trapped_before_mm3=float(before.sizes.sum() * voxel),
            trapped_mm3=float(traps.sizes.sum() * voxel),
            traps_left=int((traps.sizes * voxel >= self.smallest).sum()),
            grid_mm=world.spacing[0],
        )
        if left := int((traps.sizes * voxel >= self.smallest).sum()):
            why = "no hole opens them" if len(holes) < self.most else f"`most` allows {self.most} holes"
            context.warn(
                f"{left} closed voids of {self.smallest:g} mm3 or more are left, the largest of "
                f"{traps.sizes.max() * voxel:.4g} mm3: {why}"
            )
        if (now := _pieces(find_components(solid, (False,) * 3, 6).sizes)) > pieces:
            context.warn(f"the holes cut the solid: {now} pieces of a hundredth of it or more, {pieces} before")
        self._write(context, holes)
        return replace(part, drains=(*part.drains, *(tuple(hole["capsule"]) for hole in holes)))

    def _drain(self, solid: NDArray[np.uint8], world: Grid, traps: Any, which: int) -> Drain | None:
        """A capsule that opens a trap by the way through the least solid, or by one nearly as short low down."""
        from sppm_pipeline.features.printing.numerics.routes import way_out

        ground = int(np.flatnonzero(solid.any((1, 2)))[0])
        lowest = int(np.flatnonzero((traps.labels == which + 2).any((1, 2)))[0])
        shortest = way_out(traps, which + 2, ground, len(solid))
        low = way_out(traps, which + 2, ground, lowest + LOW)
        if shortest is None:
            return None
        route = low if low is not None and low.solid <= LOW_COSTS * shortest.solid else shortest
        h = world.spacing[0]
        a, b = (np.array(world.origin) + h * np.array(end[::-1]) for end in (route.start, route.end))
        beyond = h * (b - a) / np.linalg.norm(b - a)
        return (*(a - beyond).tolist(), *(b + beyond).tolist(), self.diameter.mm() / 2)

    def _write(self, context: Context, holes: list[dict[str, Any]]) -> None:
        from sppm_pipeline.method.part.primitive_meshes import cylinder_mesh
        from sppm_pipeline.services.formats import stl

        folder = context.output(self.report)
        folder.mkdir()
        (folder / "drains.json").write_text(json.dumps({"drains": holes}, indent=1) + "\n", encoding="utf-8")
        vertices: list[NDArray[np.float64]] = []
        faces: list[NDArray[np.int32]] = []
        for hole in holes:
            a, b = np.array(hole["capsule"][:3]), np.array(hole["capsule"][3:6])
            points, triangles = cylinder_mesh((0.0, 0.0, 0.0), hole["diameter_mm"] / 2, float(np.linalg.norm(b - a)))
            faces.append(triangles + sum(len(own) for own in vertices))
            vertices.append(points @ _frame(b - a) + (a + b) / 2)
        if holes:
            data = b"".join(stl.encode(np.concatenate(vertices), np.concatenate(faces)))
            (folder / "plugs.stl").write_bytes(data)


def _place(traps: Any, which: int) -> tuple[int, int, int]:
    """The first voxel of a trap, by which it is known again."""
    z, y, x = np.unravel_index(int(np.argmax(traps.labels == which + 2)), traps.labels.shape)
    return int(z), int(y), int(x)


def _pieces(sizes: NDArray[np.int64]) -> int:
    """Components that hold a hundredth of the phase."""
    return int(np.count_nonzero(100 * sizes >= sizes.sum()))


def _frame(along: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows: three directions at right angles, the last one along a vector."""
    z = along / np.linalg.norm(along)
    x = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
    x /= np.linalg.norm(x)
    return np.array([x, np.cross(z, x), z])
