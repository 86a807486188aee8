"""Draw the stiffness that configs/published_curves.yaml gave over theory.

    python draw_published_curves.py RUN_DIRECTORY PICTURE

Lines: slender octet E = rho / 9, slender Kelvin cell of round struts E = 0.6 rho^2, slender simple cubic E = rho / 3.
Dashes: the upper bound of Hashin and Shtrikman, as Young's modulus of an isotropic solid whose bulk and shear modulus
reach it.
"""

import json
import sys
from pathlib import Path

import numpy as np
from PIL import Image

from sppm_pipeline.numerics.homogenization.stiffness.bounds import hashin_shtrikman
from sppm_pipeline.render.charts import chart
from sppm_pipeline.render.series import Line, Points

COLORS = {
    "octet": (46, 98, 158),
    "kelvin": (206, 96, 62),
    "simple_cubic": (66, 140, 104),
    "schwarz_p": (136, 92, 158),
    "gyroid": (196, 148, 44),
}
THEORY = {"octet": lambda d: d / 9, "kelvin": lambda d: 0.6 * d**2, "simple_cubic": lambda d: d / 3}


def draw(run: Path, picture: Path) -> None:
    """Points of a sweep and lines of theory over relative density, both axes logarithmic."""
    rows = [row for row in json.loads((run / "sweep.json").read_text(encoding="utf-8")) if row["status"] == "done"]
    density = np.geomspace(0.01, 0.4, 60)
    shown: list[Line | Points] = [Line(density, [bound(d) for d in density], "Hashin-Shtrikman", (96, 104, 114), True)]
    for name, color in COLORS.items():
        own = [row for row in rows if row["structure"] == name]
        if name in THEORY:
            shown.append(Line(density, THEORY[name](density), "", color))
        x, y = ([row[key] for row in own] for key in ("elastic.porosity", "elastic.E.1"))
        shown.append(Points(1 - np.array(x), y, name, color))
    image = chart(shown, x_label="relative density", y_label="E_x / E_s", x_log=True, y_log=True)
    Image.fromarray(image).save(picture)


def bound(density: float) -> float:
    """Young's modulus over that of the solid where bulk and shear modulus are at their upper bounds; nu = 0.3."""
    bulk, shear = hashin_shtrikman([(density, 1.0, 0.3), (1 - density, 0.0, 0.0)])
    return 9 * bulk.upper * shear.upper / (3 * bulk.upper + shear.upper)


if __name__ == "__main__":
    draw(Path(sys.argv[1]), Path(sys.argv[2]))
