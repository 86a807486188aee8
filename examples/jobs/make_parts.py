"""Parts of the jobs that are not made of primitives: a bracket as a STEP file, an insole as STL.

Usage: ``python make_parts.py [FOLDER]``. The bracket needs Open CASCADE, which the plugin sppm-cad installs.
"""

import sys
from pathlib import Path

import numpy as np

import sppm_pipeline as sppm

LENGTH = 256.0


def bracket(path: Path) -> None:
    """An angle with a gusset, 70 x 40 x 60 mm, with four holes for bolts of 6 mm and a red face for the load."""
    from OCP.BRepAlgoAPI import BRepAlgoAPI_Cut
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeFace, BRepBuilderAPI_MakePolygon
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeCylinder, BRepPrimAPI_MakePrism
    from OCP.gp import gp_Ax2, gp_Dir, gp_Pnt, gp_Vec
    from OCP.Interface import Interface_Static
    from OCP.STEPControl import STEPControl_StepModelType, STEPControl_Writer

    outline = BRepBuilderAPI_MakePolygon()
    for x, z in ((0, 0), (70, 0), (70, 12), (34, 12), (12, 34), (12, 60), (0, 60)):
        outline.Add(gp_Pnt(x, 0, z))
    outline.Close()
    shape = BRepPrimAPI_MakePrism(BRepBuilderAPI_MakeFace(outline.Wire()).Face(), gp_Vec(0, 40, 0)).Shape()
    for y in (9, 31):
        for place, way in (((56, y, -1), (0, 0, 1)), ((-1, y, 48), (1, 0, 0))):
            hole = BRepPrimAPI_MakeCylinder(gp_Ax2(gp_Pnt(*place), gp_Dir(*way)), 3.3, 14.0).Shape()
            shape = BRepAlgoAPI_Cut(shape, hole).Shape()
    writer = STEPControl_Writer()  # the settings are there from now on
    Interface_Static.SetCVal_s("write.step.unit", "MM")
    writer.Transfer(shape, STEPControl_StepModelType.STEPControl_AsIs)
    writer.Write(str(path))


def insole(along: int = 160, across: int = 60) -> sppm.SurfaceMesh:
    """A right insole of 256 mm: heel at x = 0, the arch toward +y, a cup around the heel; its bottom is flat."""
    x = LENGTH * (1 - np.cos(np.pi * np.linspace(0, 1, along))) / 2
    knots = np.array([0, 35, 75, 115, 150, 185, 220, LENGTH])
    middle = np.interp(x, knots, [0, 0, -2, -7, -6, -1, 3, 6])
    half = np.interp(x, knots, [30, 33, 32, 29, 34, 45, 46, 40])
    smooth = np.ones(15) / 15
    middle, half = (np.convolve(np.pad(v, 7, "edge"), smooth, "valid") for v in (middle, half))
    half *= np.maximum(1 - np.abs(2 * x / LENGTH - 1) ** 5, 0) ** 0.5
    v = np.sin(np.pi / 2 * np.linspace(-1, 1, across))
    grid_x, grid_y = np.broadcast_to(x[:, None], (along, across)), middle[:, None] + half[:, None] * v
    back = 1 / (1 + np.exp((x - 120) / 18))[:, None]  # 1 at the heel, 0 at the toes
    top = 6 + 5 * back + 9 * back * np.abs(v) ** 4
    top = top + 7 * np.exp(-(((grid_x - 112) / 38) ** 2) - ((grid_y - 26) / 13) ** 2)
    top -= 2.5 * np.exp(-(((grid_x - 36) / 22) ** 2) - (grid_y / 18) ** 2)
    upper = np.stack([grid_x, grid_y, top], axis=-1).reshape(-1, 3)
    lower = upper * [1, 1, 0]
    # the first and last rows are single points: the outline closes there
    number = np.arange(along * across).reshape(along, across)
    number[0], number[-1] = number[0, 0], number[-1, 0]
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 0] != faces[:, 2])]
    n = len(upper)
    rim = np.concatenate([number[:, 0], number[-2:0:-1, -1]])
    after = np.roll(rim, -1)
    walls = np.concatenate([np.stack([rim, rim + n, after], -1), np.stack([after, rim + n, after + n], -1)])
    return sppm.SurfaceMesh(np.concatenate([upper, lower]), np.concatenate([faces, faces[:, ::-1] + n, walls]))


def main() -> None:
    """Write both."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
    sppm.write.mesh(insole(), path="insole.stl", output=folder)
    bracket(folder / "bracket.step")


if __name__ == "__main__":
    main()
