"""CAD files for tests, made by Open CASCADE: a bracket with holes, a boss, colors and names; and broken ones."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from OCP.BRepAdaptor import BRepAdaptor_Surface
from OCP.BRepAlgoAPI import BRepAlgoAPI_Cut, BRepAlgoAPI_Fuse
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeFace
from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox, BRepPrimAPI_MakeCylinder, BRepPrimAPI_MakeSphere
from OCP.GeomAbs import GeomAbs_SurfaceType
from OCP.gp import gp_Ax2, gp_Dir, gp_Pln, gp_Pnt, gp_Trsf, gp_Vec
from OCP.IFSelect import IFSelect_ReturnStatus
from OCP.IGESCAFControl import IGESCAFControl_Writer
from OCP.Interface import Interface_Static
from OCP.Quantity import Quantity_Color, Quantity_TypeOfColor
from OCP.STEPCAFControl import STEPCAFControl_Writer
from OCP.STEPControl import STEPControl_StepModelType
from OCP.TCollection import TCollection_ExtendedString
from OCP.TDataStd import TDataStd_Name
from OCP.TDocStd import TDocStd_Document
from OCP.TopAbs import TopAbs_ShapeEnum
from OCP.TopExp import TopExp_Explorer
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS
from OCP.XCAFDoc import XCAFDoc_ColorType, XCAFDoc_DocumentTool

GRAY, RED = (0.7, 0.7, 0.7), (1.0, 0.0, 0.0)


def cylinder(x: float, y: float, z: float, way: tuple[float, float, float], radius: float, height: float) -> Any:
    return BRepPrimAPI_MakeCylinder(gp_Ax2(gp_Pnt(x, y, z), gp_Dir(*way)), radius, height).Shape()


def box(*sides: float) -> Any:
    return BRepPrimAPI_MakeBox(gp_Pnt(0, 0, 0), *sides).Shape()


def ball(x: float, y: float, z: float, radius: float) -> Any:
    return BRepPrimAPI_MakeSphere(gp_Pnt(x, y, z), radius).Shape()


def bracket() -> Any:
    """Holes of 5, 8 and 5 mm, the second one red and named, a boss of 6 mm."""
    made = BRepAlgoAPI_Fuse(box(60, 30, 6), box(6, 30, 40)).Shape()
    for tool in (cylinder(25, 15, -1, (0, 0, 1), 2.5, 9), cylinder(48, 15, -1, (0, 0, 1), 4, 9),
                 cylinder(-1, 15, 28, (1, 0, 0), 2.5, 9)):  # fmt: skip
        made = BRepAlgoAPI_Cut(made, tool).Shape()
    return BRepAlgoAPI_Fuse(made, cylinder(36, 8, 6, (0, 0, 1), 3, 5)).Shape()


def sheet() -> Any:
    return BRepBuilderAPI_MakeFace(gp_Pln(), 0, 10, 0, 10).Shape()


def write(path: Path, shapes: dict[str, Any], unit: str = "MM", copies: int = 0, red_radius: float = 4.0) -> Path:
    """Write shapes under their names; with `copies`, an assembly of so many copies of the first one."""
    document = TDocStd_Document(TCollection_ExtendedString("XmlOcaf"))
    tool = XCAFDoc_DocumentTool.ShapeTool_s(document.Main())
    colors = XCAFDoc_DocumentTool.ColorTool_s(document.Main())
    surface = XCAFDoc_ColorType.XCAFDoc_ColorSurf
    for name, shape in shapes.items():
        label = tool.AddShape(shape, False)
        TDataStd_Name.Set_s(label, TCollection_ExtendedString(name))
        colors.SetColor(label, Quantity_Color(*GRAY, Quantity_TypeOfColor.Quantity_TOC_sRGB), surface)
        explorer = TopExp_Explorer(shape, TopAbs_ShapeEnum.TopAbs_FACE)
        while explorer.More():
            face = TopoDS.Face(explorer.Current())
            about = BRepAdaptor_Surface(face)
            if about.GetType() == GeomAbs_SurfaceType.GeomAbs_Cylinder and about.Cylinder().Radius() == red_radius:
                own = tool.AddSubShape(label, face)
                TDataStd_Name.Set_s(own, TCollection_ExtendedString("bearing seat"))
                colors.SetColor(own, Quantity_Color(*RED, Quantity_TypeOfColor.Quantity_TOC_sRGB), surface)
            explorer.Next()
    if copies:
        top = tool.NewShape()
        TDataStd_Name.Set_s(top, TCollection_ExtendedString("assembly"))
        for n in range(copies):
            move = gp_Trsf()
            move.SetTranslation(gp_Vec(20.0 * n, 0, 0))
            tool.AddComponent(top, label, TopLoc_Location(move))
        tool.UpdateAssemblies()
    if path.suffix == ".igs":
        writer: Any = IGESCAFControl_Writer()
        writer.Transfer(document)
        assert writer.Write(str(path))
        return path
    writer = STEPCAFControl_Writer()  # the settings are there from now on
    Interface_Static.SetCVal_s("write.step.unit", unit)
    Interface_Static.SetIVal_s("write.stepcaf.subshapes.name", 1)
    writer.SetNameMode(True)
    writer.SetColorMode(True)
    writer.Transfer(document, STEPControl_StepModelType.STEPControl_AsIs)
    assert writer.Write(str(path)) == IFSelect_ReturnStatus.IFSelect_RetDone
    return path
