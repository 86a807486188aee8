"""Projects of PrusaSlicer: parts with names, kinds and settings, written, read, kept, and sliced where it is there."""

import io
import math
import re
import shutil
import subprocess
import zipfile
from xml.etree import ElementTree

import numpy as np
import pytest

from sppm_pipeline.errors import ConfigError, DesignError, InputError
from sppm_pipeline.features.files.formats.print_project import LISTED, OF_ORCA
from sppm_pipeline.features.files.formats.three_mf import read_project
from sppm_pipeline.features.files.stages.read_mesh import ReadMesh
from sppm_pipeline.features.files.stages.write_project import WriteProject
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.mesh.measures import volume
from sppm_pipeline.testing.plain_context import PlainContext

FACES = [(0, 2, 3), (0, 3, 1), (4, 5, 7), (4, 7, 6), (0, 1, 5), (0, 5, 4), (2, 6, 7), (2, 7, 3), (0, 4, 6), (0, 6, 2),
         (1, 3, 7), (1, 7, 5)]  # fmt: skip


def box(size, at=(0, 0, 0)):
    corners = [[at[a] + size[a] * (k >> a & 1) for a in range(3)] for k in range(8)]
    return SurfaceMesh(np.array(corners, float), np.array(FACES, np.int32), "box")


OUTER, BAR = box((20, 20, 20)), box((4, 20, 20), (8, 0, 0))
SKIN = SurfaceMesh(
    # walls of two lines of 0.45 mm, which overlap by their round edges, and plates of five layers
    np.vstack([OUTER.vertices, [0.86, 0.86, 1] + OUTER.vertices * [0.914, 0.914, 0.9]]),
    np.vstack([OUTER.faces, OUTER.faces[:, ::-1] + 8]), "skin",
)  # fmt: skip


def write(folder, *meshes, **options):
    stage = WriteProject(**options)
    stage.check_options()
    context = PlainContext(directory=folder)
    stage.run(context, *meshes, *[None] * (4 - len(meshes)))
    return (folder / stage.path).read_bytes(), context.reported


def parts_of(data):
    """Settings of the object, and (name, kind, settings, first, last) of its parts as the file lists them."""
    root = ElementTree.fromstring(zipfile.ZipFile(io.BytesIO(data)).read(LISTED))

    def values(element):
        return {entry.get("key"): entry.get("value") for entry in element.findall("metadata")}

    (found,) = root.findall("object")
    parts = []
    for entry in found.findall("volume"):
        about = values(entry)
        name, kind = about.pop("name"), about.pop("volume_type")
        parts.append((name, kind, about, int(entry.get("firstid")), int(entry.get("lastid"))))
    return values(found), parts


def test_parts_have_names_kinds_and_settings(tmp_path):
    data, reported = write(
        tmp_path, SKIN, BAR, box((5, 5, 5)), names=("skin", "struts", "corner"), kinds=("part", "part", "modifier"),
        settings=("skin: perimeters = 2", "struts:fill_density=100%", "object: layer_height = 0.2"), title="A <b>",
    )  # fmt: skip
    about, parts = parts_of(data)
    assert about == {"name": "A <b>", "layer_height": "0.2"}
    # what is listed later is made where parts overlap, so that the first port comes last
    assert parts == [
        ("corner", "ParameterModifier", {}, 0, 11),
        ("struts", "ModelPart", {"fill_density": "100%", "sparse_infill_density": "100%"}, 12, 23),
        ("skin", "ModelPart", {"perimeters": "2", "wall_loops": "2"}, 24, 47),
    ]
    assert [entry["triangles"] for entry in reported["parts"]] == [12, 12, 24]
    assert write(tmp_path, SKIN, BAR, box((5, 5, 5)), path="b.3mf", names=("skin", "struts", "corner"),
                 kinds=("part", "part", "modifier"), settings=("skin: perimeters = 2", "struts:fill_density=100%",
                 "object: layer_height = 0.2"), title="A <b>")[0] == data  # fmt: skip


