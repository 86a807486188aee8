"""GLB and 3MF files that lie: each ends in an InputError that says where, quickly and within little memory."""

import io
import json
import struct
import time
import tracemalloc
import zipfile
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from sppm_pipeline.errors import InputError
from sppm_pipeline.features.files.formats.detect import FORMATS, decode_mesh
from sppm_pipeline.features.files.formats.three_mf import _PACKAGE_RELATIONS, _TYPES
from sppm_pipeline.features.files.formats.three_mf_model import CORE, PRODUCTION
from sppm_pipeline.services.formats.mesh_arrays import MAX_PLACED, MAX_TRIANGLES

POINTS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], "<f4")
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], "<u2")
BINARY = POINTS.tobytes() + FACES.tobytes()


def scene(**changes: Any) -> dict[str, Any]:
    """A tetrahedron as a glTF document."""
    return {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 12, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 48},
            {"buffer": 0, "byteOffset": 48, "byteLength": 24},
        ],
        "buffers": [{"byteLength": len(BINARY)}],
        **changes,
    }


def glb(document: Any, binary: bytes = BINARY, version: int = 2, total: int | None = None) -> bytes:
    text = document if isinstance(document, bytes) else json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I", len(text)) + b"JSON" + text
    body += struct.pack("<I", len(binary)) + b"BIN\0" + binary if binary else b""
    return b"glTF" + struct.pack("<II", version, 12 + len(body) if total is None else total) + body


def with_accessor(which: int, **changes: Any) -> bytes:
    document = scene()
    document["accessors"][which].update(changes)
    document["accessors"][which] = {k: v for k, v in document["accessors"][which].items() if v is not None}
    return glb(document)


def with_view(**changes: Any) -> bytes:
    document = scene()
    document["bufferViews"][0].update(changes)
    return glb(document)


def with_node(**node: Any) -> bytes:
    return glb(scene(nodes=[{"mesh": 0, **node}]))


def with_primitive(**primitive: Any) -> bytes:
    return glb(scene(meshes=[{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, **primitive}]}]))


def package(model: str | bytes | None, *, level: int = 6, **parts: str | bytes) -> bytes:
    """A 3MF file of a model part."""
    out = io.BytesIO()
    named = {"[Content_Types].xml": _TYPES, "_rels/.rels": _PACKAGE_RELATIONS, **parts}
    if model is not None:
        named["3D/3dmodel.model"] = model
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED, compresslevel=level) as file:
        for name, content in named.items():
            file.writestr(name, content)
    return out.getvalue()


VERTICES = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in POINTS.astype(int).tolist())
TRIANGLES = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in FACES.tolist())
MESH = f"<mesh><vertices>{VERTICES}</vertices><triangles>{TRIANGLES}</triangles></mesh>"
OBJECT = f'<object id="1">{MESH}</object>'
ITEM = '<item objectid="1"/>'


def model(objects: str = OBJECT, items: str = ITEM, attributes: str = 'unit="millimeter"', before: str = "") -> str:
    return (
        f'<?xml version="1.0"?>{before}<model {attributes} xmlns="{CORE}" xmlns:p="{PRODUCTION}">'
        f"<resources>{objects}</resources><build>{items}</build></model>"
    )


def of_components(*components: str, identifier: int = 2) -> str:
    return f'<object id="{identifier}"><components>{"".join(components)}</components></object>'


def explosion(levels: int, base: str = OBJECT) -> str:
    """Each object is ten times the one before."""
    ten = "".join('<component objectid="{}"/>' for _ in range(10))
    return base + "".join(of_components(ten.replace("{}", str(k)), identifier=k + 1) for k in range(1, levels + 1))


def with_mesh(vertices: str = VERTICES, triangles: str = TRIANGLES) -> bytes:
    inside = f"<mesh><vertices>{vertices}</vertices><triangles>{triangles}</triangles></mesh>"
    return package(model(f'<object id="1">{inside}</object>'))


def cut(data: bytes, share: float) -> bytes:
    return data[: int(len(data) * share)]


def encrypted() -> bytes:
    data = bytearray(package(model()))
    for start in (b"PK\x03\x04", b"PK\x01\x02"):
        place = -1
        while (place := data.find(start, place + 1)) >= 0:
            data[place + (6 if start == b"PK\x03\x04" else 8)] |= 1
    return bytes(data)


def damaged() -> bytes:
    data = bytearray(package(model(), level=0))
    data[data.find(b"<vertex x=") + 3] ^= 1
    return bytes(data)


def packed_by(method: int) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", method) as file:
        file.writestr("3D/3dmodel.model", model())
    return out.getvalue()


