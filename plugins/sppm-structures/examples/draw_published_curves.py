"""Draw the stiffness that configs/published_curves.yaml gave beside theory, by matplotlib.

    python draw_published_curves.py RUN_DIRECTORY PICTURE

Lines: slender octet E = rho / 9, slender Kelvin cell of round struts E = 0.6 rho^2, slender simple cubic E = rho / 3.
Dashes: the upper bound of Hashin and Shtrikman (1963), as Young's modulus of an isotropic solid whose bulk and shear
modulus reach it.
"""

import json
import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

# color-blind safe (Okabe and Ito 2008)
LOOKS = {
    "octet": ("octet", "#0072b2", "o"),
    "kelvin": ("Kelvin", "#d55e00", "s"),
    "simple_cubic": ("simple cubic", "#009e73", "^"),
    "schwarz_p": ("Schwarz P", "#cc79a7", "D"),
    "gyroid": ("gyroid", "#e69f00", "v"),
}
THEORY = {"octet": lambda d: d / 9, "kelvin": lambda d: 0.6 * d**2, "simple_cubic": lambda d: d / 3}


def draw(run: Path, picture: Path) -> None:
    """Points of a sweep and lines of theory over relative density, both axes logarithmic."""
    rows = [row for row in json.loads((run / "sweep.json").read_text(encoding="utf-8")) if row["status"] == "done"]
    density = np.geomspace(0.01, 0.4, 60)
    figure = Figure(figsize=(5.0, 3.6), layout="constrained")
    axes = figure.add_subplot(
        xscale="log", yscale="log", xlabel=r"relative density $\bar\rho$", ylabel=r"$E_x / E_\mathrm{s}$"
    )
    axes.plot(density, bound(density), "--", color="#888888", linewidth=1.2, label="Hashin–Shtrikman")
    for name, (label, color, marker) in LOOKS.items():
        if name in THEORY:
            axes.plot(density, THEORY[name](density), color=color, linewidth=1.0)
        own = [row for row in rows if row["structure"] == name]
        x, y = (np.array([row[key] for row in own], float) for key in ("elastic.porosity", "elastic.E.1"))
        axes.plot(
            1 - x, y, marker, color=color, markersize=4.5, markeredgecolor="white", markeredgewidth=0.4, label=label
        )
    axes.tick_params(which="both", direction="in", top=True, right=True)
    axes.grid(color="#e4e7eb", linewidth=0.6)
    axes.legend(title="points: voxels, lines: slender struts", fontsize=8, title_fontsize=8, loc="lower right")
    figure.savefig(picture, dpi=200)


def bound(density: np.ndarray) -> np.ndarray:
    """Young's modulus over that of the solid where bulk and shear modulus are at their upper bounds; nu = 0.3."""
    k, g = 1 / (3 * (1 - 2 * 0.3)), 1 / (2 * (1 + 0.3))
    bulk = 4 * k * g * density / (4 * g + 3 * k * (1 - density))
    shear = g * density * (9 * k + 8 * g) / (9 * k + 8 * g + 6 * (k + 2 * g) * (1 - density))
    return 9 * bulk * shear / (3 * bulk + shear)


if __name__ == "__main__":
    draw(Path(sys.argv[1]), Path(sys.argv[2]))
