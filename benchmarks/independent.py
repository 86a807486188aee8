"""Results beside those of independent codes, number by number: a CSV file of raw values.

    python -m benchmarks.independent FILE.csv [VOXELS [CODE ...]]
    python -m benchmarks.independent --pages docs/results/independent.csv

The same images of whole voxels go to each code that is installed (`pip install muGrid scikit-fem porespy`): muGrid
(FFT, stiffness), scikit-fem (an assembled matrix and a direct solver, stiffness and conductivity), CalculiX (`ccx`, the
same bricks, stiffness), PoreSpy (porosity, local thickness of the void, pores and throats of a network; take 32
voxels or more). Images are cells of the presets `paper` and `stiff`, VOXELS (16) along an edge. The largest differences
are printed; `--pages` writes the tables of docs/explanation from a file of all codes. `tests/features/flow/
test_write_network.py` compares the flow of a network with OpenPNM where that is installed.
"""

from __future__ import annotations

import csv
import importlib.util
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import sppm_pipeline as sppm
from benchmarks.measure import between_marks
from sppm_pipeline.features.flow.numerics.conduction import conductivity
from sppm_pipeline.features.flow.numerics.regions import regions_of
from sppm_pipeline.features.stiffness.numerics.elasticity import stiffness
from sppm_pipeline.services.elastic.voigt import lame
from sppm_pipeline.services.local_thickness import local_thickness

CELLS = (("paper", 0.5, 1), ("paper", 0.7, 1), ("stiff", 0.7, 1))
LAM, MU = lame(1.0, 0.3)
VOIGT = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))

KINDS = {"C": "stiffness", "k": "conductivity"}
PAGES = Path(__file__).parents[1] / "docs" / "explanation"
MARK = "<!-- benchmarks.independent -->\n"

Values = dict[str, float]


def named(name: str, values: Any) -> Values:
    """Diagonal entries by name."""
    return {f"{name}{i}{i}": float(value) for i, value in enumerate(values, 1)}


def ours(solid: NDArray[np.bool_]) -> Values:
    """Stiffness and conductivity by this program; images are (nz, ny, nx)."""
    exact = {"residual": 1e-9, "tolerance": 0.0, "precision": np.float64}
    return {
        **named("C", np.diag(stiffness(LAM * solid, MU * solid, **exact).stiffness)),
        **named("k", np.diag(conductivity(1.0 * solid, **exact).conductivity)),
    }


def ours_of_void(solid: NDArray[np.bool_]) -> Values:
    """Porosity, thickness of the void and its network by this program."""
    thick = local_thickness(~solid)
    network = regions_of(~solid, (1.0, 1.0, 1.0))
    pores = int(np.count_nonzero(network.volume))
    return {
        "porosity": 1 - float(solid.mean()), "thickness": float(thick[~solid].mean()),
        "pores": float(pores), "throat": 2 * float(network.throat[network.conns[:, 1] < pores].mean()),
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


def by_calculix(solid: NDArray[np.bool_]) -> Values:
    """Diagonal of the stiffness: C3D8 bricks, opposite faces tied by equations to three nodes that carry the strain."""
    n = len(solid)
    # loose pieces would make the matrix singular; without them the solid has the same stiffness
    z, y, x = np.nonzero(largest_piece(solid))
    around = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])
    corners = np.stack([x, y, z], axis=1)[:, None] + around
    places, node = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    node, count = node.reshape(-1, 8) + 1, len(places)
    number = {tuple(place): k for k, place in enumerate(places.tolist(), 1)}
    lines = ["*NODE, NSET=ALL", *(f"{k}, {a}., {b}., {c}." for k, (a, b, c) in enumerate(places.tolist(), 1))]
    lines += [f"{count + axis}, 0., 0., {-axis}." for axis in (1, 2, 3)]
    chosen: dict[tuple[int, ...], tuple[tuple[int, ...], int]] = {}  # the first node of those that are one in the cell
    ties: list[str] = []
    for place, k in number.items():
        low = tuple(a % n for a in place)
        first = chosen.setdefault(low, (place, k))
        if first[1] == k:
            continue
        shift = [(a - b) // n for a, b in zip(place, first[0], strict=True)]
        for part in (1, 2, 3):
            terms = [(k, part, 1.0), (first[1], part, -1.0)]
            terms += [(count + axis, part, -float(s)) for axis, s in enumerate(shift, 1) if s]
            ties += ["*EQUATION", str(len(terms)), ", ".join(f"{a}, {b}, {c}" for a, b, c in terms)]
    lines += ["*ELEMENT, TYPE=C3D8, ELSET=SOLID"]
    lines += [f"{k}, " + ", ".join(map(str, row)) for k, row in enumerate(node.tolist(), 1)]
    lines += ties
    lines += ["*MATERIAL, NAME=M", "*ELASTIC", "1., 0.3", "*SOLID SECTION, ELSET=SOLID, MATERIAL=M"]
    lines += ["*BOUNDARY", "1, 1, 3"]  # the first node is not tied to others
    for i, j in VOIGT:
        strain = np.zeros((3, 3))
        strain[i, j] += 0.5
        strain[j, i] += 0.5
        lines += ["*STEP", "*STATIC", "*BOUNDARY"]
        lines += [f"{count + a + 1}, {b + 1}, {b + 1}, {n * strain[b, a]}" for a in range(3) for b in range(3)]
        lines += ["*EL PRINT, ELSET=SOLID, TOTALS=ONLY", "ELSE", "*END STEP"]
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "cell.inp").write_text("\n".join(lines) + "\n", encoding="ascii")
        subprocess.run(["ccx", "cell"], cwd=folder, check=True, stdout=subprocess.DEVNULL)
        text = Path(folder, "cell.dat").read_text(encoding="ascii")
    energies = [float(words[0]) for line in text.splitlines() if len(words := line.split()) == 1]
    return named("C", [2 * energy / n**3 for energy in energies])