def twice() -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as file:
        file.writestr("3D/3dmodel.model", model())
        file.writestr("3d/3DModel.model", model())
    return out.getvalue()


def claims_in_directory() -> bytes:
    """The list of parts is said to be as long as the file."""
    data = bytearray(package(model()) + bytes(20_000_000))
    place = data.rfind(b"PK\x05\x06")
    end = bytearray(data[place : place + 22])
    struct.pack_into("<LL", end, 12, 20_000_000, place)
    return bytes(data[:place] + bytes(20_000_000) + end)


def many_parts() -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as file:
        for k in range(3000):
            file.writestr(f"{k:01500d}", b"")
    return out.getvalue()


LAUGHS = (
    '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa">'
    + "".join(f'<!ENTITY {"abcdefghij"[k + 1]} "{("&" + "abcdefghij"[k] + ";") * 10}">' for k in range(9))
    + "]>"
)

BLANKS = np.random.default_rng(0).integers(9, 11, 50_000, np.uint8).tobytes()  # not much smaller when packed

HOSTILE: dict[str, tuple[Callable[[], bytes], str]] = {
    # GLB: the container
    "empty.glb": (lambda: b"", "empty"),
    "head.glb": (lambda: b"glTF", "too few"),
    "magic.glb": (lambda: b"gltf" + bytes(60), "begins with glTF"),
    "old.glb": (lambda: glb(scene(), version=1), "version 1"),
    "cut.glb": (lambda: cut(glb(scene()), 0.8), "header claims"),
    "claims.glb": (lambda: glb(scene(), total=2**32 - 1), "claims 4294967295 bytes"),
    "short_claim.glb": (lambda: glb(scene(), total=40), "chunk of"),
    "tiny_claim.glb": (lambda: glb(scene(), total=3), "chunk of|chunk is expected"),
    "chunk.glb": (lambda: b"glTF" + struct.pack("<IIII", 2, 24, 2**31, 0x4E4F534A) + bytes(4), "chunk of 2147483648"),
    "kind.glb": (lambda: b"glTF" + struct.pack("<IIII", 2, 24, 4, 7) + bytes(4), "JSON chunk is expected"),
    # GLB: JSON
    "noise.glb": (lambda: glb(b"\x00\xff{}"), "cannot be read"),
    "list.glb": (lambda: glb(b"[]"), "no object"),
    "deep.glb": (lambda: glb(b'{"a":' + b"[" * 500_000 + b"]" * 500_000 + b"}"), "nested too deep"),
    "very_deep.glb": (lambda: glb(b'{"a":' * 900_000 + b"1" + b"}" * 900_000), "nested too deep"),
    "wide.glb": (lambda: glb(b'{"a":[' + b"[]," * 1_500_000 + b"[]]}"), "values; read are up to"),
    "large.glb": (lambda: glb(b'{"a":"' + b"x" * 20_000_000 + b'"}'), "JSON has 2"),
    "digits.glb": (lambda: glb(b'{"asset":' + b"9" * 100_000 + b"}"), "cannot be read"),
    "nan.glb": (lambda: glb(b'{"asset": NaN}'), "NaN is no number"),
    "asset.glb": (lambda: glb(scene(asset=7)), "'asset' must be an object"),
    "asset_1.glb": (lambda: glb(scene(asset={"version": "1.0"})), "version '1.0'"),
    "nothing.glb": (lambda: glb({"asset": {"version": "2.0"}}), "no faces"),
    # GLB: numbers
    "count.glb": (lambda: with_accessor(0, count=10**9), "take 12000000000 bytes of a bufferView of 48"),
    "count_indices.glb": (lambda: with_accessor(1, count=10**18), "bufferView of 24"),
    "count_negative.glb": (lambda: with_accessor(0, count=-4), "'count' must be an integer >= 0, not -4"),
    "count_true.glb": (lambda: with_accessor(0, count=True), "'count' must be an integer"),
    "count_real.glb": (lambda: with_accessor(0, count=4.0), "'count' must be an integer"),
    "count_missing.glb": (lambda: with_accessor(0, count=None), "'count' is missing"),
    "count_13.glb": (lambda: with_accessor(1, count=11), "11 corners are not a multiple of 3"),
    "offset.glb": (lambda: with_accessor(0, byteOffset=2**63), "bytes of a bufferView"),
    "offset_negative.glb": (lambda: with_accessor(0, byteOffset=-12), "'byteOffset' must be"),
    "view.glb": (lambda: with_accessor(0, bufferView=7), "there is no bufferView 7"),
    "no_view.glb": (lambda: with_accessor(0, bufferView=None), "no bufferView"),
    "kind_5124.glb": (lambda: with_accessor(0, componentType=5124), "componentType 5124 is unknown"),
    "kind_indices.glb": (lambda: with_accessor(1, componentType=5122), "unsigned"),
    "shape.glb": (lambda: with_accessor(0, type="VEC2"), "must be VEC3"),
    "sparse.glb": (lambda: with_accessor(0, sparse={"count": 10**9}), "changes 1000000000 of 4"),
    "sparse_place.glb": (
        lambda: with_accessor(
            0,
            sparse={
                "count": 1,
                "indices": {"bufferView": 1, "componentType": 5121, "byteOffset": 2},
                "values": {"bufferView": 0},
            },
            count=2,
        ),
        "below 2",
    ),
    "view_length.glb": (lambda: with_view(byteLength=10**12), "ends at byte 1000000000000 of a buffer of 72"),
    "view_offset.glb": (lambda: with_view(byteOffset=10**30), "of a buffer of 72"),
    "view_stride.glb": (lambda: with_view(byteStride=4), "byteStride of 4"),
    "view_stride_large.glb": (lambda: with_view(byteStride=2**62), "byteStride"),
    "view_buffer.glb": (lambda: with_view(buffer=3), "there is no buffer 3"),
    "buffer_claims.glb": (lambda: glb(scene(buffers=[{"byteLength": 10**15}]), BINARY[:50]), "buffer of 50 bytes"),
    "external.glb": (lambda: glb(scene(buffers=[{"byteLength": 72, "uri": "/etc/passwd"}])), "outside of the file"),
    "no_binary.glb": (lambda: glb(scene(), b""), "buffer of 0 bytes"),
    "index.glb": (
        lambda: glb(scene(), POINTS.tobytes() + (FACES + 1).tobytes()),
        r"not exist, in \[1, 2, 4\]; there are 4",
    ),
    "position_nan.glb": (lambda: glb(scene(), (POINTS * np.nan).tobytes() + FACES.tobytes()), "vertex 0.*finite"),
    "position_signalling_nan.glb": (lambda: glb(scene(), b"\x01\x00\xa0\x7f" * 12 + FACES.tobytes()), "finite"),
    "position_inf.glb": (lambda: glb(scene(), (POINTS + np.inf).tobytes() + FACES.tobytes()), "finite"),
    # GLB: the scene
    "no_accessor.glb": (lambda: with_primitive(indices=9), "no accessor 9"),
    "no_position.glb": (lambda: with_primitive(attributes={}), "'POSITION' is missing"),
    "mode.glb": (lambda: with_primitive(mode=9), "mode 9 is unknown"),
    "points.glb": (lambda: with_primitive(mode=0), "no faces"),
    "draco.glb": (lambda: with_primitive(extensions={"KHR_draco_mesh_compression": {}}), "Draco"),
    "draco_required.glb": (lambda: glb(scene(extensionsRequired=["KHR_draco_mesh_compression"])), "compressed"),
    "meshopt.glb": (lambda: with_view(extensions={"EXT_meshopt_compression": {}}), "compressed"),
    "unknown_required.glb": (lambda: glb(scene(extensionsRequired=["ACME_voxels"])), "ACME_voxels"),
    "no_mesh.glb": (lambda: with_node(mesh=5), "there is no mesh 5"),
    "no_node.glb": (lambda: glb(scene(scenes=[{"nodes": [4]}])), "there is no node 4"),
    "no_scene.glb": (lambda: glb(scene(scene=3)), "there is no scene 3"),
    "itself.glb": (lambda: with_node(children=[0]), "inside itself"),
    "cycle.glb": (lambda: glb(scene(nodes=[{"children": [1]}, {"children": [0]}])), "inside itself"),
    "two_parents.glb": (
        lambda: glb(scene(nodes=[{"children": [k + 1, k + 1]} for k in range(60)] + [{"mesh": 0}])),
        "two parents",
    ),
    "matrix.glb": (lambda: with_node(matrix=[1] * 15), "16 finite numbers"),
    "matrix_inf.glb": (
        lambda: glb(json.dumps(scene()).replace('{"mesh": 0}', '{"mesh":0,"scale":[1e999,1,1]}').encode()),
        "finite",
    ),
    "matrix_row.glb": (lambda: with_node(matrix=[1] * 16), "last row"),
    "quaternion.glb": (lambda: with_node(rotation=[0, 0, 0, 0]), "unit quaternion"),
    "huge_scale.glb": (lambda: with_node(scale=[1e308, 1, 1], translation=[1e308, 0, 0]), "beyond all numbers"),
    "skin.glb": (lambda: with_node(skin=0), "skeleton"),
    "weights.glb": (lambda: with_node(weights=[0.5]), "morph"),
    "instancing.glb": (lambda: with_node(extensions={"EXT_mesh_gpu_instancing": {}}), "copies"),
    # 3MF: the archive
    "empty.3mf": (lambda: b"", "empty"),
    "noise.3mf": (lambda: b"\x00\xff" * 5000, "no readable ZIP"),
    "cut.3mf": (lambda: cut(package(model()), 0.7), "no readable ZIP"),
    "directory_cut.3mf": (lambda: cut(package(model()), 0.97), "no readable ZIP"),
    "damaged.3mf": (damaged, "no readable ZIP|well-formed"),
    "document.3mf": (lambda: package(None, **{"word/document.xml": "<x/>"}), "missing"),
    "other_zip.3mf": (lambda: package(None, **{"_rels/.rels": "<Relationships/>"}), "names no 3D model"),
    "target.3mf": (
        lambda: package(model(), **{"_rels/.rels": _PACKAGE_RELATIONS.replace(b"/3D/3d", b"/../../etc/")}),
        "missing",
    ),
    "encrypted.3mf": (encrypted, "encrypted"),
    "bzip2.3mf": (lambda: packed_by(zipfile.ZIP_BZIP2), "packed by method 12"),
    "lzma.3mf": (lambda: packed_by(zipfile.ZIP_LZMA), "packed by method 14"),
    "twice.3mf": (twice, "several parts"),
    "directory_claims.3mf": (claims_in_directory, "list of parts is too long|no readable ZIP"),
    "many_parts.3mf": (many_parts, "list of parts is too long"),
    "bomb.3mf": (lambda: package(b" " * 60_000_000), "would unpack from .* to 60000000 bytes"),
    "bomb_of_relations.3mf": (lambda: package(model(), **{"_rels/.rels": b" " * 5_000_000}), "would unpack"),
    # 3MF: XML
    "no_xml.3mf": (lambda: package(b"\x00\xff" * 100), "well-formed"),
    "unclosed.3mf": (lambda: package(model()[:-20]), "well-formed.*no element|line 1.*well-formed"),
    "root.3mf": (lambda: package("<svg/>"), "root of a 3MF model"),
    "nothing.3mf": (lambda: package(b""), "well-formed"),
    "laughs.3mf": (lambda: package(model(before=LAUGHS).replace("<resources>", "<resources>&j;")), "DTD"),
    "external.3mf": (lambda: package(model(before='<!DOCTYPE x SYSTEM "file:///etc/passwd">')), "DTD"),
    "entity.3mf": (lambda: package(model().replace("<resources>", "<resources>&a;")), "undefined entity"),
    "encoding.3mf": (lambda: package('<?xml version="1.0" encoding="rot13"?>' + model()[21:]), "UTF-8|well-formed"),
    "depth.3mf": (lambda: package(model().partition("<resources>")[0] + "<a>" * 100_000), "nested more than 64"),
    "blanks.3mf": (lambda: package(model().encode() + BLANKS * 400, level=1), "bytes of XML hold only"),
    "long_name.3mf": (lambda: package("<" + "a" * 500_000 + "/>"), "root of a 3MF model"),
    # 3MF: the model
    "unit.3mf": (lambda: package(model(attributes='unit="parsec"')), "unit 'parsec' is unknown"),
    "required.3mf": (
        lambda: package(
            model(
                attributes='requiredextensions="b" xmlns:b="http://schemas.microsoft.com/3dmanufacturing/beamlattice/2017/02"'
            )
        ),
        "beam lattices",
    ),
    "required_unknown.3mf": (lambda: package(model(attributes='requiredextensions="q" xmlns:q="urn:q"')), "urn:q"),
    "no_build.3mf": (lambda: package(model(items="")), "nothing is to be built"),
    "no_object.3mf": (lambda: package(model(items='<item objectid="9"/>')), "no object 9"),
    "same_id.3mf": (lambda: package(model(OBJECT + OBJECT)), "two objects with the id 1"),
    "id.3mf": (lambda: package(model(items='<item objectid="-1"/>')), "positive integer, not '-1'"),
    "id_long.3mf": (lambda: package(model(items=f'<item objectid="{"9" * 10_000}"/>')), "positive integer"),
    "support.3mf": (lambda: package(model(OBJECT.replace('id="1"', 'id="1" type="support"'))), "no faces"),
    "empty_mesh.3mf": (lambda: with_mesh("", ""), "no faces"),
    "no_vertices.3mf": (lambda: with_mesh(""), "triangle 0.*there are 0 vertices"),
    "index.3mf": (
        lambda: with_mesh(triangles='<triangle v1="0" v2="1" v3="4"/>'),
        r"triangle 0.*\[0, 1, 4\].*4 vertices",
    ),
    "index_negative.3mf": (lambda: with_mesh(triangles='<triangle v1="0" v2="1" v3="-1"/>'), "three vertex numbers"),
    "index_huge.3mf": (lambda: with_mesh(triangles=f'<triangle v1="0" v2="1" v3="{10**30}"/>'), "three vertex numbers"),
    "index_digits.3mf": (
        lambda: with_mesh(triangles=f'<triangle v1="0" v2="1" v3="{"1" * 9999}"/>'),
        "three vertex numbers",
    ),
    "index_real.3mf": (lambda: with_mesh(triangles='<triangle v1="0" v2="1" v3="2.0"/>'), "three vertex numbers"),
    "index_missing.3mf": (lambda: with_mesh(triangles='<triangle v1="0" v2="1"/>'), "three vertex numbers"),
    "nan.3mf": (lambda: with_mesh(VERTICES.replace('"1"', '"nan"')), "finite|three numbers"),
    "inf.3mf": (lambda: with_mesh(VERTICES.replace('"1"', '"1e999"')), "vertex 1.*finite"),
    "word.3mf": (lambda: with_mesh(VERTICES.replace('"1"', '"one"')), "three numbers"),
    "no_z.3mf": (lambda: with_mesh(VERTICES.replace("z=", "w=")), "three numbers"),
    "transform.3mf": (lambda: package(model(items='<item objectid="1" transform="1 0 0"/>')), "twelve"),
    "transform_nan.3mf": (lambda: package(model(items=f'<item objectid="1" transform="{"nan " * 12}"/>')), "twelve"),
    "transform_huge.3mf": (
        lambda: package(model(items=f'<item objectid="1" transform="{"1e308 " * 12}"/>')),
        "beyond all numbers",
    ),
    "itself.3mf": (
        lambda: package(model(of_components('<component objectid="2"/>'), '<item objectid="2"/>')),
        "component of itself",
    ),
    "cycle.3mf": (
        lambda: package(
            model(
                of_components('<component objectid="3"/>') + of_components('<component objectid="2"/>', identifier=3),
                '<item objectid="2"/>',
            )
        ),
        "component of itself",
    ),
    "explosion.3mf": (lambda: package(model(explosion(30), '<item objectid="31"/>')), "add up to more than 10"),
    "explosion_of_nothing.3mf": (
        lambda: package(model(explosion(9, '<object id="1"/>'), '<item objectid="10"/>')),
        "copies of objects",
    ),
    "chain.3mf": (
        lambda: package(
            model(
                OBJECT
                + "".join(of_components(f'<component objectid="{k}"/>', identifier=k + 1) for k in range(1, 2000)),
                '<item objectid="2000"/>',
            )
        ),
        "nested more than 256",
    ),
    "other_part.3mf": (lambda: package(model(items='<item objectid="1" p:path="/3D/none.model"/>')), "missing"),
    "other_unit.3mf": (
        lambda: package(
            model(items=ITEM + '<item objectid="1" p:path="/3D/b.model"/>'),
            **{"3D/b.model": model(attributes='unit="inch"')},
        ),
        "its unit is inch",
    ),
}


