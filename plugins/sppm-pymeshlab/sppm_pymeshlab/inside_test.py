"""The inside test of a repair: how many sample points change sides from step to step."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import SurfaceMesh
from sppm_pymeshlab.winding import spread_points, winding_change, winding_numbers


class InsideTest:
    """Inside test at `samples` points in the box of a mesh, kept up to date while the mesh is repaired.

    A point is `inside` (n,) where the surface goes around it, either way, by more than one half; so a mesh that is
    inside out gives the same as one that is not.
    """

    def __init__(self, mesh: SurfaceMesh, samples: int, threads: int) -> None:
        self._points = spread_points(mesh.lower, mesh.upper, samples)
        self._threads = threads
        self._mesh = mesh
        self._windings = winding_numbers(self._points, (mesh.vertices, mesh.faces), threads=threads)
        self.inside: NDArray[np.bool_] = np.abs(self._windings) > 0.5

    def windings(self, mesh: SurfaceMesh) -> NDArray[np.float64]:
        """Winding numbers of `mesh`, from those of the mesh that was accepted last."""
        if mesh is self._mesh:
            return self._windings
        before, after = (self._mesh.vertices, self._mesh.faces), (mesh.vertices, mesh.faces)
        return self._windings + winding_change(self._points, before, after, threads=self._threads)

    def changed(self, mesh: SurfaceMesh) -> float:
        """Points that have changed sides, as a fraction of those that were inside."""
        inside = np.abs(self.windings(mesh)) > 0.5
        return int((inside != self.inside).sum()) / max(1, int(self.inside.sum()))

    def accept(self, mesh: SurfaceMesh, *, as_new_truth: bool = False) -> None:
        """Go on from `mesh`; `as_new_truth` if the input said nothing that could be kept."""
        self._windings = self.windings(mesh)
        self._mesh = mesh
        if as_new_truth:
            self.inside = np.abs(self._windings) > 0.5
