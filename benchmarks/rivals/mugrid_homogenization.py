"""Effective stiffness with muGrid: Green's operator as preconditioner of conjugate gradients (`pip install muGrid`)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def mugrid_stiffness(lam: NDArray[Any], mu: NDArray[Any], residual: float, dtype: Any) -> NDArray[np.float64]:
    """The diagonal of the stiffness; `lam`, `mu` (nx, ny, nz)."""
    import muGrid
    from muGrid.Preconditioners import make_reference_stiffness_preconditioner
    from muGrid.Solvers import conjugate_gradients

    n = list(lam.shape)
    comm = muGrid.Communicator()
    engine = muGrid.FFTEngine(n, comm, nb_ghosts_left=[1] * 3, nb_ghosts_right=[1] * 3)
    operator = muGrid.IsotropicStiffnessOperator3D([1.0] * 3)

    def field(name: str, components: tuple[int, ...] = ()) -> Any:
        return engine.real_space_field(name, components, dtype=dtype)

    lam_field, mu_field, b, u = field("lam"), field("mu"), field("b", (3,)), field("u", (3,))
    for target, values in ((lam_field, lam), (mu_field, mu)):
        target.p[...] = values
        engine.communicate_ghosts(target)

    def product(v: Any, f: Any) -> None:
        engine.communicate_ghosts(v)
        operator.apply(v, lam_field, mu_field, f)

    green = make_reference_stiffness_preconditioner(
        engine, nb_components=3, element=muGrid.FEMElement.q1, grid_spacing=[1.0] * 3,
        lambda_ref=float(lam.mean()), mu_ref=float(mu.mean()), dtype=dtype,
    )  # fmt: skip
    found = np.empty(6)
    for case, (i, j) in enumerate(((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))):
        strain = np.zeros((3, 3))
        strain[i, j] += 0.5
        strain[j, i] += 0.5
        operator.apply_macro_rhs(lam_field._cpp, mu_field._cpp, strain.reshape(-1).tolist(), b._cpp)
        b.p[...] *= -1
        u.p[...] = 0
        load = np.array(b.p, np.float64)
        conjugate_gradients(comm, engine.real_space_collection, b, u, product, prec=green, rtol=residual)
        voigt = float((lam + 2 * mu).mean(dtype=float)) if case < 3 else float(mu.mean(dtype=float))
        found[case] = voigt - float((load * np.asarray(u.p, np.float64)).sum()) / lam.size
    return found