def test_solid_parts_are_read_and_modifiers_are_not(tmp_path):
    write(tmp_path, SKIN, BAR, box((50, 5, 5)), kinds=("part", "part", "modifier"), names=("skin", "struts", "more"))
    made = ReadMesh(path=tmp_path / "project.3mf").run(PlainContext())
    assert np.allclose([made.lower, made.upper], [[0, 0, 0], [20, 20, 20]])
    assert volume(made.vertices, made.faces) == pytest.approx(20**3 - 18.28**2 * 18 + 1600)
    assert made.groups == (("struts", 0, 12), ("skin", 12, 36))


def test_a_nozzle_sets_the_least_width(tmp_path):
    about, _ = parts_of(write(tmp_path, OUTER, nozzle=Length(0.6), settings=("object: gap_fill_enabled = 1",))[0])
    assert (about["perimeter_generator"], about["wall_generator"], about["gap_fill_enabled"]) == (*2 * ["classic"], "1")
    assert about["external_perimeter_extrusion_width"] == about["outer_wall_line_width"] == "0.675"


def saved(**changed):
    """A project as PrusaSlicer lays it out: a part, a blocker and settings, moved on the bed."""
    meshes = [OUTER, box((2, 2, 2), (1, 2, 3))]
    points = np.vstack([mesh.vertices for mesh in meshes])
    faces = np.vstack([FACES, np.array(FACES) + 8])
    model = (
        '<model unit="millimeter" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02"><resources>'
        '<object id="7" type="model"><mesh><vertices>'
        + "".join('<vertex x="{}" y="{}" z="{}"/>'.format(*row) for row in points.tolist())
        + "</vertices><triangles>"
        + "".join('<triangle v1="{}" v2="{}" v3="{}"/>'.format(*row) for row in faces.tolist())
        + '</triangles></mesh></object></resources><build><item objectid="7" transform="1 0 0 0 1 0 0 0 1 100 90 0"/>'
        + changed.get("items", "")
        + "</build></model>"
    )
    config = (
        '<config><object id="7" instances_count="1"><metadata type="object" key="name" value="block"/>'
        '<metadata type="object" key="brim_width" value="5"/><volume firstid="0" lastid="11">'
        '<metadata type="volume" key="name" value="block"/>'
        '<metadata type="volume" key="volume_type" value="ModelPart"/>'
        '<metadata type="volume" key="matrix" value="1 0 0 0 0 1 0 0 0 0 1 10 0 0 0 1"/>'
        '<metadata type="volume" key="perimeters" value="4"/><metadata type="volume" key="fill_density" value="30%"/>'
        '</volume><volume firstid="12" lastid="23"><metadata type="volume" key="name" value="no support"/>'
        f'<metadata type="volume" key="volume_type" value="{changed.get("kind", "SupportBlocker")}"/>'
        "</volume></object></config>"
    ).replace(*changed.get("replace", ("", "")))
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        archive.writestr("3D/3dmodel.model", model)
        archive.writestr("Metadata/Slic3r_PE.config", "; layer_height = 0.15\n")
        if not changed.get("plain"):
            archive.writestr(LISTED, config)
    return out.getvalue()


