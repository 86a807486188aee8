"""``check.connectivity``: the connected components of solid and void."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sppm_pipeline import Context, Headline, Rejected, ScalarField, Stage, Tiling, option, options
from sppm_pipeline.method.connectivity.removal import check_removal, removal_warning
from sppm_pipeline.method.fields.level_field import LevelField
from sppm_pipeline.method.fields.scalar_field import CleanedField
from sppm_pipeline.services.grid import cell_centers


@dataclass(frozen=True, kw_only=True)
class CheckConnectivity(Stage):
    """Report, for solid and void, the components, whether the largest runs through in x, y and z, and the rest.

    A periodic cell is labeled on the torus, where opposite faces are one; so removing everything but the largest
    component keeps it periodic. The paper labels without wrapping and calls a cell erroneous if a component that had
    to be removed touches its surface; that is ``islands: reject``, to be used inside ``tune.retry``. With ``islands:
    auto`` a structure of which 10 % of the solid or more is disconnected is rejected, too.

    Of cells that were laid from pores and tunnels the parts of their graph are counted, too. At the center of every
    pore and along the axis of every tunnel the sum of the kernels is at least 1, above any level that is below 1: one
    part proves, without voxels, that all pores and tunnels are one void, with the cells around the box taken along.
    """

    name: ClassVar[str] = "check.connectivity"
    headline: ClassVar[tuple[Headline, ...]] = (
        Headline("solid_components", "components of the solid"), Headline("void_components", "of the void"),
        Headline("solid_removed_share", "share of disconnected solid"), Headline("porosity"),
        Headline("porosity_without_islands", "without it"),
    )  # fmt: skip
    reported: ClassVar[tuple[str, ...]] = (
        "solid_components", "solid_wraps.#3", "solid_removed_share", "void_components", "void_wraps.#3",
        "void_removed_share", "porosity", "porosity_without_islands", "islands_at_surface", "graph_parts",
    )  # fmt: skip

    resolution: int = options.resolution(48, minimum=4, maximum=512)
    islands: str = options.islands(
        "auto",
        note="reject refuses a cell as the paper does, keep only reports it",
        choices=("auto", "remove", "reject", "keep"),
    )
    bicontinuous: bool = option(False, help="reject a structure whose solid or void does not run through in x, y and z")

    def run(self, context: Context, field: ScalarField) -> ScalarField:
        """Label both phases; the result is the field, without islands if they are removed."""
        from sppm_pipeline.method.connectivity.components import phase_report
        from sppm_pipeline.method.connectivity.islands import keep_largest, loose_parts
        from sppm_pipeline.method.tiling.lattice import dilated

        n = self.resolution
        solid = field.solid(cell_centers(n, field.cells), context.threads).T
        periodic = (field.periodic,) * 3
        phases = {zeros: phase_report(solid, periodic, 6, zeros=zeros) for zeros in (False, True)}
        for zeros, report in phases.items():
            phase = "void" if zeros else "solid"
            context.report(
                **{
                    f"{phase}_components": report.components,
                    f"{phase}_wraps": list(report.wraps),
                    f"{phase}_removed_share": report.removed_share,
                }
            )
        share = phases[False].removed_share
        porosity = 1 - float(solid.mean())
        after = porosity + share * (1 - porosity)
        context.report(porosity=porosity, porosity_without_islands=after)
        if (parts := _graph_parts(field)) is not None:
            context.report(graph_parts=parts)
        if self.islands == "reject":
            loose = loose_parts(solid)
            context.report(islands_at_surface=loose.at_boundary)
            if loose.at_boundary:
                raise Rejected(f"{loose.at_boundary} islands lie at the surface of the cell")
        if self.bicontinuous and not all(all(report.wraps) for report in phases.values()):
            raise Rejected("solid and void do not both run through in x, y and z")
        if self.islands == "keep":
            return field
        check_removal(share, self.islands, (porosity, after), finer="a finer `resolution`", error=Rejected)
        if warning := removal_warning(share, (porosity, after)):
            context.warn(warning)
        kept = keep_largest(solid, periodic)
        if (kept == solid).all():
            return field
        # voxels of what stays may touch an island across an edge or a corner
        beside = dilated(solid != kept, field.periodic) & (kept == 0)
        return CleanedField(field, beside.view(np.uint8), n)


def _graph_parts(field: ScalarField) -> int | None:
    """Connected parts of the pores and tunnels of a layout; None of other fields, and of levels that reach 1."""
    from sppm_pipeline.method.connectivity.laid_graph import parts_of_layout

    level = 0.0
    while isinstance(field, (LevelField, CleanedField)):
        if isinstance(field, LevelField):
            level = math.exp(float(field.control.max())) if field.additive else math.inf
        field = field.base
    if not (isinstance(field, Tiling) and field.additive and max(level, field.solid_below) < 1):
        return None
    graph = field.tileset.micro.graph
    pores = graph.pores
    return parts_of_layout(pores.piece, graph.edges, graph.shift, pores.interiors, pores.colors, field.arrays)
