"""Functions of the child process: solids and faces of a CAD file as triangles, by Open CASCADE (OCP)."""

from __future__ import annotations

import io
import math
import re
import tempfile
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from OCP.Bnd import Bnd_Box
from OCP.BRep import BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Surface
from OCP.BRepBndLib import BRepBndLib
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeSolid, BRepBuilderAPI_Sewing
from OCP.BRepGProp import BRepGProp
from OCP.BRepLib import BRepLib
from OCP.BRepMesh import BRepMesh_IncrementalMesh
from OCP.BRepTools import BRepTools
from OCP.collections import IndexedMap_TopoDS_Shape_TopTools_ShapeMapHasher as ShapeMap
from OCP.collections import Sequence_TCollection_AsciiString, Sequence_TDF_Label
from OCP.GeomAbs import GeomAbs_SurfaceType
from OCP.GeomAdaptor import GeomAdaptor_Surface
from OCP.GeomConvert import GeomConvert_SurfToAnaSurf
from OCP.GProp import GProp_GProps
from OCP.IFSelect import IFSelect_ReturnStatus
from OCP.IGESCAFControl import IGESCAFControl_Reader
from OCP.Interface import Interface_Static
from OCP.Quantity import Quantity_Color
from OCP.STEPCAFControl import STEPCAFControl_Reader
from OCP.TCollection import TCollection_ExtendedString
from OCP.TDataStd import TDataStd_Name
from OCP.TDF import TDF_Label
from OCP.TDocStd import TDocStd_Document
from OCP.TopAbs import TopAbs_Orientation, TopAbs_ShapeEnum
from OCP.TopExp import TopExp, TopExp_Explorer
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS
from OCP.XCAFDoc import XCAFDoc_ColorTool, XCAFDoc_ColorType, XCAFDoc_DocumentTool, XCAFDoc_ShapeTool
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from sppm_pipeline import InputError, notify

VOLUME_ERROR = 5e-4
"""Largest error of the volume of a body, as a fraction; for less, the triangles are made smaller."""

TRIES = 4
"""Times that the triangles are made smaller for it."""

CHORD = 0.5
"""Distance that is asked for, as a fraction of what is promised: those of a ball were found 1.8 times as far off."""

ROUND = math.radians(300)
"""Angle that coaxial pieces of a concave cylinder or cone cover at least, to be a hole and no fillet."""

SEWN = 1e-5
"""Gaps between faces that are closed, as a fraction of the size of the model: IGES files hold faces that are apart."""

ANALYTIC = 1e-6
"""Distance from a cylinder, cone, ball or plane, as a fraction of the size of a face, within which it counts as one."""

KINDS = ("plane", "cylinder", "cone", "sphere", "torus")


class Face(NamedTuple):
    """What is known of a face besides its triangles."""

    kind: str
    diameter: float | None  # of a cylinder, or the largest of a cone, mm
    concave: bool
    axis: tuple[float, ...]  # point and direction; none if it has none
    turn: float  # angle that it covers around its axis


