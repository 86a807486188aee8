"""Effective stiffness of a periodic cell of tetrahedra."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.homogenization.finite_elements.mortar import collocation, face_pairs, mortar
from sppm_pipeline.numerics.homogenization.finite_elements.solve import (
    Projector,
    conjugate_gradients,
    multigrid,
    rigid_modes,
)
from sppm_pipeline.numerics.homogenization.finite_elements.stiffness import assemble


class TetHomogenized(NamedTuple):
    """Effective stiffness and how it was found.

    Attributes
    ----------
    stiffness : (6, 6) float64
        Voigt, engineering shear, of the whole box.
    iterations : list of 6 ints
    residuals : list of 6 floats
    unknowns : int
    constraints : int
        Rows that join opposite faces; 0 where nodes match.
    solid : float
        Volume of the mesh.
    """

    stiffness: NDArray[np.float64]
    iterations: list[int]
    residuals: list[float]
    unknowns: int
    constraints: int
    solid: float


def homogenize_tetrahedra(
    nodes: NDArray[np.float64],
    cells: NDArray[np.int32],
    box: NDArray[np.float64],
    young: NDArray[np.float64],
    poisson: NDArray[np.float64],
    representative: NDArray[np.int64] | None,
    *,
    faces: str = "mortar",
    face_tolerance: float = 1e-6,
    tolerance: float = 1e-8,
    most: int = 2000,
    told: Callable[[int], None] | None = None,
) -> TetHomogenized:
    """Homogenize linear elasticity on a mesh of a periodic cell.

    Parameters
    ----------
    nodes : (n, 3) float64
    cells : (m, 4) or (m, 10) int32
    box : (2, 3) float64
        Corners of the periodic cell.
    young, poisson : (m,) float64
        Of each cell.
    representative : (n,) int64 or None
        For meshes whose opposite faces match: for each node the one that stands for all its periodic copies. None joins
        the faces by constraints.
    faces : {"mortar", "collocation"}
        How faces that do not match are joined.
    face_tolerance : float
        How far nodes of a face may lie from the box, over the longest edge of the box.
    tolerance : float
        Residual of each load case over its load.
    most : int
        Iterations of one load case.
    told : function, optional
        Is called with the number of load cases done.

    References
    ----------
    Michel, Moulinec and Suquet 1999 for the cell problem; the energy form makes the error of the stiffness that of the
    displacements squared.
    """
    used = np.zeros(len(nodes), bool)
    used[cells] = True
    stand_in = np.arange(len(nodes)) if representative is None else np.asarray(representative)
    kept, unknowns = np.unique(stand_in[used], return_inverse=True)
    numbers = np.zeros(len(nodes), np.int64)
    numbers[used] = unknowns
    # one number for all nodes of the mesh: those that no cell uses take that of the first, and nothing refers to them
    lame = young * poisson / ((1 + poisson) * (1 - 2 * poisson))
    shear = young / (2 * (1 + poisson))
    built = assemble(nodes, cells, numbers, lame, shear)
    project, count = None, 0
    if representative is None:
        from scipy.sparse import vstack

        join = {"mortar": mortar, "collocation": collocation}[faces]
        reach = face_tolerance * float((box[1] - box[0]).max())
        rows = [join(nodes, pair) for pair in face_pairs(nodes, cells, box, reach)]
        joined = vstack([part[:, kept] for part in rows])
        count = joined.shape[0]
        if count:
            project = Projector(joined)
    precondition = multigrid(built.matrix, rigid_modes(nodes[kept]))
    fields, iterations, residuals = [], [], []
    for number, load in enumerate(built.loads):
        found = conjugate_gradients(built.matrix, -load, precondition, project, tolerance, most)
        fields.append(found.values)
        iterations.append(found.iterations)
        residuals.append(found.residual)
        if told is not None:
            told(number + 1)
    u = np.array(fields)
    forces = np.array([built.matrix @ field for field in fields])
    work = np.einsum("in,jn->ij", u, built.loads)
    energy = built.mean + work + work.T + np.einsum("in,jn->ij", u, forces)
    stiffness = (energy + energy.T) / 2 / float(np.prod(box[1] - box[0]))
    return TetHomogenized(stiffness, iterations, residuals, 3 * len(kept), 3 * count, built.volume)
