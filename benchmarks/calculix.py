"""Crushing beside CalculiX, an independent implicit code: the curve of the same voxels, and single bricks.

    python -m benchmarks.calculix curve FOLDER [SPLIT]  # one cell of 16 voxels to 25 %, each split in SPLIT^3 bricks
    python -m benchmarks.calculix bricks FOLDER         # work to bend a brick that flows, by four kinds of element

Needs ccx (calculix-ccx). `plugins/sppm-crushing/tests/test_calculix.py` holds the first curve, and repeats its
beginning.
"""

from __future__ import annotations

import itertools
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from sppm_crushing.numerics import element
from sppm_crushing.numerics.body import Body, body_of
from sppm_crushing.numerics.march import Load, March
from sppm_crushing.numerics.material import constants

from benchmarks.crushing import SOLID, gyroid

STRAINS = np.array([0.005, 0.01, 0.015, 0.02, 0.03, 0.05, 0.1, 0.125, 0.15, 0.175, 0.2, 0.22, 0.24])

INCREMENT = 0.005
"""Strain of a step of CalculiX."""

_ORDER = [7, 6, 4, 5, 3, 2, 0, 1]  # our corner a is at the low side where a bit is set; theirs go round, bottom and top
_MATERIAL = [
    "*MATERIAL, NAME=M", "*ELASTIC", f"{SOLID.young}, {SOLID.poisson}", "*PLASTIC",
    *(f"{stress}, {strain}" for strain, stress in SOLID.yield_stress), "*SOLID SECTION, ELSET=SOLID, MATERIAL=M",
]  # fmt: skip


def _solved(folder: Path, name: str, lines: list[str]) -> list[list[str]]:
    """Run a job; the words of each line of numbers that it prints."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.inp").write_text("\n".join(lines) + "\n", encoding="ascii")
    subprocess.run(["ccx", name], cwd=folder, check=True, stdout=subprocess.DEVNULL)
    return [line.split() for line in (folder / f"{name}.dat").read_text(encoding="ascii").splitlines() if line.strip()]


def curve(
    body: Body, kind: str, folder: Path, strains: NDArray[np.float64], to: float = 0.25, *, glued: bool = True
) -> NDArray[np.float64]:
    """Stress of a body at some strains up to `to`, by elements of a kind. Walls that meet pass through each other.

    What lies at a plate is glued to it along z, or the plates push as in this program: all that reaches them, and
    without pull.
    """
    n = body.shape[2]
    lines = ["*NODE, NSET=ALL", *(f"{i + 1}, {x}., {y}., {z}." for i, (x, y, z) in enumerate(body.nodes))]
    lines += [f"*ELEMENT, TYPE={kind}, ELSET=SOLID"]
    lines += [f"{i + 1}, " + ", ".join(str(k + 1) for k in row[_ORDER]) for i, row in enumerate(body.corners)]
    for name, level in (("BOTTOM", 0), ("TOP", n)):
        lines += [f"*NSET, NSET={name}", *(f"{i + 1}," for i in np.flatnonzero(body.nodes[:, 2] == level))]
    bottom = np.flatnonzero(body.nodes[:, 2] == 0)
    first = bottom[0]
    far = bottom[np.argmax(np.abs(body.nodes[bottom, 0] - body.nodes[first, 0]))]
    step, held, pressed = INCREMENT / to, ["BOTTOM, 3, 3, 0."], "TOP"
    if not glued:
        held, pressed = ["LOWER, 1, 3, 0.", "UPPER, 1, 2, 0."], "UPPER"
        lines += _plates(body, to)
    lines += [*_MATERIAL, "*BOUNDARY", *held, f"{first + 1}, 1, 2, 0.", f"{far + 1}, 2, 2, 0.",
              "*STEP, NLGEOM, INC=1000", "*STATIC", f"{step:.12g}, 1., 1e-7, {step:.12g}", "*BOUNDARY",
              f"{pressed}, 3, 3, {-to * n}", f"*NODE PRINT, NSET={pressed}, TOTALS=ONLY", "RF",
              "*END STEP"]  # fmt: skip
    rows, at = [(0.0, 0.0)], 0.0
    for words in _solved(folder, "cell", lines):
        if "time" in words:
            at = float(words[-1])
        elif len(words) == 3:
            rows.append((to * at, -float(words[2]) / n**2))
    return np.interp(strains, *np.array(rows).T)


def _plates(body: Body, to: float) -> list[str]:
    """Nodes of two plates, and a gap between one of these and each node of the body that may reach the plate."""
    n, count = body.shape[2], len(body.nodes)
    lines, number = [], count
    z = body.nodes[:, 2]
    for name, away in (("LOWER", z), ("UPPER", n - z)):
        near = np.flatnonzero(away < to * n + 4)
        plate = number + 1 + np.arange(len(near))
        number += len(near)
        lines += [f"*NODE, NSET={name}"]
        lines += [f"{k}, {body.nodes[i, 0]}, {body.nodes[i, 1]}, {0 if name == 'LOWER' else n}" for i, k in
                  zip(near, plate, strict=True)]  # fmt: skip
        for gap in np.unique(away[near]):
            lines += [f"*ELEMENT, TYPE=GAPUNI, ELSET={name}{int(gap)}"]
            for i, k in zip(near[away[near] == gap] + 1, plate[away[near] == gap], strict=True):
                lines.append(f"{len(body.corners) + k}, " + (f"{k}, {i}" if name == "LOWER" else f"{i}, {k}"))
            # stiffness much above that of a voxel, and next to no pull
            lines += [f"*GAP, ELSET={name}{int(gap)}", f"{gap}, 0., 0., 1., , {20 * SOLID.young}, 1e-8"]
    return lines


CORNERS = np.array([[1.0 - ((a >> c) & 1) for c in range(3)] for a in range(8)])
"""Of a brick, in our order."""

GAUSS = list(itertools.product((-(3**-0.5), 3**-0.5), repeat=3))

Forces = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""From the places of the corners (8, 3) to the forces that hold them there; called once for each step of a path."""