def tessellated(
    arrays: Mapping[str, NDArray[Any]], options: Mapping[str, Any]
) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Triangles of the bodies of a STEP or IGES file, with the stretch of each face, and what the file says of it."""
    name, iges = options["name"], options["iges"]
    notify("read")
    document = TDocStd_Document(TCollection_ExtendedString("MDTV-XCAF"))
    reader = IGESCAFControl_Reader() if iges else STEPCAFControl_Reader()
    Interface_Static.SetIVal_s("read.stepcaf.subshapes.name", 1)
    reader.SetNameMode(True)
    reader.SetColorMode(True)
    data = arrays["data"].tobytes()
    if iges:
        _read_iges(reader, data)
        unit = reader.IGESModel().GlobalSection().UnitName()
        units = [] if unit is None else [unit.ToCString().strip().lower()]
    else:
        if reader.ReadStream("part.step", io.BytesIO(data)) != IFSelect_ReturnStatus.IFSelect_RetDone:
            raise InputError(f"{name} is no STEP file that can be read, or is cut off", hint="export it again")
        units = _step_units(reader)
    if not reader.Transfer(document):
        raise InputError(f"{name} holds no shape", hint="export the body, not only its sketch or drawing")
    shapes = XCAFDoc_DocumentTool.ShapeTool_s(document.Main())
    colors = XCAFDoc_DocumentTool.ColorTool_s(document.Main())
    parts = list(_parts(shapes))
    found, sheets = _bodies(parts)
    if not found:
        listed = ", ".join(dict.fromkeys(repr(part.name) for part in parts)) or "nothing"
        kind = "sheets that enclose no volume" if sheets else "no faces"
        raise InputError(
            f"{name} holds no solid body: it has {kind}, {listed[:200]}",
            hint="in the CAD program, thicken the surfaces or join them to a solid, and export that",
        )
    wanted = options["bodies"]
    known = list(dict.fromkeys(body.name for body in found))
    if missing := [one for one in wanted if one not in known and not (one.isdigit() and 0 < int(one) <= len(found))]:
        raise InputError(
            f"{name} has no body {missing[0]!r}", hint=f"it has {len(found)}: {', '.join(known[:20])[:300]}"
        )
    if wanted:
        found = [body for n, body in enumerate(found, 1) if body.name in wanted or str(n) in wanted]
    elif len(found) > options["most"]:
        raise InputError(
            f"{name} is an assembly of {len(found)} bodies; at most {options['most']} are taken together",
            hint=f"choose by `bodies`, or raise `max_bodies`; it has {', '.join(known[:8])[:200]} ...",
        )
    notify("triangles")
    made = [_triangles(body.shape, options["chord"], options["angle"]) for body in found]
    vertices, triangles, stretches, labels = [], [], [], []
    volumes = []
    base = first = 0
    for body, one in zip(found, made, strict=True):
        if one is None:
            raise InputError(f"body {body.name!r} of {name} has faces that can't be divided into triangles")
        points, corners, counts, faces, exact = one
        about = [_face(face) for face in faces]
        holes = _holes(about)
        for face, fact, hole, count in zip(faces, about, holes, counts, strict=True):
            stretches.append((first, first + count))
            first += count
            label, color = _said_of(shapes, colors, body, face)
            labels.append({"kind": fact.kind, "hole": hole, "diameter": fact.diameter, "color": color, "name": label,
                           "body": body.name})  # fmt: skip
        vertices.append(points)
        triangles.append(corners + base)
        base += len(points)
        volumes.append(exact)
    return {
        "vertices": np.concatenate(vertices),
        "faces": np.concatenate(triangles).astype(np.int32),
        "stretches": np.array(stretches, np.int32),
    }, {"labels": labels, "bodies": [body.name for body in found], "sheets": sheets, "units": units, "volumes": volumes}


def _read_iges(reader: Any, data: bytes) -> None:
    # IGES is read by name only
    with tempfile.NamedTemporaryFile(suffix=".igs") as file:
        file.write(data)
        file.flush()
        status = reader.ReadFile(file.name)
    if status != IFSelect_ReturnStatus.IFSelect_RetDone:
        raise InputError("the file is no IGES file that can be read, or is cut off", hint="export it as STEP")


def _step_units(reader: Any) -> list[str]:
    lengths, angles, solid = (Sequence_TCollection_AsciiString() for _ in range(3))
    reader.ChangeReader().FileUnits(lengths, angles, solid)
    return list(dict.fromkeys(lengths.Value(n + 1).ToCString().lower() for n in range(lengths.Length())))


class Sewn(NamedTuple):
    """Faces of a shell that was sewn, and those of the file that they come from."""

    made: Any
    given: list[Any]


class Part(NamedTuple):
    """A shape of the file in its place."""

    shape: Any
    label: Any
    name: str
    place: Any = None
    sewn: Sewn | None = None


def _parts(shapes: Any) -> Iterator[Part]:
    """Shapes of the document, those of assemblies in their places, with the names of their copies."""
    free = Sequence_TDF_Label()
    shapes.GetFreeShapes(free)

    def walk(label: Any, place: Any, name: str) -> Iterator[Part]:
        if not XCAFDoc_ShapeTool.IsAssembly_s(label):
            yield Part(XCAFDoc_ShapeTool.GetShape_s(label).Moved(place), label, name, place)
            return
        components = Sequence_TDF_Label()
        XCAFDoc_ShapeTool.GetComponents_s(label, components)
        for n in range(components.Length()):
            copy, of = components.Value(n + 1), TDF_Label()
            XCAFDoc_ShapeTool.GetReferredShape_s(copy, of)
            called = _name(copy)
            # numbers of copies as writers make them up say less than the name of the part
            called = _name(of) if re.fullmatch(r"|NAUO\d+|=>\[.*\]|\d+", called) else called
            yield from walk(of, place.Multiplied(XCAFDoc_ShapeTool.GetLocation_s(copy)), called or name)

    for n in range(free.Length()):
        yield from walk(free.Value(n + 1), TopLoc_Location(), _name(free.Value(n + 1)))


def _name(label: Any) -> str:
    key, found = TDataStd_Name.GetID_s(), TDataStd_Name()
    # to look for an attribute that is not there would end the process
    if label.IsNull() or not label.IsAttribute(key) or not label.FindAttribute(key, found):
        return ""
    text = found.Get()
    # an empty string has no first character to point to
    return "" if text.IsEmpty() else " ".join(text.ToExtString().split())[:100]


def _explored(shape: Any, kind: Any, avoid: Any = TopAbs_ShapeEnum.TopAbs_SHAPE) -> Iterator[Any]:
    explorer = TopExp_Explorer(shape, kind, avoid)
    while explorer.More():
        yield explorer.Current()
        explorer.Next()


def _bodies(parts: list[Part]) -> tuple[list[Part], int]:
    """Solids, those included that loose faces are sewn to, and the number of parts that hold sheets."""
    found: list[Part] = []
    sheets: list[Part] = []

    def add(part: Part, solids: list[Any], sewn: Sewn | None = None) -> None:
        for solid in solids:
            found.append(part._replace(shape=solid, name=part.name or f"body {len(found) + 1}", sewn=sewn))

    for part in parts:
        add(part, list(_explored(part.shape, TopAbs_ShapeEnum.TopAbs_SOLID)))
        loose = list(_explored(part.shape, TopAbs_ShapeEnum.TopAbs_FACE, TopAbs_ShapeEnum.TopAbs_SOLID))
        if loose:
            solids, sewn = _sewn(loose)
            add(part, solids, sewn)
            sheets += [] if solids else [part]
    if not found and len(sheets) > 1:  # faces of IGES come one by one
        loose = [face for part in sheets for face in _explored(part.shape, TopAbs_ShapeEnum.TopAbs_FACE)]
        solids, sewn = _sewn(loose)
        add(parts[0]._replace(name=""), solids, sewn)
        sheets = [] if solids else sheets
    return found, len(sheets)


def _sewn(faces: list[Any]) -> tuple[list[Any], Sewn]:
    """Closed shells of faces, as solids that are not inside out."""
    box = Bnd_Box()
    for face in faces:
        BRepBndLib.Add_s(face, box)
    sewing = BRepBuilderAPI_Sewing(SEWN * math.sqrt(box.SquareExtent()))
    for face in faces:
        sewing.Add(face)
    sewing.Perform()
    made = ShapeMap()
    given: list[Any] = []
    for face in faces:
        if made.Add(sewing.ModifiedSubShape(face)) > len(given):
            given.append(face)
    solids = []
    for shell in _explored(sewing.SewedShape(), TopAbs_ShapeEnum.TopAbs_SHELL):
        if BRep_Tool.IsClosed_s(shell):
            solid = BRepBuilderAPI_MakeSolid(TopoDS.Shell(shell)).Solid()
            if BRepLib.OrientClosedSolid_s(solid):
                solids.append(solid)
    return solids, Sewn(made, given)


def _triangles(solid: Any, chord: float, angle: float) -> tuple[Any, ...] | None:
    """Vertices, triangles, their number for each face, the faces, and the exact volume of a solid; None if it fails."""
    props = GProp_GProps()
    BRepGProp.VolumeProperties_s(solid, props)
    exact = float(props.Mass())
    chord *= CHORD
    for _ in range(TRIES):
        BRepTools.Clean_s(solid)
        BRepMesh_IncrementalMesh(solid, chord, False, angle, False)
        made = _merged(solid)
        if made is None:
            return None
        points, corners = made[:2]
        a, b, c = (points[corners[:, n]] for n in range(3))
        volume = float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6
        error = abs(volume / exact - 1) if exact else math.inf
        if error <= VOLUME_ERROR:
            break
        chord, angle = chord * max(0.1, 0.7 * VOLUME_ERROR / error), angle / 2
    return (*made, exact)


def _merged(solid: Any) -> tuple[Any, ...] | None:
    """The triangles of all faces, joined along the edges that faces share."""
    edges = ShapeMap()
    TopExp.MapShapes_s(solid, TopAbs_ShapeEnum.TopAbs_EDGE, edges)
    seen: dict[int, NDArray[np.int64]] = {}
    points, corners, faces = [], [], []
    pairs: list[NDArray[np.int64]] = []
    base = 0
    for shape in _explored(solid, TopAbs_ShapeEnum.TopAbs_FACE):
        face, place = TopoDS.Face(shape), TopLoc_Location()
        mesh = BRep_Tool.Triangulation_s(face, place)
        if mesh is None:
            return None
        move = place.Transformation()
        own = np.array(
            [(p.X(), p.Y(), p.Z()) for p in (mesh.Node(n + 1).Transformed(move) for n in range(mesh.NbNodes()))]
        )
        ends = np.array([mesh.Triangle(n + 1).Get() for n in range(mesh.NbTriangles())], np.int64).reshape(-1, 3) - 1
        if face.Orientation() == TopAbs_Orientation.TopAbs_REVERSED:
            ends = ends[:, ::-1]
        for edge in map(TopoDS.Edge, _explored(face, TopAbs_ShapeEnum.TopAbs_EDGE)):
            line = BRep_Tool.PolygonOnTriangulation_s(edge, mesh, place)
            if line is None:
                continue
            nodes = np.array([line.Node(n + 1) for n in range(line.NbNodes())]) - 1 + base
            if BRep_Tool.Degenerated_s(edge):
                pairs.append(np.stack([nodes[:-1], nodes[1:]]))
                continue
            other = seen.setdefault(edges.FindIndex(edge), nodes)
            if len(other) == len(nodes):
                pairs.append(np.stack([other, nodes]))
        points.append(own)
        corners.append(ends + base)
        faces.append(face)
        base += len(own)
    joined = np.concatenate([np.empty((2, 0), np.int64), *pairs], axis=1)
    graph = coo_array((np.ones(joined.shape[1], np.int8), (joined[0], joined[1])), (base, base))
    count, which = connected_components(graph, directed=False)
    first = np.full(count, base)
    np.minimum.at(first, which, np.arange(base))
    vertices = np.concatenate(points)[first]
    for n, ends in enumerate(corners):
        ends = which[ends]
        corners[n] = ends[(ends[:, 0] != ends[:, 1]) & (ends[:, 1] != ends[:, 2]) & (ends[:, 2] != ends[:, 0])]
    return vertices, np.concatenate(corners), [len(ends) for ends in corners], faces


def _face(face: Any) -> Face:
    """Kind, diameter and axis of a face; what only describes a plane, cylinder, cone or ball is one."""
    surface: Any = BRepAdaptor_Surface(face)
    if surface.GetType() in (GeomAbs_SurfaceType.GeomAbs_BSplineSurface, GeomAbs_SurfaceType.GeomAbs_BezierSurface,
                             GeomAbs_SurfaceType.GeomAbs_SurfaceOfRevolution,
                             GeomAbs_SurfaceType.GeomAbs_SurfaceOfExtrusion):  # fmt: skip
        box = Bnd_Box()
        BRepBndLib.Add_s(face, box)
        convert = GeomConvert_SurfToAnaSurf(BRep_Tool.Surface_s(face))
        analytic = convert.ConvertToAnalytical(ANALYTIC * math.sqrt(box.SquareExtent()))
        if analytic is not None:
            surface = GeomAdaptor_Surface(analytic)
    kind = str(surface.GetType()).rpartition("_")[2].lower()
    if kind not in KINDS:
        return Face("freeform", None, False, (), 0.0)
    if kind not in ("cylinder", "cone"):
        return Face(kind, 2 * surface.Sphere().Radius() if kind == "sphere" else None, False, (), 0.0)
    body = surface.Cylinder() if kind == "cylinder" else surface.Cone()
    point, way = body.Axis().Location(), body.Axis().Direction()
    axis = (point.X(), point.Y(), point.Z(), way.X(), way.Y(), way.Z())
    points, normals = _corners(face)
    across = points - axis[:3]
    across -= np.outer(across @ axis[3:], axis[3:])
    radii = np.linalg.norm(across, axis=1)
    concave = float(np.einsum("ij,ij->", across, normals)) < 0
    diameter = 2 * body.Radius() if kind == "cylinder" else 2 * float(radii.max())
    # angle that the middles of its triangles leave free
    e = np.eye(3)[np.argmin(np.abs(axis[3:]))]
    u = np.cross(axis[3:], e)
    angles = np.sort(np.arctan2(across @ np.cross(axis[3:], u), across @ u))
    gap = float(np.diff(angles, append=angles[0] + 2 * math.pi).max()) if len(angles) else 2 * math.pi
    return Face(kind, diameter, concave, axis, 2 * math.pi - gap)


def _corners(face: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Corners of the triangles of a face, each with the normal of its triangle, which points out of the solid."""
    place = TopLoc_Location()
    mesh = BRep_Tool.Triangulation_s(face, place)
    move = place.Transformation()
    own = np.array([(p.X(), p.Y(), p.Z()) for p in (mesh.Node(n + 1).Transformed(move) for n in range(mesh.NbNodes()))])
    ends = np.array([mesh.Triangle(n + 1).Get() for n in range(mesh.NbTriangles())], np.int64).reshape(-1, 3) - 1
    if face.Orientation() == TopAbs_Orientation.TopAbs_REVERSED:
        ends = ends[:, ::-1]
    a, b, c = (own[ends[:, n]] for n in range(3))
    return np.concatenate([a, b, c]), np.tile(np.cross(b - a, c - a), (3, 1))


