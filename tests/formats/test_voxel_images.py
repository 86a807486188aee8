"""Voxel images in and out, and files that lie."""

import base64
import bz2
import gzip
import io
import struct
import zlib

import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from sppm_pipeline.errors import InputError
from sppm_pipeline.formats import image_stack, npy, nrrd, vti

IMAGE = np.random.default_rng(0).integers(0, 3, (3, 4, 5)).astype(np.uint8)
GRAY = np.random.default_rng(1).random((4, 3, 2)).astype(np.float32)


def nrrd_of(values, encoding="raw", **changed):
    raw = values.tobytes(order="F")
    body = {
        "raw": raw,
        "gzip": gzip.compress(raw, mtime=0),
        "bzip2": bz2.compress(raw),
        "ascii": " ".join(str(v) for v in values.reshape(-1, order="F")).encode(),
    }[encoding]
    fields = {
        "type": values.dtype.name,
        "dimension": 3,
        "sizes": " ".join(map(str, values.shape)),
        "endian": "little",
        "encoding": encoding,
        **changed,
    }
    lines = "".join(f"{k.replace('_', ' ')}: {v}\n" for k, v in fields.items() if v is not None)
    return f"NRRD0004\n# made for a test\n{lines}\n".encode() + body


def vti_of(values, how, compressed=False, header="UInt32", points=False):
    raw = values.tobytes(order="F")
    word = {"UInt32": "<I", "UInt64": "<Q"}[header]
    if compressed:
        block = 16
        blocks = [raw[i : i + block] for i in range(0, len(raw), block)]
        packed = [zlib.compress(b) for b in blocks]
        head = b"".join(struct.pack(word, n) for n in [len(blocks), block, len(raw) % block, *(len(p) for p in packed)])
        body = b"".join(packed)
    else:
        head, body = struct.pack(word, len(raw)), raw
    text, appended = "", b""
    if how == "ascii":
        text = " ".join(str(v) for v in values.reshape(-1, order="F"))
    elif how == "binary" and compressed:
        text = (base64.b64encode(head) + base64.b64encode(body)).decode()
    elif how == "binary":
        text = base64.b64encode(head + body).decode()
    elif how == "appended":
        appended = b'<AppendedData encoding="raw">_' + head + body + b"</AppendedData>"
    name = {"uint8": "UInt8", "float32": "Float32"}[values.dtype.name]
    extent = " ".join(f"0 {n - points}" for n in values.shape)
    place = "PointData" if points else "CellData"
    zipped = 'compressor="vtkZLibDataCompressor"' if compressed else ""
    return (
        (
            f'<VTKFile type="ImageData" byte_order="LittleEndian" header_type="{header}" {zipped}>'
            f'<ImageData WholeExtent="{extent}" Origin="0 0 0" Spacing="0.5 0.25 2"><Piece Extent="{extent}">'
            f'<{place}><DataArray type="{name}" Name="phase" format="{how}" offset="0">{text}</DataArray></{place}>'
            f"</Piece></ImageData>"
        ).encode()
        + appended
        + b"</VTKFile>"
    )


@pytest.mark.parametrize("values", [IMAGE, GRAY, IMAGE > 1], ids=["phases", "gray", "bool"])
def test_npy_round_trip_and_numpy_reads_it(values):
    data = b"".join(npy.encode(np.asfortranarray(values)))
    assert (np.load(io.BytesIO(data)) == values).all()
    assert (npy.decode(data, "a.npy").values == values).all()


def test_npy_of_others_in_either_order():
    for order in "CF":
        stream = io.BytesIO()
        np.save(stream, np.asarray(IMAGE, np.int32, order=order))
        assert (npy.decode(stream.getvalue(), "a.npy").values == IMAGE).all()


@pytest.mark.parametrize("encoding", ["raw", "gzip", "bzip2", "ascii"])
def test_nrrd(encoding):
    found = nrrd.decode(nrrd_of(IMAGE, encoding, spacings="0.5 1 2"), "a.nrrd")
    assert (found.values == IMAGE).all()
    assert found.spacing == (0.5, 1.0, 2.0)


def test_nrrd_of_a_scanner():
    directions = {"space": "left-posterior-superior", "space_directions": "(0.3,0.4,0) (0,2,0) (0,0,1)"}
    found = nrrd.decode(nrrd_of(GRAY.astype(">f4"), type="float", endian="big", **directions), "a.nrrd")
    assert (found.values == GRAY).all()
    assert found.spacing == pytest.approx((0.5, 2, 1))


@pytest.mark.parametrize("how", ["ascii", "binary", "appended"])
@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("header", ["UInt32", "UInt64"])
@pytest.mark.parametrize("points", [False, True])
def test_vti(how, compressed, header, points):
    found = vti.decode(vti_of(IMAGE, how, compressed, header, points), "a.vti")
    assert (found.values == IMAGE).all()
    assert found.spacing == (0.5, 0.25, 2.0)


