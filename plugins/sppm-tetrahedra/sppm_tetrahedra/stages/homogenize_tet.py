"""``homogenize.tet``: effective stiffness from tetrahedra that follow the surface."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sppm_pipeline import Context, DesignError, InputError, Stage, option, options
from sppm_pipeline.nouns import StiffnessReport
from sppm_tetrahedra.volume_mesh import VolumeMesh, face_match, loose_parts, matched_nodes

MATCHED_TOLERANCE = 1e-6

LOCKING = 0.49
"""Poisson's ratio above which straight tetrahedra trigger a warning, as bricks do in `homogenize.voxel`."""

MIN_STIFFNESS = 1e-9
"""Stiffness over the mean Young's modulus of the cell below which only rounding is left: a heuristic, as for voxels.
Real structures lie orders of magnitude above, so that a factor of two changes nothing."""


@dataclass(frozen=True, kw_only=True)
class HomogenizeTet(Stage):
    """Homogenize a mesh of tetrahedra, straight or quadratic, that fills the solid of a periodic cell.

    Where opposite faces match node by node, as `mesh.isosurface_stuffing` makes them, periodicity is exact. Other
    meshes are joined by a mortar: displacements on both sides agree in the mean square against the shape functions of
    one of them, which reproduces constant strain exactly. Collocation, which ties nodes to the opposite triangle they
    meet, is there for comparison; it is some tenths of a percent too soft.

    Straight tetrahedra are stiffer than the structure, quadratic ones (`order: 2` of the mesher) much less so.
    """

    name: ClassVar[str] = "homogenize.tet"
    libraries: ClassVar[tuple[str, ...]] = ("pyamg",)
    version: ClassVar[int] = 3
    reported: ClassVar[tuple[str, ...]] = ()
    requires: ClassVar[Mapping[str, tuple[str, str]]] = {
        "mesh": (
            "periodic_box",
            "the box of the cell must be known: give `cell` to `mesh.tetwild`, `periodic: true` to `read.volume_mesh`",
        )
    }
    advice: ClassVar[str] = "mesh with a lower `resolution`, or with `order: 1`"

    young: float | tuple[float, ...] = options.young(1.0, note="or of each material of the mesh")
    poisson: float | tuple[float, ...] = options.poisson(0.3, note="or of each material of the mesh")
    stress_unit: str = options.stress_unit("relative", formerly="unit")
    faces: str = option(
        "auto",
        help="how opposite faces are joined: auto ties nodes where all match, else takes the mortar",
        choices=("auto", "mortar", "collocation"),
    )
    face_tolerance: float = option(
        1e-6, help="how far nodes of a face may lie from the box, over its longest edge", above=0, maximum=0.05
    )
    residual: float = options.residual(1e-6, above=0, minimum=None, maximum=0.01, formerly="tolerance")
    iterations: int = options.iterations(2000)

    def run(self, context: Context, mesh: VolumeMesh) -> StiffnessReport:
        """Solve the six load cases."""
        from sppm_tetrahedra.numerics.tetrahedral import homogenize_tetrahedra

        if mesh.box is None:
            raise InputError(
                f"{mesh.name} fills no periodic cell: its box is not known",
                hint="mesh a cell, or give `periodic: true` to `read.volume_mesh`",
            )
        # matched nodes are joined exactly, without constraints, which is faster and has no error of its own
        young, poisson = self._materials(mesh)
        stand_in = None
        if self.faces == "auto":
            try:
                mismatched = face_match(mesh.nodes, mesh.cells[:, :4], mesh.box, MATCHED_TOLERANCE).mismatched.any()
                stand_in = None if mismatched else matched_nodes(mesh.nodes, mesh.box, MATCHED_TOLERANCE)
            except ValueError:  # nodes closer than the tolerance: which is whose copy is ambiguous
                stand_in = None
        if stand_in is not None and (parts := loose_parts(mesh.nodes, mesh.cells[:, :4], mesh.box, stand_in)):
            raise self._loose(mesh, f", in {parts} loose parts," if parts > 1 else "")
        context.report(joined="nodes" if stand_in is not None else self.faces.replace("auto", "mortar"))
        try:
            found = homogenize_tetrahedra(
                mesh.nodes, mesh.cells, mesh.box, young, poisson, stand_in,
                faces="collocation" if self.faces == "collocation" else "mortar", face_tolerance=self.face_tolerance,
                tolerance=self.residual, iterations=self.iterations,
                progress=lambda done: context.progress(done, 6, "load cases"),
            )  # fmt: skip
        except ValueError as error:
            raise InputError(f"{mesh.name} can't be homogenized: {error}", hint="see `check.volume_mesh`") from error
        self._refuse_loose(mesh, found.stiffness)
        if mesh.cells.shape[1] == 4 and (largest := float(np.max(poisson))) > LOCKING:
            context.warn(
                f"with Poisson's ratio {largest:g} straight tetrahedra lock: the stiffness comes out too large, "
                "at 0.4999 many times; mesh with `order: 2`"
            )
        if max(found.residuals) > 100 * self.residual:
            raise DesignError(
                f"the solution did not converge: residuals {', '.join(f'{r:.1e}' for r in found.residuals)} after "
                f"{max(found.iterations)} iterations",
                hint="raise `iterations`, or look at the mesh with `check.volume_mesh`",
            )
        cell = float(np.prod(mesh.box[1] - mesh.box[0]))
        return StiffnessReport(
            found.stiffness, self._phases(mesh, cell),
            f"{'quadratic' if mesh.cells.shape[1] == 10 else 'straight'} tetrahedra, {len(mesh.cells)}",
            unit=None if self.stress_unit == "relative" else self.stress_unit,
            solver={
                "iterations": found.iterations, "residuals": found.residuals, "unknowns": found.unknowns,
                "constraints": found.constraints,
            },
        )  # fmt: skip

    def _refuse_loose(self, mesh: VolumeMesh, stiffness: np.ndarray) -> None:
        """An error if the stiffness is rounding only: what unmatched faces join is unknown before."""
        assert mesh.box is not None
        phases = self._phases(mesh, float(np.prod(mesh.box[1] - mesh.box[0])))
        largest = float(np.abs(stiffness).max())
        mean = sum(fraction * young for fraction, young, _ in phases)
        # loose solid moves freely: its stiffness is zero, or indefinite by rounding
        if largest <= MIN_STIFFNESS * mean or np.linalg.eigvalsh(stiffness)[0] < -1e-4 * largest:
            raise self._loose(mesh)

    @staticmethod
    def _loose(mesh: VolumeMesh, parts: str = "") -> DesignError:
        return DesignError(
            f"{mesh.name} carries no load: its solid{parts} does not run through the cell",
            hint="make the structure less porous, or the mesh finer if it is the mesh that is torn; "
            "`check.connectivity` says whether the solid of a field runs through",
        )

    def _constants(self, mesh: VolumeMesh) -> tuple[list[float], list[float]]:
        return mesh.constants("young", self.young), mesh.constants("poisson", self.poisson)

    def _materials(self, mesh: VolumeMesh) -> tuple[np.ndarray, np.ndarray]:
        if not len(mesh.cells):
            raise InputError(f"{mesh.name} has no cells")
        if not mesh.material_of_cells.min() > 0:
            raise InputError("materials of a mesh count from 1")
        moduli, ratios = self._constants(mesh)
        index = mesh.material_of_cells.astype(np.int64) - 1
        return np.array(moduli)[index], np.array(ratios)[index]

    def _phases(self, mesh: VolumeMesh, cell: float) -> tuple[tuple[float, float, float], ...]:
        from sppm_tetrahedra.numerics.quality import volumes

        moduli, ratios = self._constants(mesh)
        fractions = np.bincount(mesh.material_of_cells, volumes(mesh.nodes, mesh.cells[:, :4])) / cell
        phases = [(float(fractions[m + 1]), moduli[m], ratios[m]) for m in range(len(fractions) - 1)]
        # a mesh may overfill its box by rounding
        void = max(0.0, 1 - float(fractions.sum()))
        total = void + float(fractions.sum())
        return tuple((fraction / total, e, nu) for fraction, e, nu in [*phases, (void, 0.0, 0.0)])
