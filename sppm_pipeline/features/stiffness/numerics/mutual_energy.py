"""The energies of load cases that are solved one after the other, with little kept of each."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.features.stiffness.numerics.elastic_level import ElasticLevel
from sppm_pipeline.services.multigrid.hierarchy import Hierarchy, Workspace
from sppm_pipeline.services.multigrid.vectors import dot, pack, packed_dot


class MutualEnergies:
    """Energies, mean stresses, and stresses of a held cell for a kelvin, of six load cases; see `solver.Measure`.

    With the total strain of case l its stresses have the mean s and the nodal forces f, which an exact solution would
    not have, and the mutual energy with case k is ``s[k] + u[k] . f / volume``, whatever the errors of both. As f is
    only the residual of case l, an error of u[k] counts by its product with that, and 16 bits are enough for u[k].

    Parameters
    ----------
    hierarchy : Hierarchy
    expansion : (nz, ny, nx) float, optional
        Coefficients of thermal expansion of the voxels.
    """

    def __init__(self, hierarchy: Hierarchy, expansion: NDArray[Any] | None = None) -> None:
        level = hierarchy.levels[0]
        assert isinstance(level, ElasticLevel)
        self.level = level
        self.kept: list[tuple[NDArray[np.int16], float] | None] = [None] * 6
        self.matrix = np.zeros((6, 6))
        #: mean stresses of the cases, a row for each
        self.held = np.zeros((6, 6))
        #: In the load case of a strain the mean of ``strain : C : alpha`` over the cell is the stress that a held cell
        #: answers a kelvin with (Rosen and Hashin 1970), and only the constant part of a brick's strain enters. By the
        #: same linear functionals as mean stresses it keeps to the relations of Levin (1967) whatever the error of
        #: the displacements.
        self.heat = np.zeros(6)
        self.stress = None if expansion is None else level.bulk(expansion)
        if self.stress is not None:
            # for a kelvin, the stress is alike along all axes
            self.heat[:3] = self.stress.mean(dtype=np.float64)

    def target(self, case: int) -> None:
        """No solution is needed after its measurement."""

    def keep(self, case: int, u: NDArray[Any]) -> None:
        """Round a solution to 16 bits; the last one is not needed."""
        if case + 1 < len(self.kept):
            packed = np.empty(len(u), np.int16)
            self.kept[case] = packed, pack(u, packed)

    def record(self, case: int, u: NDArray[Any], spare: NDArray[Any], work: Workspace) -> None:
        """Measure a solution beside those before it."""
        level, strain = self.level, np.eye(6)[case]
        volume = level.weight.size * float(np.prod(level.edges))
        self.matrix[case, case], self.held[case] = level.energy_and_stress(strain, u)
        level.strained_forces(strain, u, spare, work)
        for k in range(case):
            kept = self.kept[k]
            assert kept is not None
            packed, step = kept
            value = self.held[case, k] + step * packed_dot(packed, spare) / volume
            self.matrix[k, case] = self.matrix[case, k] = value
        if self.stress is not None:
            level.pressure_forces(self.stress, spare)
            self.heat[case] += dot(spare, u) / volume

    def energies(self, threads: int) -> NDArray[np.float64]:
        """Mutual energies over the volume, (6, 6)."""
        return self.matrix
