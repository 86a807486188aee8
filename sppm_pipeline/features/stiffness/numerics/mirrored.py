"""Effective stiffness of a cell with its seven mirror images, solved on the cell alone."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.features.stiffness.numerics.elasticity import NO_LOAD_PATH, Homogenized
from sppm_pipeline.services.arrays import Bools
from sppm_pipeline.services.elastic.elastic_level import Moduli
from sppm_pipeline.services.elastic.loaded import HeldBody
from sppm_pipeline.services.elastic.voigt import from_lame
from sppm_pipeline.services.multigrid.solver import Solved

SHEARS = ((1, 2), (0, 2), (0, 1))
"""Axes of the shear strains yz, xz, xy."""


class Faces(NamedTuple):
    """Nodes of a box (3, nz + 1, ny + 1, nx + 1) that its mirrors hold, and displacements of a unit strain there."""

    fixed: Bools
    affine: NDArray[Any]


def faces_of(case: int, shape: tuple[int, int, int], edges: tuple[float, float, float], dtype: Any) -> Faces:
    """What mirrors at all sides hold under the unit strain `case`, in Voigt order.

    Tension along an axis looks the same in all mirrors: a component of the displacement is given on the two sides that
    are normal to it. Shear of two axes changes its sign in the mirrors normal to either: there the components along
    those sides are given, and at the sides normal to the third axis the one along that.
    """
    nodes = tuple(n + 1 for n in shape)
    fixed, affine = np.zeros((3, *nodes), bool), np.zeros((3, *nodes), dtype)
    held = [[axis == component for component in range(3)] for axis in range(3)]
    if case < 3:
        component, along = case, case
    else:
        component, along = SHEARS[case - 3]
        for axis in SHEARS[case - 3]:
            held[axis] = [component != axis for component in range(3)]
    for axis in range(3):
        for side in (0, -1):
            place: list[Any] = [slice(None)] * 3
            place[2 - axis] = side
            fixed[(np.array(held[axis]), *place)] = True
    line = np.arange(nodes[2 - along]) * edges[along]
    affine[component] = np.expand_dims(line, [d for d in range(3) if d != 2 - along])
    return Faces(fixed, affine)


def mirrored_stiffness(
    lam: NDArray[Any], mu: NDArray[Any], edges: tuple[float, float, float] = (1.0, 1.0, 1.0), *, residual: float = 0.0,
    tolerance: float = 1e-4, iterations: int = 500, precision: Any = np.float32,
) -> Homogenized:  # fmt: skip
    """Effective stiffness of a cell and its mirror images at all sides, which repeat: an eighth of the voxels.

    The mixed conditions of Pahr and Zysset (2008) are the same ones. Parameters as for `elasticity.stiffness`, of the
    cell alone; the nine constants that mirrors leave.

    Raises
    ------
    ArithmeticError
        If the iteration fails in double precision, too.
    """
    shape, scale = mu.shape, float(mu.max())
    if not scale:
        return Homogenized(np.zeros((6, 6)), (Solved(0, 0.0, 0.0, 0.0, True, True),) * 6, np.dtype(precision).name)
    mean = np.diag(from_lame(float(lam.mean(dtype=np.float64)) / scale, float(mu.mean(dtype=np.float64)) / scale))
    dtype = np.dtype(precision)
    moduli = Moduli.of(lam, mu).each(lambda values: np.asarray(values / scale, dtype))
    volume = float(np.prod(np.array(shape) * edges[::-1]))
    matrix, solved, body = np.zeros((6, 6)), list[Solved](), None
    tension: list[NDArray[Any]] = []
    for case in range(6):
        fixed, affine = faces_of(case, shape, edges, dtype)
        nothing = np.zeros_like(affine)
        if body is None or case > 2:
            body = HeldBody(moduli, edges, fixed, dtype)
        try:
            found = body.solve(
                nothing, affine, affine, residual=residual or 1e-30, energy=tolerance, iterations=iterations,
                stored=volume * float(mean[case]),
            )  # fmt: skip
        except ArithmeticError:
            if dtype == np.float64:
                raise
            return mirrored_stiffness(
                lam, mu, edges, residual=residual, tolerance=tolerance, iterations=iterations, precision=np.float64
            )
        u, forces = found.displacement, body.forces(found.displacement)
        solved.append(found.solved)
        # mutual energies, whose error is of second order in that of the displacements
        others = [*tension, u] if case < 3 else [u]
        for number, other in enumerate(others, case - len(others) + 1):
            value = float(np.einsum("i,i", other.ravel(), forces.ravel(), dtype=np.float64)) / volume
            matrix[number, case] = matrix[case, number] = value
        if case < 3:
            tension.append(u)
    void = np.diag(matrix) < NO_LOAD_PATH * mean
    matrix[void] = 0
    matrix[:, void] = 0
    return Homogenized(matrix * scale, tuple(solved), dtype.name)