def slopes(place: tuple[float, ...]) -> NDArray[np.float64]:
    """Slopes of the eight shape functions at a place of the brick, (8, 3); coordinates from -1 to 1."""
    signs = 2 * CORNERS - 1
    lines = 1 + signs * place
    return np.stack([signs[:, a] * np.delete(lines, a, 1).prod(1) / 4 for a in range(3)], 1)


def our_brick() -> Forces:
    """The element of `crush.voxel`: mean strain, and bending with a secant stiffness."""
    body, table = body_of(np.ones((1, 1, 1), np.uint8)), constants((SOLID,))
    state = np.zeros((len(body.lanes), element.STATE, element.LANES))
    state[:, :3] = state[:, 8:] = 1

    def forces(corners: NDArray[np.float64]) -> NDArray[np.float64]:
        x = np.zeros((8, 3))
        x[body.corners[0]] = corners
        f, sums = np.zeros_like(x), np.zeros((1, element.SUMS))
        element.forces(
            x, body.blocked(body.corners, -1), body.phases[body.lanes[:, 0]].astype(np.int32), body.slabs, 0, 1, table,
            state, np.full(body.lanes.shape, -1, np.int32), np.zeros(0, np.uint8), np.zeros((0, 8, 3)),
            np.zeros(element.ROWS * element.LANES), f, sums, np.zeros((0, 3)), np.zeros((0, 4, element.LANES)),
        )  # fmt: skip
        return -f[body.corners[0]]

    return forces


def whole_brick() -> Forces:
    """Our material at the eight places of full integration: a brick of uniform strain stands for each of them."""
    there = [(slopes(place), our_brick()) for place in GAUSS]

    def forces(corners: NDArray[np.float64]) -> NDArray[np.float64]:
        f = np.zeros((8, 3))
        for slope, uniform in there:
            stress = uniform(CORNERS @ (corners.T @ slope).T).T @ CORNERS
            f += slope @ stress.T / len(there)
        return f

    return forces


def work(forces: Forces, displacements: NDArray[np.float64], steps: int) -> float:
    """Work of the forces while the corners go to their displacements on straight lines."""
    found = [forces(CORNERS + k / steps * displacements) for k in range(1, steps + 1)]
    means = [found[0] / 2, *((a + b) / 2 for a, b in itertools.pairwise(found))]
    return float(sum(np.sum(f * displacements) for f in means) / steps)


