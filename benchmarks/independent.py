"""Results beside those of independent codes, number by number: a CSV file of raw values.

    python -m benchmarks.independent FILE.csv [VOXELS]

The same images of whole voxels go to each code that is installed (`pip install muGrid scikit-fem porespy`): muGrid
(FFT, stiffness), scikit-fem (an assembled matrix and a direct solver, stiffness and conductivity), PoreSpy (porosity,
local thickness of the void). Images are cells of the presets `paper` and `stiff`, VOXELS (16) along an edge. The
largest differences are printed.
"""

from __future__ import annotations

import csv
import importlib
import sys
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import sppm_pipeline as sppm
from sppm_pipeline.features.flow.numerics.conduction import conductivity
from sppm_pipeline.features.stiffness.numerics.elasticity import stiffness
from sppm_pipeline.services.elastic.voigt import lame
from sppm_pipeline.services.local_thickness import local_thickness

CELLS = (("paper", 0.5, 1), ("paper", 0.7, 1), ("stiff", 0.7, 1))
LAM, MU = lame(1.0, 0.3)
VOIGT = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))

Values = dict[str, float]


def named(name: str, values: Any) -> Values:
    """Diagonal entries by name."""
    return {f"{name}{i}{i}": float(value) for i, value in enumerate(values, 1)}


def ours(solid: NDArray[np.bool_]) -> Values:
    """Stiffness, conductivity, porosity and thickness by this program; images are (nz, ny, nx)."""
    exact = {"residual": 1e-9, "tolerance": 0.0, "precision": np.float64}
    thick = local_thickness(~solid)
    return {
        **named("C", np.diag(stiffness(LAM * solid, MU * solid, **exact).stiffness)),
        **named("k", np.diag(conductivity(1.0 * solid, **exact).conductivity)),
        "porosity": 1 - float(solid.mean()), "thickness": float(thick[~solid].mean()),
    }  # fmt: skip


def by_mugrid(solid: NDArray[np.bool_]) -> Values:
    """Diagonal of the stiffness."""
    from benchmarks.rivals.mugrid_homogenization import mugrid_stiffness

    image = np.asfortranarray(solid.T, np.float64)
    return named("C", mugrid_stiffness(LAM * image, MU * image, 1e-9, np.float64))


def by_scikit_fem(solid: NDArray[np.bool_]) -> Values:
    """Diagonals of stiffness and conductivity: periodic bricks of the solid alone, assembled."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.linalg import splu
    from skfem import Basis, BilinearForm, ElementHex1, ElementVector, MeshHex
    from skfem.helpers import ddot, dot, grad, sym_grad, trace

    n = len(solid)
    line = np.linspace(0.0, float(n), n + 1)
    mesh = MeshHex.init_tensor(line, line, line)
    x, y, z = np.floor(mesh.p[:, mesh.t].mean(axis=1)).astype(int)
    filled = np.flatnonzero(solid[z, y, x])
    # nodes of opposite faces are one
    wrapped = np.rint(mesh.p).astype(int) % n
    node = (wrapped[2] * n + wrapped[1]) * n + wrapped[0]

    @BilinearForm
    def elastic(u: Any, v: Any, _: Any) -> Any:
        return 2 * MU * ddot(sym_grad(u), sym_grad(v)) + LAM * trace(sym_grad(u)) * trace(sym_grad(v))

    @BilinearForm
    def conducting(u: Any, v: Any, _: Any) -> Any:
        return dot(grad(u), grad(v))

    def energies(element: Any, form: Any, parts: int, loads: list[NDArray[np.float64]]) -> list[float]:
        """Energies over the volume of the periodic answers to displacements that grow in space."""
        basis = Basis(mesh, element, elements=filled)
        matrix = form.assemble(basis).tocsc()
        periodic = np.empty(matrix.shape[0], int)
        for part in range(parts):
            periodic[basis.nodal_dofs[part]] = parts * node + part
        coo = matrix.tocoo()
        joined = coo_matrix((coo.data, (periodic[coo.row], periodic[coo.col])), (parts * n**3,) * 2).tocsc()
        used = np.flatnonzero(joined.diagonal() > 0)
        # what moves freely: the body as a whole, and parts that touch nothing
        small = joined[used][:, used]
        small.setdiag(small.diagonal() * (1 + 1e-9))
        factors = splu(small.tocsc())
        found = []
        for load in loads:
            whole = np.empty(matrix.shape[0])
            for part in range(parts):
                whole[basis.nodal_dofs[part]] = load[part] @ mesh.p
            force = np.bincount(periodic, matrix @ whole, parts * n**3)[used]
            answer = factors.solve(-force)
            answer -= factors.solve(small @ answer + force)
            found.append(float(whole @ (matrix @ whole) + answer @ force) / n**3)
        return found

    strains = []
    for i, j in VOIGT:
        strain = np.zeros((3, 3))
        strain[i, j] += 0.5
        strain[j, i] += 0.5
        strains.append(strain)
    gradients = [np.eye(3)[[axis]] for axis in range(3)]
    return {
        **named("C", energies(ElementVector(ElementHex1()), elastic, 3, strains)),
        **named("k", energies(ElementHex1(), conducting, 1, gradients)),
    }


def by_porespy(solid: NDArray[np.bool_]) -> Values:
    """Porosity, and mean local thickness of the void, which repeats."""
    import porespy

    n = len(solid)
    void = np.tile(~solid, (3, 3, 3))  # its spheres see no other side
    thick = 2 * porespy.filters.local_thickness(void, sizes=np.arange(0.5, n / 2, 0.25)[::-1])
    middle = thick[n : 2 * n, n : 2 * n, n : 2 * n]
    return {"porosity": porespy.metrics.porosity(~solid), "thickness": float(middle[~solid].mean())}


CODES: tuple[tuple[str, str, Callable[[NDArray[np.bool_]], Values]], ...] = (
    ("muGrid", "muGrid", by_mugrid), ("scikit-fem", "skfem", by_scikit_fem), ("porespy", "porespy", by_porespy),
)  # fmt: skip


def rows(n: int) -> Iterator[dict[str, Any]]:
    """A row for each number of each code that is installed."""
    for preset, porosity, seed in CELLS:
        field = sppm.cell(preset, porosity=porosity, seed=seed)
        solid = np.ascontiguousarray(field.voxels(n).values.T > 0)
        own = ours(solid)
        for name, module, compute in CODES:
            try:
                importlib.import_module(module)
            except ImportError:
                continue
            for quantity, value in compute(solid).items():
                yield {
                    "cell": f"{preset} {porosity} seed {seed}", "voxels": n, "quantity": quantity,
                    "here": own[quantity], "code": name, "version": version(name), "there": value,
                    "difference": own[quantity] / value - 1 if value else own[quantity],
                }  # fmt: skip


def main(path: Path, n: int) -> None:
    """Write the file, and print the largest difference of each code and kind of quantity."""
    largest: dict[tuple[str, str], float] = {}
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = None
        for row in rows(n):
            writer = writer or csv.DictWriter(file, list(row))
            if file.tell() == 0:
                writer.writeheader()
            writer.writerow(row)
            key = (row["code"], row["quantity"].rstrip("123456"))
            largest[key] = max(largest.get(key, 0.0), abs(row["difference"]))
    for (code, quantity), difference in largest.items():
        print(f"{code:12} {quantity:10} {difference:.2g}")
    if not largest:
        print("none of the other codes is installed")


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 16)
