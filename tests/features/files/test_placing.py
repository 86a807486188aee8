"""Copies stand where matrix products say, with their outside outside."""

import io
import json
import struct
import zipfile

import numpy as np
import pytest

from sppm_pipeline.errors import InputError
from sppm_pipeline.features.files.formats.detect import decode_mesh, decode_mesh_file
from sppm_pipeline.features.files.formats.three_mf_model import CORE, PRODUCTION
from sppm_pipeline.services.formats.mesh_arrays import IDENTITY, after, place, require_few
from sppm_pipeline.services.mesh.measures import volume

POINTS = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]], float)
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def homogeneous(matrix: np.ndarray) -> np.ndarray:
    return np.vstack([matrix, [0, 0, 0, 1]])


def random_matrices(count: int) -> list[np.ndarray]:
    return list(np.random.default_rng(3).normal(size=(count, 3, 4)))


def test_one_transformation_after_another() -> None:
    a, b = random_matrices(2)
    assert np.allclose(homogeneous(after(a, b)), homogeneous(a) @ homogeneous(b))
    assert np.array_equal(after(IDENTITY, b), b)


def test_copies_keep_order_place_and_outside() -> None:
    other = (POINTS * 2, FACES[:, ::-1])
    placed = [(k % 3 // 2, matrix) for k, matrix in enumerate(random_matrices(40))]
    vertices, faces = place("a", [(POINTS, FACES), other], placed)
    for k, (which, matrix) in enumerate(placed):
        points = [(POINTS, FACES), other][which][0]
        assert np.allclose(vertices[4 * k : 4 * k + 4], points @ matrix[:, :3].T + matrix[:, 3])
        own = faces[4 * k : 4 * k + 4]
        assert own.min() == 4 * k
        assert own.max() == 4 * k + 3
        assert np.sign(volume(vertices, own)) == (1 if which == 0 else -1)


def test_what_is_too_much() -> None:
    require_few("a", 1, 2**25, 2**25)
    for counts in ((2**17 + 1, 0, 0), (1, 2**25 + 1, 0), (1, 0, 10**30)):
        with pytest.raises(InputError, match="add up to"):
            require_few("a", *counts)


def matrix_text(matrix: np.ndarray) -> str:
    return " ".join(repr(float(v)) for v in matrix.T.reshape(-1))


def test_components_of_components_in_other_parts() -> None:
    a, b, c, d = random_matrices(4)
    rows = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in POINTS.tolist())
    corners = "".join(f'<triangle v1="{i}" v2="{j}" v3="{k}"/>' for i, j, k in FACES.tolist())
    mesh = f'<object id="7"><mesh><vertices>{rows}</vertices><triangles>{corners}</triangles></mesh></object>'
    head = f'<model unit="centimeter" xmlns="{CORE}" xmlns:p="{PRODUCTION}">'
    part = f"{head}<resources>{mesh}</resources><build/></model>"
    root = (
        f'{head}<resources><object id="1"><components>'
        f'<component objectid="7" p:path="/3D/part.model" transform="{matrix_text(a)}"/>'
        f'<component objectid="7" p:path="/3D/part.model" transform="{matrix_text(b)}"/></components></object>'
        f'<object id="2"><components><component objectid="1" transform="{matrix_text(c)}"/></components></object>'
        f'</resources><build><item objectid="2" transform="{matrix_text(d)}"/>'
        '<item objectid="7" p:path="/3D/part.model"/></build></model>'
    )
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as file:
        file.writestr("3D/3dmodel.model", root)
        file.writestr("3D/part.model", part)
    vertices, faces = decode_mesh(out.getvalue(), "a.3mf")
    expected = []
    for chain in ([d, c, a], [d, c, b], []):
        total = np.eye(4)
        for matrix in chain:
            total = total @ homogeneous(matrix)
        expected.append(POINTS @ total[:3, :3].T + total[:3, 3])
    assert np.allclose(vertices, 10 * np.concatenate(expected))
    assert all(volume(vertices, faces[4 * k : 4 * k + 4]) > 0 for k in range(3))


def test_nodes_of_a_scene() -> None:
    """A matrix, and shift, turn and scaling, inside each other; what is not in the scene is left out."""
    half = np.sqrt(0.5)
    document = {
        "asset": {"version": "2.0"},
        "scene": 1,
        "scenes": [{"nodes": [3]}, {"nodes": [0]}],
        "nodes": [
            {"translation": [10, 20, 30], "rotation": [0, 0, half, half], "scale": [2, 2, -2], "children": [1, 2]},
            {"mesh": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 5, 6, 7, 1]},
            {"mesh": 0},
            {"mesh": 0},
        ],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {
                "bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3",
                "sparse": {
                    "count": 1,
                    "indices": {"bufferView": 2, "componentType": 5121},
                    "values": {"bufferView": 3},
                },
            },
            {"bufferView": 1, "componentType": 5121, "count": 12, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": 64, "byteStride": 16},
            {"buffer": 0, "byteOffset": 64, "byteLength": 12},
            {"buffer": 0, "byteOffset": 76, "byteLength": 4},
            {"buffer": 0, "byteOffset": 80, "byteLength": 12},
        ],
        "buffers": [{"byteLength": 92}],
    }  # fmt: skip
    wrong = POINTS.copy()
    wrong[3] = -1  # the sparse part puts it right
    padded = np.hstack([wrong, np.full((4, 1), np.nan)]).astype("<f4")
    binary = padded.tobytes() + FACES.astype("u1").tobytes() + b"\x03\0\0\0" + POINTS[3].astype("<f4").tobytes()
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I", len(text)) + b"JSON" + text + struct.pack("<I", len(binary)) + b"BIN\0" + binary
    file = decode_mesh_file(b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body, "a.glb")
    turned = np.stack([10 - 2 * POINTS[:, 1], 20 + 2 * POINTS[:, 0], 30 - 2 * POINTS[:, 2]], 1)
    moved = POINTS + np.array([5, 6, 7])
    shifted = np.stack([10 - 2 * moved[:, 1], 20 + 2 * moved[:, 0], 30 - 2 * moved[:, 2]], 1)
    assert np.allclose(file.vertices, np.concatenate([shifted, turned]), atol=1e-6)
    assert all(volume(file.vertices, file.faces[4 * k : 4 * k + 4]) > 0 for k in range(2))