@pytest.mark.parametrize("values", [IMAGE, GRAY])
def test_vti_round_trip(values):
    data = b"".join(vti.encode(np.asfortranarray(values), (1, 2, 3), (0, 0, 0), "phase"))
    found = vti.decode(data, "a.vti")
    assert (found.values == values).all()
    assert found.spacing == (1, 2, 3)
    assert vti.decode(data, "a.vti", "phase").values.shape == values.shape


@pytest.mark.parametrize("values", [IMAGE, GRAY, IMAGE > 1])
def test_tiff_round_trip_and_another_reader(values):
    data = image_stack.encode_tiff(values)
    assert data == image_stack.encode_tiff(values)
    scale = 255 if values.dtype == bool else 1
    assert (image_stack.decode_pages(data, "a.tif").values == values * scale).all()
    pages = tifffile.imread(io.BytesIO(data))
    assert pages.shape == values.shape[::-1]
    assert (pages[:, ::-1].transpose(2, 1, 0) == values * scale).all()


def test_a_folder_in_the_order_of_its_numbers(tmp_path):
    for k in range(11):
        Image.fromarray(np.full((3, 2), k, np.uint8)).save(tmp_path / f"layer{k}.png")
    found = image_stack.read_folder(tmp_path).values
    assert found.shape == (2, 3, 11)
    assert found[0, 0].tolist() == list(range(11))


def test_rows_run_down_in_y(tmp_path):
    page = np.zeros((3, 2), np.uint8)
    page[0, 1] = 9
    Image.fromarray(page).save(tmp_path / "0.png")
    assert image_stack.read_folder(tmp_path).values[1, 2, 0] == 9


def saved(array):
    stream = io.BytesIO()
    np.save(stream, array, allow_pickle=True)
    return stream.getvalue()


GOOD = b"".join(npy.encode(np.asfortranarray(IMAGE)))
HOSTILE = {
    "npy empty": (npy.decode, b""),
    "npy objects": (npy.decode, saved(np.array([[[{}]]], object))),
    "npy text": (npy.decode, saved(np.array([[["a"]]]))),
    "npy complex": (npy.decode, saved(np.ones((2, 2, 2), complex))),
    "npy two axes": (npy.decode, saved(np.ones((2, 2)))),
    "npy no voxels": (npy.decode, saved(np.ones((0, 2, 2)))),
    "npy cut": (npy.decode, GOOD[:-1]),
    "npy too long": (npy.decode, GOOD + b"x"),
    "npy huge claim": (npy.decode, GOOD.replace(b"(3, 4, 5)", b"(9999999999, 4, 5)", 1)),
    "npy code in the header": (npy.decode, GOOD.replace(b"(3, 4, 5)", b"exit(1234)", 1)),
    "npy negative": (npy.decode, GOOD.replace(b"(3, 4, 5)", b"(-3,-4,5)", 1)),
    "nrrd empty": (nrrd.decode, b""),
    "nrrd no end": (nrrd.decode, b"NRRD0004\ntype: float\n"),
    "nrrd cut": (nrrd.decode, nrrd_of(IMAGE)[:-1]),
    "nrrd bomb": (nrrd.decode, nrrd_of(np.zeros((2, 2, 2), np.uint8), "gzip")[:-25] + gzip.compress(b"\0" * 10**8)),
    "nrrd huge": (nrrd.decode, nrrd_of(IMAGE, sizes="99999999 99999999 9")),
    "nrrd detached": (nrrd.decode, nrrd_of(IMAGE, data_file="/etc/passwd")),
    "nrrd dimension": (nrrd.decode, nrrd_of(IMAGE, dimension=2)),
    "nrrd type": (nrrd.decode, nrrd_of(IMAGE, type="block")),
    "nrrd no type": (nrrd.decode, nrrd_of(IMAGE, type=None)),
    "nrrd encoding": (nrrd.decode, nrrd_of(IMAGE).replace(b"encoding: raw", b"encoding: hex")),
    "nrrd sizes": (nrrd.decode, nrrd_of(IMAGE, sizes="three four five")),
    "nrrd spacing": (nrrd.decode, nrrd_of(IMAGE, spacings="1 0 1")),
    "nrrd infinite": (nrrd.decode, nrrd_of(IMAGE, spacings="1 inf 1")),
    "nrrd skip": (nrrd.decode, nrrd_of(IMAGE, byte_skip="7")),
    "nrrd endian": (nrrd.decode, nrrd_of(IMAGE, endian="middle")),
    "nrrd line": (nrrd.decode, b"NRRD0004\nwhat is this\n\n"),
    "nrrd damaged": (nrrd.decode, nrrd_of(IMAGE, "gzip")[:-20]),
    "nrrd ascii lie": (nrrd.decode, nrrd_of(IMAGE, "ascii", sizes="300 300 300")),
    "vti empty": (vti.decode, b""),
    "vti other": (vti.decode, b'<VTKFile type="PolyData"/>'),
    "vti entities": (vti.decode, b'<!DOCTYPE a [<!ENTITY b "c">]>' + vti_of(IMAGE, "ascii")),
    "vti deep": (vti.decode, b"<a>" * 500 + b"</a>" * 500),
    "vti cut": (vti.decode, vti_of(IMAGE, "appended")[:-40]),
    "vti short": (vti.decode, vti_of(IMAGE, "ascii").replace(b" 1 ", b" ", 1)),
    "vti offset": (vti.decode, vti_of(IMAGE, "appended").replace(b'offset="0"', b'offset="99999"')),
    "vti negative offset": (vti.decode, vti_of(IMAGE, "appended").replace(b'offset="0"', b'offset="-9"')),
    "vti huge": (vti.decode, vti_of(IMAGE, "ascii").replace(b"0 3 0 4", b"0 999999 0 999999")),
    "vti reversed": (vti.decode, vti_of(IMAGE, "ascii").replace(b"0 3 0 4", b"3 0 0 4")),
    "vti text": (vti.decode, vti_of(IMAGE, "ascii").replace(b'UInt8"', b'String"')),
    "vti components": (vti.decode, vti_of(IMAGE, "ascii").replace(b"Name=", b'NumberOfComponents="3" Name=')),
    "vti compressor": (vti.decode, vti_of(IMAGE, "binary", True).replace(b"ZLib", b"LZMA")),
    "vti damaged": (vti.decode, vti_of(IMAGE, "binary").replace(b"A", b"*")),
    "vti wrong length": (vti.decode, vti_of(IMAGE, "appended").replace(b"_\x3c\0", b"_\x3d\0")),
    "vti not xml": (vti.decode, b"solid"),
    "vti spacing": (vti.decode, vti_of(IMAGE, "ascii").replace(b"0.5 0.25 2", b"0.5 nan 2")),
    "tiff empty": (image_stack.decode_pages, b""),
    "tiff cut": (image_stack.decode_pages, image_stack.encode_tiff(IMAGE)[:40]),
    "tiff text": (image_stack.decode_pages, b"hello"),
}  # fmt: skip


