"""``fix.drains``: holes through which trapped void opens, each of them checked."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from sppm_pipeline import Length, Palette, Part, Size, SurfaceMesh, options
from sppm_pipeline.errors import ConfigError
from sppm_pipeline.features.printing.numerics.routes import (
    AMBIENT,
    borings,
    drain_candidates,
    find_traps,
    loose_voxels,
    points_within,
    signed_depths,
    unit,
)
from sppm_pipeline.features.printing.print_pictures import drains_sheet
from sppm_pipeline.features.printing.print_report import rounded
from sppm_pipeline.method.part.part import coarse_size
from sppm_pipeline.services.arrays import F32, F64, I32
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.stage import Context, Headline, Stage, option

if TYPE_CHECKING:
    from sppm_pipeline.features.printing.numerics.routes import Candidates, Traps

HEIGHT_COSTS = 0.25
"""Millimeters of solid that a hole may go through to begin a millimeter lower: resin runs out of low holes, and air
comes in through them while the part is printed. At half of it holes move up where the skin is thinner."""

HIDDEN_COSTS = 0.5
"""The same for a hole that faces away from `toward`, for each millimeter of the part: twice what height can cost."""

TRIES = 60
"""Places that are drilled on the grid for a void before it is given up, a heuristic: a bound on the time, as each takes
two searches for components of the grid. Half as many give up more voids, twice as many take up to twice the time."""

SMALLEST_SHARE = 2e-3
"""Of the void that is sealed before; what is less stays as a drop that no hole is worth."""

Drain = tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class FixDrains(Stage):
    """Drill holes until no resin is trapped, and list them; a hole is kept only if what it was drilled for is open.

    The part is sampled on a coarse grid. For each closed void, the largest first, a hole is drilled straight in from
    the surface, where it goes through little solid, low in the part. No hole comes nearer than `clear` to a sharp edge,
    to a hole that the part has (a concave cylinder or cone), or to the build plate, nor nearer than `keep_out_within`
    to the mesh at the port `keep_out`; none runs along below another face, and none cuts a piece of the solid off. The
    holes become drains of the part, which win over skin and microstructure. Beside the list, they are written as a
    mesh, for plugs, and drawn.
    """

    name: ClassVar[str] = "fix.drains"
    version: ClassVar[int] = 2
    headline: ClassVar[tuple[Headline, ...]] = (
        Headline("holes"), Headline("trapped_before_mm3", "trapped before", "mm^3"),
        Headline("trapped_mm3", "now", "mm^3"),
    )  # fmt: skip

    diameter: Length = option(Length(1.5), help="diameter of the holes", unit="mm", above=0, maximum=1e3)
    clear: Length | None = option(
        None, help="distance of their rims from edges, holes and the build plate; `diameter` if omitted",
        unit="mm", minimum=0, maximum=1e3,
    )  # fmt: skip
    keep_out_within: Length | None = option(
        None, help="distance of drains from the mesh at `keep_out`", unit="mm", minimum=0, maximum=1e3
    )
    keep_out_faces: tuple[str, ...] = option(
        (), help="groups of the part, or faces of a CAD file such as 'color red', that drains keep this far from, too; "
        "`clear` if no distance is given",
    )  # fmt: skip
    toward: tuple[float, float, float] | None = option(
        None, help="direction [x, y, z] in which holes should open, such as that of a side that is not seen",
        minimum=-1e6, maximum=1e6,
    )  # fmt: skip
    most: int = option(6, help="maximum number of holes", minimum=1, maximum=1000)
    smallest: float | None = option(
        None, help="closed void that is worth a hole; 0.2 % of all that is closed if omitted", unit="mm3",
        minimum=0, maximum=1e9,
    )  # fmt: skip
    report: str = options.write_path("drains", note="with drains.json, drains.png and plugs.stl")

    def check_options(self) -> None:
        if self.toward is not None and not any(self.toward):
            raise ConfigError("`toward` is 0 along all axes, which is no direction")

    def estimate(self, palette: Palette, part: Size, keep_out: Size | None = None) -> Size:
        return coarse_size(part)

    def run(self, context: Context, part: Part, keep_out: SurfaceMesh | None = None) -> Part:
        """Drill, look again, and drill the next."""
        from sppm_pipeline.method.connectivity.components import find_components
        from sppm_pipeline.method.nouns.named_faces import named_triangles
        from sppm_pipeline.method.part.capsules import depths_in_capsules
        from sppm_pipeline.method.part.inside import inside_layers, prepare_inside

        solid, world = part.coarse_solid(context.threads)
        radius = self.diameter.mm() / 2
        if 2 * radius < world.spacing[0]:
            raise ConfigError(
                f"holes of {2 * radius:g} mm are narrower than the voxels on which they are checked, "
                f"{world.spacing[0]:.3g} mm",
                hint="give a larger `diameter`; resin wants a millimeter or more",
            )
        clear = 2 * radius if self.clear is None else self.clear.mm()
        keep_out_mm = clear if self.keep_out_within is None else self.keep_out_within.mm()
        zone = None
        if self.keep_out_faces:
            zone = part.domain.vertices[part.domain.faces[named_triangles(part.domain, self.keep_out_faces)]]
        # an open port takes the nearest mesh, which is mostly the part itself
        if keep_out is not None and np.array_equal(keep_out.vertices, part.domain.vertices):
            keep_out = None
        if self.keep_out_within is not None:
            if keep_out is None and zone is None:
                raise ConfigError(
                    "`keep_out_within` is a distance from a mesh, and none is wired to the port `keep_out`",
                    hint="read it by a stage with an id, and say from: {part: PART, keep_out: ID}; or give "
                    "`keep_out_faces`",
                )
            if keep_out is not None:
                others = keep_out.vertices[keep_out.faces]
                zone = others if zone is None else np.concatenate([zone, others])
        voxel = world.spacing[0] ** 3
        before = traps = find_traps(solid)
        smallest = SMALLEST_SHARE * float(before.sizes.sum()) * voxel if self.smallest is None else self.smallest
        holes: list[dict[str, Any]] = []
        given_up: set[tuple[int, int, int]] = set()
        places = -1
        if (before.sizes * voxel >= smallest).any():
            found = drain_candidates(part.domain, radius, clear, None if zone is None else (zone, keep_out_mm))
            places = len(found.points)
            domain = prepare_inside(part.domain.vertices, part.domain.faces, world, part.method)
            depths = signed_depths(inside_layers(domain, 0, len(solid)).mask, world.spacing[0])
        loose = loose_voxels(find_components(solid, (False,) * 3, 6).sizes)
        while places > 0 and len(holes) < self.most:
            worth = [i for i, n in enumerate(traps.sizes) if n * voxel >= smallest and _place(traps, i) not in given_up]
            if not worth:
                break
            place = _place(traps, worth[0])
            for drain in self._drains(part, found, traps, worth[0], depths, world, holes):
                drilled = solid.copy()
                for window, depth in depths_in_capsules(world, [drain]):
                    drilled[window][depth > 0] = 0
                now = find_traps(drilled)
                left = loose_voxels(find_components(drilled, (False,) * 3, 6).sizes)
                if now.labels[place] == AMBIENT and left <= loose:
                    break
            else:
                given_up.add(place)
                continue
            holes.append({
                "from_mm": rounded(np.array(drain[:3])), "to_mm": rounded(np.array(drain[3:6])),
                "diameter_mm": 2 * radius, "drains_mm3": float(f"{traps.sizes[worth[0]] * voxel:.6g}"),
                "capsule": list(drain),
            })  # fmt: skip
            solid, traps, loose = drilled, now, left
        remaining = int((traps.sizes * voxel >= smallest).sum())
        context.report(
            holes=len(holes), trapped_before_mm3=float(before.sizes.sum() * voxel),
            trapped_mm3=float(traps.sizes.sum() * voxel), traps_left=remaining, smallest_mm3=smallest, clear_mm=clear,
            grid_mm=world.spacing[0],
        )  # fmt: skip
        if remaining:
            why = f"`most` allows {self.most} holes"
            if places == 0:
                why = (
                    f"all of the surface is nearer than {clear:g} mm to edges, holes or the plate; give a lower `clear`"
                )
            elif len(holes) < self.most:
                why = f"no hole that keeps {clear:g} mm from edges, holes and faces opens them; try a lower `clear`"
            context.warn(
                f"{remaining} closed voids of {smallest:.3g} mm3 or more are left, the largest of "
                f"{traps.sizes.max() * voxel:.4g} mm3: {why}"
            )
        self._write(context, part, holes)
        return replace(part, drains=(*part.drains, *(tuple(hole["capsule"]) for hole in holes)))

    def _drains(
        self,
        part: Part,
        candidates: Candidates,
        traps: Traps,
        which: int,
        depths: F32,
        world: Grid,
        holes: list[dict[str, Any]],
    ) -> Iterator[Drain]:
        """Capsules that lead into a trap, the best first."""
        lowest = world.axis(2)[np.flatnonzero((traps.labels == which + 2).any((1, 2)))[0]]
        costs = HEIGHT_COSTS * np.maximum(0.0, candidates.points[:, 2] - lowest)
        if self.toward is not None:
            extent = float(np.max(part.domain.upper - part.domain.lower))
            costs += HIDDEN_COSTS * extent * (1 + candidates.inwards @ unit(self.toward)) / 2
        for drilled in holes:  # a bridge stays between two holes
            own = np.array(drilled["capsule"]).reshape(1, 7)
            axis = own[:, [0, 1, 2, 3, 4, 5, 3, 4, 5]].reshape(1, 3, 3)
            costs[points_within(candidates.points, axis, 2 * candidates.radius + candidates.clear)] = np.inf
        capsules = borings(candidates, traps, which + 2, depths, world, costs)
        return islice((tuple(capsule.tolist()) for capsule in capsules if candidates.keeps_clear(capsule)), TRIES)

    def _write(self, context: Context, part: Part, holes: list[dict[str, Any]]) -> None:
        from PIL import Image

        from sppm_pipeline.method.part.primitive_meshes import cylinder_mesh
        from sppm_pipeline.services.formats import stl

        folder = context.output(self.report)
        folder.mkdir()
        (folder / "drains.json").write_text(json.dumps({"drains": holes}, indent=1) + "\n", encoding="utf-8")
        vertices: list[F64] = []
        faces: list[I32] = []
        for hole in holes:
            a, b = np.array(hole["capsule"][:3]), np.array(hole["capsule"][3:6])
            points, triangles = cylinder_mesh((0.0, 0.0, 0.0), hole["diameter_mm"] / 2, float(np.linalg.norm(b - a)))
            faces.append(triangles + sum(len(own) for own in vertices))
            vertices.append(points @ _frame(b - a) + (a + b) / 2)
        if holes:
            plugs = np.concatenate(vertices), np.concatenate(faces)
            Image.fromarray(drains_sheet(part.domain, *plugs)).save(folder / "drains.png")
            data = b"".join(stl.encode(*plugs))
            (folder / "plugs.stl").write_bytes(data)


def _place(traps: Any, which: int) -> tuple[int, int, int]:
    """The first voxel of a trap, by which it is known again."""
    z, y, x = np.unravel_index(int(np.argmax(traps.labels == which + 2)), traps.labels.shape)
    return int(z), int(y), int(x)


def _frame(along: F64) -> F64:
    """Rows: three directions at right angles, the last one along a vector."""
    z = along / np.linalg.norm(along)
    x = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
    x /= np.linalg.norm(x)
    return np.array([x, np.cross(z, x), z])