HANGS = 20.0
"""Seconds of processor time, many times what is needed: a guard against hanging, not a measurement."""


@pytest.fixture(scope="module", autouse=True)
def _compiled() -> None:
    """Time and memory are those of reading, not of compiling."""
    assert len(decode_mesh(glb(scene()), "a.glb")[1]) == 4
    assert len(decode_mesh(package(model()), "a.3mf")[1]) == 4


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile(name: str) -> None:
    make, message = HOSTILE[name]
    data = make()
    tracemalloc.start()
    start = time.process_time()
    try:
        with pytest.raises(InputError, match=message) as caught:
            FORMATS[name.rsplit(".", 1)[1]].decode(data, name)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert time.process_time() - start < HANGS
    assert peak < 10 * len(data) + 60_000_000
    assert str(caught.value).startswith(name)
    assert len(str(caught.value)) < 500
    with pytest.raises(InputError):
        decode_mesh(data, name)


def test_the_largest_explosion_that_is_read_is_bounded() -> None:
    levels = 4
    vertices, faces = decode_mesh(package(model(explosion(levels), f'<item objectid="{levels + 1}"/>')), "a.3mf")
    assert len(faces) == 4 * 10**levels <= MAX_TRIANGLES
    assert len(vertices) == 4 * 10**levels
    assert 10**levels < MAX_PLACED
