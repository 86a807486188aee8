"""``homogenize.acoustics``: the sound that a layer of a structure absorbs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sppm_pipeline import Context, DesignError, Length, ScalarField, option, options
from sppm_pipeline.features.flow.acoustics import AcousticReport
from sppm_pipeline.features.flow.stages.homogenize_permeability import FlowHomogenizer

SHIFT = 0.5
"""Voxels by which walls are moved either way to find the viscous length: a heuristic. The error is of second order, so
that half of it would lose only digits of the difference, and twice as much would quadruple the error."""

TIGHTER = 0.01
"""Tolerance of the conductivities over that of the flow: a heuristic, as the length is their difference, some percent
of them. A factor of two changes it as the tolerance of the flow does the permeability."""


@dataclass(frozen=True, kw_only=True)
class HomogenizeAcoustics(FlowHomogenizer):
    """Compute how much sound a layer of a periodic cell absorbs, from the shape of its pores alone.

    Three kinds of solve give the parameters of the model of Johnson, Champoux, Allard, Pride and Lafarge: the slow flow
    (permeability and static viscous tortuosity), the torsion field (their thermal counterparts) and the conductivity of
    the void (tortuosity; and, with walls moved in and out, the viscous length). The solid is rigid, the pores hold air,
    the sound comes straight at a layer on a rigid wall. Straight cylindrical pores, whose absorption is known exactly,
    are met within 0.02.

    The absorption depends on the true size of the pores: the cell needs one, of its own or as `cell`.
    `write.absorption` draws the curve.
    """

    name: ClassVar[str] = "homogenize.acoustics"
    version: ClassVar[int] = 5
    reported: ClassVar[tuple[str, ...]] = ()

    depth: Length = option(Length(50.0), help="thickness of the layer on a rigid wall", unit="mm", above=0, maximum=1e5)
    axis: str = options.axis("z")
    temperature: float = option(20.0, help="of the air", unit="degrees Celsius", minimum=-50, maximum=200)

    def run(self, context: Context, source: ScalarField) -> AcousticReport:
        """Solve for flow, torsion and conduction."""
        edge = self.edge_of(source)
        if edge is None:
            edge = source.physical_edge()
        flow, axis = self.flow_of(context, source), "xyz".index(self.axis)
        if not flow.wraps[axis] or flow.surface is None or flow.thermal_tortuosity is None:
            raise DesignError(
                f"no sound passes along {self.axis}: the void does not percolate",
                hint="take another `axis`, or make the pores larger",
            )
        conducted, porosity = zip(
            *(self._conduction(context, source, step, axis) for step in (-SHIFT, SHIFT)), strict=True
        )
        narrow, wide = conducted
        open_share = 1 - flow.pocket_share
        # porosity over conductivity on both sides of the wall, averaged as the conductivities are
        tortuosity = float(np.mean([open_share * p / max(k, 1e-12) for p, k in zip(porosity, conducted, strict=True)]))
        viscous = flow.viscous_tortuosity[axis]
        assert viscous is not None
        # straight pores have a tortuosity of 1, and rounding errors
        sound = wide > narrow > 0 and tortuosity > 0.98 and viscous > max(1.0, tortuosity)
        if not (sound and flow.thermal_tortuosity > 1):
            raise DesignError(
                f"flow and conduction contradict each other: the static tortuosity is {viscous:.4g}, that of high "
                f"frequencies {tortuosity:.4g}",
                hint="raise `resolution`, or `iterations` if the solver was stopped",
            )
        # Lambda = 2 k / (dk / dxi), from k on both sides of the wall: the wall itself lies midway, so k is their mean
        length = (narrow + wide) * (2 * SHIFT / self.resolution) / (wide - narrow)
        return AcousticReport(
            axis=self.axis, porosity=flow.porosity, permeability=flow.k[axis, axis] * (1e-3 * edge) ** 2,
            thermal_permeability=flow.thermal * (1e-3 * edge) ** 2, tortuosity=max(1.0, tortuosity),
            viscous_tortuosity=viscous, thermal_tortuosity=flow.thermal_tortuosity, viscous_length=length * edge,
            thermal_length=2 * flow.porosity / flow.surface * edge, layer=self.depth.mm(), temperature=self.temperature,
            edge_mm=edge, grid=flow.grid, warnings=flow.warnings,
        )  # fmt: skip

    def _conduction(self, context: Context, source: ScalarField, shift: float, axis: int) -> tuple[float, float]:
        """Relative conductivity of the void along an axis and its porosity, walls moved by so many voxels."""
        from sppm_pipeline.features.flow.numerics.conduction import conductivity
        from sppm_pipeline.numerics import solid_fractions

        x, y, z = (self.resolution * n for n in source.cells)
        solid = solid_fractions(
            lambda grid, start, stop: source.sample_zyx(grid, start, stop, context.threads), (x, y, z), self.resolution,
            shift=shift,
        )  # fmt: skip
        options = self.solver_options(context.threads)
        options["tolerance"] = max(1e-7, TIGHTER * options["tolerance"])
        # a voxel at the wall conducts by the share of it that is open
        found = conductivity(1 - solid, **options)
        return float(found.conductivity[axis, axis]), 1 - float(solid.mean(dtype=np.float64))