def test_a_project_is_kept(tmp_path):
    (tmp_path / "in.3mf").write_bytes(saved())
    part = ReadMesh(path=tmp_path / "in.3mf").run(PlainContext())
    assert np.allclose([part.lower, part.upper], [[100, 90, 0], [120, 110, 20]])
    data, _ = write(
        tmp_path, part, names=("block",), project=tmp_path / "in.3mf", settings=("block: fill_density = 0%",)
    )
    about, parts = parts_of(data)
    assert about["brim_width"] == "5"
    assert [(name, kind, first, last) for name, kind, _, first, last in parts] == [
        ("block", "ModelPart", 0, 11), ("no support", "SupportBlocker", 12, 23),
    ]  # fmt: skip
    assert {key: value for key, value in parts[0][2].items() if key not in OF_ORCA.values()} == {
        "perimeters": "4", "fill_density": "0%",
    }  # fmt: skip
    assert zipfile.ZipFile(io.BytesIO(data)).read("Metadata/Slic3r_PE.config") == b"; layer_height = 0.15\n"
    again = read_project(data, "again.3mf")
    assert np.allclose(again.mesh[0][again.mesh[1][12:]].min((0, 1)), [101, 92, 3])  # the blocker is where it was
    assert [body.name for body in again.object.bodies] == ["block", "no support"]


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"kind": "NegativeVolume"}, "negative volume"),
        ({"replace": ('lastid="23"', 'lastid="24"')}, "has the triangles 12 to 24 of 24"),
        ({"replace": ('lastid="11"', 'lastid="-1"')}, "lastid is a positive integer"),
        ({"replace": ("<config>", "<config><!-- ")}, "no well-formed XML"),
    ],
)
def test_broken_projects_are_refused(changed, words, tmp_path):
    (tmp_path / "in.3mf").write_bytes(saved(**changed))
    with pytest.raises(InputError, match=words):
        ReadMesh(path=tmp_path / "in.3mf").run(PlainContext())


@pytest.mark.parametrize("changed", [{"plain": True}, {"items": '<item objectid="7"/>'}])
def test_projects_of_other_than_one_object_are_not_taken_over(changed, tmp_path):
    (tmp_path / "in.3mf").write_bytes(saved(**changed))
    with pytest.raises(InputError, match="a project is taken over that has one object, once"):
        write(tmp_path, OUTER, project=tmp_path / "in.3mf")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"settings": ("perimeters = 2",)}, "in `settings` is none"),
        ({"settings": ("legs: perimeters = 2",), "names": ("skin",)}, "of a part that there is not"),
        ({"settings": ("legs: perimeters = 2",)}, "of a part that there is not"),
        ({"names": ("a", "a")}, "are to be different"),
        ({"names": ("a", "b")}, "has 2 entries for 1 parts"),
        ({"kinds": ("modifier",)}, "no part is solid"),
        ({"names": ("a\n",)}, "cannot be printed"),
    ],
)
def test_options_that_do_not_fit(options, words, tmp_path):
    with pytest.raises((ConfigError, DesignError), match=words):
        write(tmp_path, OUTER, **options)


def test_lib3mf_reads_a_project(tmp_path):
    lib3mf = pytest.importorskip("lib3mf")
    data, _ = write(tmp_path, SKIN, BAR)
    model = lib3mf.get_wrapper().CreateModel()
    reader = model.QueryReader("3mf")
    reader.SetStrictModeActive(True)
    reader.ReadFromBuffer(data)
    assert [reader.GetWarning(k) for k in range(reader.GetWarningCount())] == []
    objects = model.GetMeshObjects()
    assert objects.MoveNext()
    assert objects.GetCurrentMeshObject().GetTriangleCount() == 36


@pytest.mark.skipif(shutil.which("prusa-slicer") is None, reason="PrusaSlicer is not installed")
def test_prusaslicer_makes_no_line_below_the_nozzle_and_the_whole_volume(tmp_path):
    write(tmp_path, SKIN, BAR, nozzle=Length(0.4), settings=("object: fill_density = 100%", "body: perimeters = 2",
          "object: fill_pattern = rectilinear"))  # fmt: skip
    subprocess.run(
        ["prusa-slicer", "-g", "--nozzle-diameter", "0.4", "--skirts", "0", "--layer-height", "0.2", "--gcode-flavor",
         "marlin2", "--first-layer-height", "0.2", "-o", "out.gcode", "project.3mf"],
        cwd=tmp_path, check=True, capture_output=True,
    )  # fmt: skip
    text = (tmp_path / "out.gcode").read_text()
    assert min(float(width) for width in re.findall(r"^;WIDTH:(\S+)", text, re.M)) >= 0.4 - 1e-3
    made = float(re.search(r"filament used \[mm\] = (\S+)", text)[1]) * math.pi * 1.75**2 / 4
    # the skin is made whole, and the bar between it: as both in one mesh would be
    assert made == pytest.approx(20**3 - 18.28**2 * 18 + 4 * 18.28 * 18, rel=0.02)