def _holes(faces: list[Face]) -> list[bool]:
    """Faces of holes: concave cylinders and cones around an axis, which go around it, or nearly."""
    made = [False] * len(faces)
    concave = [n for n, face in enumerate(faces) if face.concave]
    for n in concave:
        one = faces[n]
        own = np.array(one.axis)
        # pieces of one hole: the same axis and, of cylinders, the same diameter
        turn = 0.0
        for m in concave:
            other = np.array(faces[m].axis)
            apart = np.cross(other[:3] - own[:3], own[3:])
            size = 1e-4 * (one.diameter or 0.0)
            along = abs(float(own[3:] @ other[3:])) > 1 - 1e-8 and float(np.linalg.norm(apart)) < size
            alike = faces[m].kind == one.kind and abs((faces[m].diameter or 0.0) - (one.diameter or 0.0)) < size
            turn += faces[m].turn * (along and alike)
        made[n] = turn >= ROUND
    return made


def _said_of(shapes: Any, colors: Any, body: Part, face: Any) -> tuple[str, str]:
    """Name and color of a face, the color of its body if it has none of its own; "" if there is none."""
    if body.sewn is not None and (number := body.sewn.made.FindIndex(face)):
        face = body.sewn.given[number - 1]
    if body.place is not None:
        face = face.Moved(body.place.Inverted())
    label, color = TDF_Label(), Quantity_Color()
    named = shapes.FindSubShape(body.label, face, label)
    kinds = (XCAFDoc_ColorType.XCAFDoc_ColorSurf, XCAFDoc_ColorType.XCAFDoc_ColorGen)
    solid = body.shape if body.place is None else body.shape.Moved(body.place.Inverted())
    found = any(colors.GetColor(shape, kind, color) for shape in (face, solid) for kind in kinds) or any(
        XCAFDoc_ColorTool.GetColor_s(body.label, kind, color) for kind in kinds
    )
    return _name(label) if named else "", Quantity_Color.ColorToHex_s(color).ToCString().lower() if found else ""
