"""``crush.voxel``: a block of voxels is compressed to large strains."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from sppm_crushing.compression import CrushedBody
from sppm_crushing.crusher import Crusher
from sppm_pipeline import Context, Headline, Palette, ScalarField, Size, Voxels


@dataclass(frozen=True, kw_only=True)
class CrushVoxel(Crusher):
    """Compress a block between two plates to large strains, and record stress and energies (paper, section 3.3).

    Voxels are trilinear bricks at finite strain, hyperelastic or plastic with isotropic hardening; walls that meet
    push each other away. An explicit march in time: the plates are slow against waves, and the balance of energy says
    whether slowly enough. A field is cut so that the voxels have its porosity; voxels are whole or void. Phases of an
    image have materials of their own.

    With `failure` the solid breaks by a crack band: from the peak on the stress of a voxel falls so that the work to
    failure per area of a crack is `fracture_energy`, whatever the size of voxels, with that of a voxel's edge for the
    width of the crack. Voxels in which the stress would snap back are refused. A voxel that bears no more than 2 % is
    released; fragments still touch. By `rankine` it is damage that weakens a voxel in all directions, also
    under later compression.

    No viscosity, no rate effects.
    """

    name: ClassVar[str] = "crush.voxel"
    reported: ClassVar[tuple[str, ...]] = ("steps", "elements")
    headline: ClassVar[tuple[Headline, ...]] = (
        Headline("numbers.plateau", "plateau stress", "{unit}"), Headline("numbers.work", "work per volume", "{unit}"),
        Headline("numbers.relative_density", "relative density"), Headline("numbers.unbalanced", "unbalanced"),
    )  # fmt: skip

    def estimate(self, palette: Palette, source: Size) -> Size:
        return self.crushing(source)

    def run(self, context: Context, source: ScalarField | Voxels) -> CrushedBody:
        """Crush."""
        return self.crush(context, source)