@pytest.mark.parametrize("case", HOSTILE)
def test_what_lies_is_refused_with_a_reason(case):
    decode, data = HOSTILE[case]
    with pytest.raises(InputError) as caught:
        decode(data, "scan.x")
    assert "scan.x" in caught.value.message


def test_a_color_picture_is_refused(tmp_path):
    Image.fromarray(np.zeros((2, 2, 3), np.uint8)).save(tmp_path / "0.png")
    with pytest.raises(InputError, match="RGB"):
        image_stack.read_folder(tmp_path)


def test_pictures_of_different_sizes_and_kinds_are_refused(tmp_path):
    with pytest.raises(InputError, match="no pictures"):
        image_stack.read_folder(tmp_path)
    Image.fromarray(np.zeros((2, 2), np.uint8)).save(tmp_path / "0.png")
    Image.fromarray(np.zeros((2, 3), np.uint8)).save(tmp_path / "1.png")
    with pytest.raises(InputError, match="layer 1"):
        image_stack.read_folder(tmp_path)
    Image.fromarray(np.zeros((2, 3), np.uint8)).save(tmp_path / "1.tif")
    with pytest.raises(InputError, match=r"\.png and \.tif"):
        image_stack.read_folder(tmp_path)


SEEDS = [
    (npy.decode, GOOD),
    (nrrd.decode, nrrd_of(IMAGE, "gzip", spacings="1 2 3")),
    (vti.decode, vti_of(IMAGE, "binary", True)),
    (vti.decode, vti_of(IMAGE, "appended")),
    (image_stack.decode_pages, image_stack.encode_tiff(IMAGE)),
]


@given(which=st.integers(0, len(SEEDS) - 1), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=400, derandomize=True, deadline=None)
@pytest.mark.filterwarnings("ignore")  # Pillow warns about damaged TIFF tags before it gives up
def test_damage_is_read_or_refused_and_nothing_else(which, seed):
    decode, data = SEEDS[which]
    rng = np.random.default_rng(seed)
    broken = bytearray(data)
    for _ in range(rng.integers(1, 6)):
        at = int(rng.integers(len(broken)))
        kind = rng.integers(3)
        if kind == 0:
            broken[at] = int(rng.integers(256))
        elif kind == 1:
            del broken[at : at + int(rng.integers(1, 20))]
        else:
            broken[at:at] = rng.bytes(int(rng.integers(1, 9)))
    try:
        image = decode(bytes(broken), "scan")
    except InputError:
        return
    assert image.values.ndim == 3