def work_in_calculix(kind: str, folder: Path, displacements: NDArray[np.float64], steps: int) -> float:
    """The same by an element of CalculiX."""
    lines = ["*NODE, NSET=ALL", *(f"{i + 1}, {x}, {y}, {z}" for i, (x, y, z) in enumerate(CORNERS))]
    lines += [f"*ELEMENT, TYPE={kind}, ELSET=SOLID", "1, " + ", ".join(str(k + 1) for k in _ORDER), *_MATERIAL]
    lines += ["*STEP, NLGEOM, INC=1000", "*STATIC", f"{1 / steps}, 1., 1e-6, {1 / steps}", "*BOUNDARY"]
    lines += [f"{i + 1}, {c + 1}, {c + 1}, {displacements[i, c]:.12g}" for i in range(8) for c in range(3)]
    held = np.array([
        [float(word) for word in words[1:]]
        for words in _solved(folder, "brick", [*lines, "*NODE PRINT, NSET=ALL", "RF", "*END STEP"])
        if len(words) == 4 and words[0].isdigit()
    ]).reshape(-1, 8, 3)  # fmt: skip
    if len(held) != steps:
        raise RuntimeError(f"CalculiX took {len(held)} steps instead of {steps}")
    following = iter(held)
    return work(lambda corners: next(following), displacements, steps)


def bent(stretch: tuple[float, float, float], modes: Mapping[str, float]) -> NDArray[np.float64]:
    """Displacements of the corners: stretched along the axes, and bent by modes such as ``x:xz``, u_x over ξζ."""
    u = CORNERS * (np.array(stretch) - 1)
    for mode, size in modes.items():
        along, _, over = mode.partition(":")
        u[:, "xyz".index(along)] += size * np.prod([2 * CORNERS[:, "xyz".index(c)] - 1 for c in over], axis=0)
    return u


PATHS = {
    "uniform, 10 %": bent((1.05, 1.05, 0.9), {}),
    "bent by .05": bent((1, 1, 1), {"x:xz": 0.05}),
    "twisted by .05": bent((1, 1, 1), {"x:yz": 0.05}),
    "third order by .05": bent((1, 1, 1), {"x:xyz": 0.05}),
    "uniform, and bent by .05": bent((1.05, 1.05, 0.9), {"x:xz": 0.05}),
    "uniform, and bent both ways by .1": bent((1.05, 1.05, 0.9), {"x:xz": 0.1, "y:yz": -0.1}),
}


def bricks(folder: Path, steps: int = 50) -> None:
    """Work of paths on which the brick flows."""
    print(f"{'':34s}    ours    full    C3D8   C3D8I")
    for name, path in PATHS.items():
        ours, whole = work(our_brick(), path, steps), work(whole_brick(), path, steps)
        theirs = [work_in_calculix(kind, folder, path, steps) for kind in ("C3D8", "C3D8I")]
        print(f"{name:34s}", *(f"{1e3 * one:7.4f}" for one in (ours, whole, *theirs)))


def curves(folder: Path, split: int) -> None:
    """The curves of the same voxels in CalculiX, without contact of walls, and in this program, with and without it.

    C3D8 is integrated fully and too stiff where it flows; C3D8I has incompatible modes. Between plates that push, C3D8
    is held as our voxels are.
    """
    image = gyroid(16, 1)
    for axis in range(3):
        image = np.repeat(image, split, axis)
    body = body_of(image)
    columns = {kind: curve(body, kind, folder / kind, STRAINS) for kind in ("C3D8", "C3D8I")}
    columns["C3D8 pushed"] = curve(body, "C3D8", folder / "pushed", STRAINS, glued=False)
    for name, one in {"ours": body, "ours without contact": body._replace(carried=np.zeros_like(body.carried))}.items():
        march = March(one, (SOLID,), Load(0.25, 0.005))
        march.to(0.25)
        history = march.history()
        columns[name] = np.interp(STRAINS, history.strain, 0.5 * (history.top + history.bottom)) / body.shape[2] ** 2
    print(", ".join(["strain", *columns]))
    for at, *stresses in zip(STRAINS, *columns.values(), strict=True):
        print(f"{at:.4f}", *(f"{stress:.6e}" for stress in stresses))


if __name__ == "__main__":
    what, place, *more = sys.argv[1:]
    if what == "curve":
        curves(Path(place), int(more[0]) if more else 1)
    else:
        bricks(Path(place))