@pytest.mark.parametrize("mode", [4, 5, 6])
@pytest.mark.parametrize("indexed", [True, False])
@pytest.mark.parametrize("kind", ["u1", "<u2", "<u4"])
def test_triangles_strips_and_fans(mode: int, indexed: bool, kind: str) -> None:
    square = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], "<f4")
    order = {4: [0, 1, 2, 2, 1, 3], 5: [0, 1, 2, 3], 6: [0, 1, 3, 2]}[mode]
    points = square if indexed else square[order]
    numbers = np.array(order, kind)
    codes = {"u1": 5121, "<u2": 5123, "<u4": 5125}
    primitive = {"attributes": {"POSITION": 0}, "mode": mode, **({"indices": 1} if indexed else {})}
    document = {
        "asset": {"version": "2.0"},
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": len(points), "type": "VEC3"},
            {"bufferView": 1, "componentType": codes[kind], "count": len(order), "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": points.nbytes},
            {"buffer": 0, "byteOffset": points.nbytes, "byteLength": numbers.nbytes},
        ],
        "buffers": [{"byteLength": points.nbytes + numbers.nbytes}],
    }
    binary = points.tobytes() + numbers.tobytes()
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I", len(text)) + b"JSON" + text + struct.pack("<I", len(binary)) + b"BIN\0" + binary
    vertices, faces = decode_mesh(b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body, "a.glb")
    assert len(vertices) == 4  # equal corners are merged
    assert len(faces) == 2
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    assert np.allclose(np.cross(b - a, c - a), [0, 0, 1e6])
