"""Parts within a second: scattered cells of which one block is drawn and repeated, and sizes measured coarsely."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, TypeVar

import numpy as np

from sppm_pipeline.engine.plan.wiring import Step
from sppm_pipeline.method.families.tiler import at_porosity, designed, lattice_for, without_faces
from sppm_pipeline.method.fields.scalar_field import ScalarField
from sppm_pipeline.method.fields.tiling import Tiling
from sppm_pipeline.method.nouns.cell_sizes import CellSizes
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.method.stages.fill_implicit import ImplicitFill
from sppm_pipeline.method.stages.tile_scattered import ScatteredTiling, check_reach
from sppm_pipeline.nouns.palette import Blocks, Maps, Palette
from sppm_pipeline.stage import Context, Recipe, Stage

BLOCK = 3
"""Cells along the edge of the block that is drawn: 27 cells take some tenths of a second, and no view shows more than
nine of its copies at a glance. With 2 the copies are seen."""

COARSE_SIZES = 32
"""Voxels along an edge of the one cell on which sizes are searched, within some percent."""

MEASURED = 12
"""Voxels along a cell edge on which the porosity is measured, within 0.5 %."""

FEW = 100
"""Cells up to which the porosity is that of the part: of more, all cells of the block are as frequent."""


@dataclass(frozen=True, kw_only=True)
class BlockTiling(ScatteredTiling):
    """The same pores in every block of 3 x 3 x 3 cells, in place of pores that nowhere repeat."""

    name: ClassVar[str] = "tile.scattered"

    def run(
        self, context: Context, recipe: Recipe, cover: SurfaceMesh | None, grading: Maps | None = None,
        design: CellSizes | None = None,
    ) -> Tiling:  # fmt: skip
        """Throw and join the pores of one block that meets itself, and lay it over the part."""
        self = designed(self, design)
        lattice = lattice_for(self.cell, self.cells, cover, None)
        blocks = Blocks(np.ones((BLOCK,) * 3, bool), True)
        micro = self.drawn(context, recipe, Palette(BLOCK**3, (0, 0, 0), blocks=blocks), "scattered")
        check_reach(micro)
        edge = lattice.edge if lattice.edge is not None else micro.edge_mm
        many = int(lattice.mask.sum()) > FEW
        if self.porosity is not None and many:
            block = without_faces(micro, blocks, 0, edge, lattice.origin)
            micro = at_porosity(context, block, None, self.porosity, MEASURED).tileset.micro
        shape = [n + 2 for n in lattice.mask.shape]
        laid = np.ix_(*((np.arange(n) - 1) % BLOCK for n in shape))
        everywhere = Blocks(np.ones(shape, bool), False)
        whole = without_faces(micro, everywhere, 1, edge, lattice.origin)
        made = replace(whole, arrays=whole.arrays._replace(interior=blocks.numbers[laid]))
        return made if self.porosity is None or many else at_porosity(context, made, cover, self.porosity, MEASURED)


@dataclass(frozen=True, kw_only=True)
class QuickFill(ImplicitFill):
    """The part as it is cut, of which nothing is measured: a border would be evaluated on a grid of its own."""

    name: ClassVar[str] = "fill.implicit"

    def run(
        self, context: Context, field: ScalarField, domain: SurfaceMesh, skin_near: SurfaceMesh | None = None
    ) -> Part:
        """Put the two together."""
        return replace(self, border="cut", thinnest=None).filled(context, field, domain, skin_near)


def quick_steps(steps: Sequence[Step]) -> tuple[Step, ...] | None:
    """The steps up to the first that makes a part, with quick stages in their places; None if that is not known.

    Known are pores that are scattered alike everywhere: a map changes them from cell to cell.
    """
    made: list[Step] = []
    for step in steps:
        stage: Any = step.stage
        if type(stage) is ScatteredTiling:
            if step.inputs.get("grading") is not None or stage.cells is not None:
                return None
            stage = _as(BlockTiling, stage)
        elif type(stage) is ImplicitFill:
            made.append(replace(step, stage=_as(QuickFill, stage)))
            return tuple(made) if any(type(one.stage) is BlockTiling for one in made) else None
        elif stage.name == "design.sizes":
            stage = replace(stage, draws=1, resolution=COARSE_SIZES)
        made.append(replace(step, stage=stage))
    return None


S = TypeVar("S", bound=Stage)


def _as(kind: type[S], stage: Stage) -> S:
    """A stage of another class with the same options."""
    return kind(**{one.name: getattr(stage, one.name) for one in fields(stage)})
