"""``load.case``: where a part is held, and what pulls at it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline import ConfigError, Context, DesignError, Palette, Size, Stage, SurfaceMesh, option, options
from sppm_pipeline.features.parts.bodies import applied, held_solid, mesh_body
from sppm_pipeline.method.nouns.conditions import FORMS, Condition, LoadCase, LoadCases, condition_of, held_of

ALONG = 48
"""Voxels along the longest side on which conditions are tried before anything is solved."""

MAX_GRAVITY = 1e5
"""Of centrifuges; more is a mistake of units."""


@dataclass(frozen=True, kw_only=True)
class AddLoadCase(Stage):
    """Say where a part is held and what pulls at it; several of these stages make several load cases.

    Conditions are written as ``WHAT on REGION``: ``"0 0 -200 N on plane z at high"``. Regions select the surface of the
    part within a voxel of them: ``plane z at 0 mm`` (or ``at low``, ``at high``), ``box 0 0 0 to 10 10 5 mm``, ``sphere
    0 0 5 radius 3 mm``, ``cylinder z at 12 0 radius 4 mm`` (and ``from 0 to 10``), ``group NAME`` of the mesh, ``#12``,
    ``holes d<6mm`` or ``color red`` of a CAD file, ``near`` for the surface of a second mesh, ``surface`` for all of
    it. Forces are totals, spread by area; stubs of cut struts, on necks that anything which presses on the part would
    bend aside, get none, and the rest of the region takes theirs, so that the moment stays, too. A case without `fix`
    and `symmetry` is held as the one before.

    Regions that touch nothing, rigid motions that nothing prevents, and conditions that contradict each other are
    refused before anything is solved.
    """

    name: ClassVar[str] = "load.case"
    reported: ClassVar[tuple[str, ...]] = ("cases", "weight")

    case: str = option("load", help="name of the case")
    weight: float = option(1.0, help="weight of the case where several are optimized together", above=0, maximum=1e6)
    fix: tuple[str, ...] = option((), help="regions that are held, along all axes or some: 'x y on plane z at 0 mm'")
    symmetry: tuple[str, ...] = option((), help="planes of symmetry, on which nothing moves across: 'plane x at 0 mm'")
    force: tuple[str, ...] = option((), help="total forces, spread over regions by area: '0 0 -200 N on ...'")
    pressure: tuple[str, ...] = option((), help="pressures against the surface: '0.2 MPa on ...'")
    displacement: tuple[str, ...] = option((), help="given displacements: '0 free -1 mm on ...'")
    gravity: tuple[float, float, float] = option(
        (0.0, 0.0, 0.0), help="acceleration along x, y, z", unit="m/s2", minimum=-MAX_GRAVITY, maximum=MAX_GRAVITY
    )
    path: str | None = options.write_path(None, note="a picture of the conditions", suffixes=(".png",))
    image_size: tuple[int, int] = options.image_size((900, 700), note="of one case", minimum=64)

    def check_options(self) -> None:
        """Read all conditions, so that misspelt ones are refused before anything runs."""
        self._conditions(None, None)
        if not (self.force or self.pressure or self.displacement or any(self.gravity)):
            raise ConfigError(
                f"case {self.case!r} has no load", hint="give `force`, `pressure`, `displacement` or `gravity`"
            )

    def _conditions(self, part: SurfaceMesh | None, near: SurfaceMesh | None) -> tuple[Condition, ...]:
        held = [held_of(text, part, near) for text in self.fix]
        held += [held_of(text, part, near, normal=True) for text in self.symmetry]
        kinds = {"displacement": self.displacement, "force": self.force, "pressure": self.pressure}
        return (*held, *(condition_of(kind, text, part, near) for kind, texts in kinds.items() for text in texts))

    def estimate(self, palette: Palette, part: Size, cases: Size | None, near: Size | None = None) -> Size:
        count = 1.0 if cases is None else 1 + cases.cells
        box = (1.0,) * 3 if part.geometry is None else part.geometry.box
        voxels = math.prod(max(1.0, ALONG * side / max(box)) for side in box)
        return Size(samples=27 * voxels, cells=count, resident=voxels, geometry=part.geometry)

    def run(
        self, context: Context, part: SurfaceMesh, cases: LoadCases | None, near: SurfaceMesh | None = None
    ) -> LoadCases:
        """Read the conditions, try them on coarse voxels of the part, and add the case to those before."""
        before = () if cases is None else cases.cases
        conditions = self._conditions(part, near)
        if not (self.fix or self.symmetry) and before:
            conditions = (*before[-1].held, *conditions)
        if any(one.name == self.case for one in before):
            raise ConfigError(f"there are two cases {self.case!r}", hint="give this one another name by `case`")
        case = LoadCase(self.case, self.weight, conditions, self.gravity)
        longest = float((part.upper - part.lower).max())
        shared = mesh_body(part, longest / ALONG)
        body = shared.body
        if not body.solid.any():
            raise DesignError(
                f"the mesh {part.name!r} has no inside", hint=f"it needs a closed surface; regions: {FORMS}"
            )
        found = applied(body, case, shared.share)
        held_solid(body, case, found.fixed, drop=False)
        context.report(weight=self.weight)
        made = LoadCases((*before, case))
        if self.path is not None:
            from PIL import Image

            from sppm_pipeline.features.parts.pictures import conditions_picture

            shown = [(one.name, applied(body, one, shared.share)) for one in made.cases]
            Image.fromarray(conditions_picture(body, shown, self.image_size)).save(context.output(self.path))
        return made
