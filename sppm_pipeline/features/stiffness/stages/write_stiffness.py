"""``write.stiffness``: effective stiffness as JSON, material card and picture."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sppm_pipeline import ConfigError, Context, Stage, option, options
from sppm_pipeline.engine.strict_json import jsonable
from sppm_pipeline.method.nouns.stiffness import StiffnessReport
from sppm_pipeline.services.arrays import F64, I32, U8

# Abaqus and CalculiX count 11, 22, 33, 12, 13, 23; these are the places in xx, yy, zz, yz, xz, xy
_VOIGT = (0, 1, 2, 5, 4, 3)


def abaqus_constants(stiffness: F64) -> list[float]:
    """The 21 constants D1111, D1122, D2222, D1133, ... D2323 of Abaqus and CalculiX, column by column.

    The stiffness (6, 6) is in Voigt order xx, yy, zz, yz, xz, xy.
    """
    ordered = stiffness[np.ix_(_VOIGT, _VOIGT)]
    return [float(ordered[row, column]) for column in range(6) for row in range(column + 1)]


def abaqus_card(name: str, stiffness: F64, comments: list[str]) -> str:
    """A ``*MATERIAL`` with ``*ELASTIC, TYPE=ANISO``, as Abaqus and CalculiX read it, below lines of comments.

    The name has letters, digits, ``_`` and ``-``, and begins with a letter.
    """
    if not (name[:1].isalpha() and name.isascii() and name.replace("_", "").replace("-", "").isalnum()):
        raise ValueError(f"a material is named by letters, digits, _ and -, got {name!r}")
    words = [f"{value:.9g}" for value in abaqus_constants(stiffness)]
    rows = [", ".join(words[start : start + 8]) for start in range(0, 21, 8)]
    return (
        "\n".join([*(f"** {line}" for line in comments), f"*MATERIAL, NAME={name}", "*ELASTIC, TYPE=ANISO", *rows])
        + "\n"
    )


@dataclass(frozen=True, kw_only=True)
class WriteStiffness(Stage):
    """Write a folder with all that is known of an effective stiffness.

    ``stiffness.json`` holds the matrix, moduli, isotropy and bounds; ``material.inp`` is a material card that Abaqus
    and CalculiX read, with the error bars of its constants as comments if the grid's error was estimated;
    ``young.png`` shows Young's modulus over all directions, as a surface whose distance from the center and color are
    the modulus; ``young.ply`` is that surface, one unit of length for the largest modulus.
    """

    name: ClassVar[str] = "write.stiffness"
    version: ClassVar[int] = 3
    advice: ClassVar[str] = "give a smaller `image_size`"

    path: str = options.write_path("stiffness", suffixes=("/",))
    material: str = option("SPPM", help="name of the material in the card")
    image_size: tuple[int, int] = options.image_size((900, 800), minimum=300, formerly="size")

    def check_options(self) -> None:
        if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_-]{0,79}", self.material):
            raise ConfigError(f"`material` is {self.material!r}; allowed are letters, digits, _ and -, a letter first")

    def run(self, context: Context, report: StiffnessReport) -> None:
        """Write everything."""
        from PIL import Image

        from sppm_pipeline.services.elastic.directional import sphere_mesh, young_along
        from sppm_pipeline.services.formats import ply

        folder = context.output(self.path)
        folder.mkdir(parents=True)
        unit = report.unit or "the unit of the base material"
        (folder / "stiffness.json").write_text(
            json.dumps(jsonable(report.summary()), indent=1, allow_nan=False) + "\n", encoding="utf-8"
        )
        comments = [
            f"effective stiffness of a porous cell, porosity {report.porosity:.4f}, {report.method}",
            f"unit of stress: {unit}; axes 1, 2, 3 are x, y, z of the cell",
            *_error_bars(report),
        ]
        (folder / "material.inp").write_text(abaqus_card(self.material, report.stiffness, comments), encoding="ascii")
        directions, faces = sphere_mesh(5)
        young = young_along(report.stiffness, directions)
        largest = float(young.max())
        if not largest > 0:
            context.warn("the structure has no stiffness in any direction; there is no surface of moduli to draw")
            return
        surface = directions * (young / largest)[:, None]
        (folder / "young.ply").write_bytes(b"".join(ply.encode(surface, faces)))
        picture = young_picture(surface, faces, young, report.unit, self.image_size)
        Image.fromarray(picture).save(folder / "young.png")


def _error_bars(report: StiffnessReport) -> list[str]:
    """Comments on how far the constants of the card may be from those of a fine grid."""

    if report.error is None:
        return ["error of the grid: not estimated (homogenize.voxel does with grids: 2 or 3)"]
    summary = report.summary()
    words = [f"{value:.2g}" for value in abaqus_constants(report.error)]
    moduli = [f"{e:.4g} +- {error:.2g}" for e, error in zip(summary["E"], summary["E_error"], strict=True)]
    return [
        f"error of the grid: {summary['error_relative']:.2%} of the stiffness; Young's moduli {', '.join(moduli)}",
        "error bar of each constant, in the order of the card:",
        *(f"  {', '.join(words[start : start + 8])}" for start in range(0, 21, 8)),
    ]


def young_picture(surface: F64, faces: I32, young: F64, unit: str | None, size: tuple[int, int]) -> U8:
    """The surface of moduli in color, with the directions of the axes and a scale beside it."""
    from sppm_pipeline.services.pictures.camera import Camera, framed
    from sppm_pipeline.services.pictures.mesh_view import render_mesh
    from sppm_pipeline.services.pictures.sheets import annotated, colors_of, with_scale

    low, high = float(young.min()), float(young.max())
    # of a nearly isotropic material a range of rounding errors would look like a range
    low = min(low, 0.999 * high)
    colors = colors_of(young[faces].mean(axis=1), low, high)
    shape = size[0] - 140, size[1]
    picture = render_mesh(surface, faces, size=shape, face_colors=colors)
    picture = annotated(picture, framed(Camera(), surface, shape), None, bar=False)
    return with_scale(picture, low, high, f"E(n) / {unit}" if unit else "E(n)", 140)