def largest_piece(solid: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The largest piece of the solid of a cell that repeats, of voxels that share a face, an edge or a corner."""
    from scipy import ndimage
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    labels, count = ndimage.label(np.pad(solid, 1, mode="wrap"), np.ones((3, 3, 3)))
    inner = labels[1:-1, 1:-1, 1:-1]
    wrapped = np.pad(inner, 1, mode="wrap")
    both = (labels > 0) & (wrapped > 0)
    pairs = coo_matrix((np.ones(both.sum()), (labels[both], wrapped[both])), (count + 1, count + 1))
    piece = connected_components(pairs, directed=False)[1][inner]
    sizes = np.bincount(piece[solid])
    return solid & (piece == sizes.argmax())


def by_porespy(solid: NDArray[np.bool_]) -> Values:
    """Porosity, mean local thickness of the void, which repeats; pores and mean throat of the network of SNOW.

    Radii there end at centers of solid voxels, half a voxel beyond ours. Of the methods since PoreSpy 3 only this one
    takes radii that are no whole numbers.
    """
    import porespy
    from scipy.ndimage import distance_transform_edt

    n = len(solid)
    void = np.tile(~solid, (3, 3, 3))  # its spheres see no other side
    distances = distance_transform_edt(void)
    radii = np.unique(distances[void]) - 1e-4  # beyond rounding, as a voxel at the radius is outside
    thick = 2 * porespy.filters.local_thickness(void, dt=distances, method="legacy", sizes=radii) + 2e-4 - 1
    middle = thick[n : 2 * n, n : 2 * n, n : 2 * n]
    network = porespy.networks.snow2(~solid, boundary_width=0).network
    return {
        "porosity": porespy.metrics.porosity(~solid), "thickness": float(middle[~solid].mean()),
        "pores": float(len(network["pore.coords"])), "throat": float(network["throat.inscribed_diameter"].mean()),
    }  # fmt: skip


CODES: tuple[tuple[str, str, Callable[[NDArray[np.bool_]], Values]], ...] = (
    ("muGrid", "muGrid", by_mugrid), ("scikit-fem", "skfem", by_scikit_fem), ("porespy", "porespy", by_porespy),
    ("CalculiX", "ccx", by_calculix),
)  # fmt: skip


def version_of(name: str) -> str:
    """Version of a Python package, or of CalculiX."""
    if name != "CalculiX":
        return version(name)
    return subprocess.run(["ccx", "-v"], capture_output=True, text=True, check=False).stdout.split()[-1]


def rows(n: int, only: list[str]) -> Iterator[dict[str, Any]]:
    """A row for each number of each code that is installed, and named if any is."""
    for preset, porosity, seed in CELLS:
        field = sppm.cell(preset, porosity=porosity, seed=seed)
        solid = np.ascontiguousarray(field.voxels(n).values.T > 0)
        found: dict[bool, Values] = {}
        for name, module, compute in CODES:
            if not (shutil.which(module) or importlib.util.find_spec(module)) or (only and name not in only):
                continue
            void = name == "porespy"
            if void not in found:
                found[void] = (ours_of_void if void else ours)(solid)
            own = found[void]
            for quantity, value in compute(solid).items():
                yield {
                    "cell": f"{preset} {porosity} seed {seed}", "voxels": n, "quantity": quantity,
                    "here": own[quantity], "code": name, "version": version_of(name), "there": value,
                    "difference": own[quantity] / value - 1 if value else own[quantity],
                }  # fmt: skip


def tables(path: Path) -> dict[str, str]:
    """Tables of a file of raw values by the page that shows them: networks on one page, all other codes on another."""
    with path.open(encoding="utf-8") as file:
        found = list(csv.DictReader(file))
    void = [row for row in found if row["code"] == "porespy"]
    names = list(dict.fromkeys(row["quantity"] for row in void))
    lines: dict[str, str] = {}
    for row in void:
        start = lines.get(row["cell"], f"| `{row['cell'].split()[0]}`, porosity {row['cell'].split()[1]} |")
        lines[row["cell"]] = f"{start} {float(row['here']):.4g}, {float(row['there']):.4g} |"
    networks = [f"| cell, {void[0]['voxels']} voxels along an edge | " + " | ".join(names) + " |", *lines.values()]
    largest: dict[tuple[str, ...], tuple[float, int]] = {}
    for row in found:
        if row["code"] != "porespy":
            key = (f"{row['code']} {row['version']}", KINDS[row["quantity"].rstrip("123456")], row["voxels"])
            most, count = largest.get(key, (0.0, 0))
            largest[key] = max(most, abs(float(row["difference"]))), count + 1
    others = ["| code | diagonal of | voxels along an edge | numbers | largest difference |"]
    others += [f"| {' | '.join(key)} | {count} | {most:.1e} |" for key, (most, count) in largest.items()]
    return {
        page: "\n".join([rows[0], "|---" * (rows[0].count(" | ") + 1) + "|", *rows[1:]]) + "\n"
        for page, rows in (("flow.md", networks), ("homogenization.md", others))
    }


def write_pages(path: Path) -> None:
    """Put the tables between the marks of their pages."""
    for name, table in tables(path).items():
        between_marks(PAGES / name, MARK, table)


def main(path: Path, n: int, only: list[str]) -> None:
    """Write the file, and print the largest difference of each code and kind of quantity."""
    largest: dict[tuple[str, str], float] = {}
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = None
        for row in rows(n, only):
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
    if sys.argv[1] == "--pages":
        write_pages(Path(sys.argv[2]))
        sys.exit()
    main(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 16, sys.argv[3:])
