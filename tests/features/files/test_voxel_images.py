"""Voxel images in and out, and files that lie."""

import base64
import bz2
import contextlib
import gzip
import io
import json
import sys
import tracemalloc
import zlib
from xml.etree import ElementTree

import nrrd as pynrrd
import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from sppm_pipeline import Voxels
from sppm_pipeline.errors import InputError, ResourceError
from sppm_pipeline.features.files.stages.write_voxels import WriteVoxels
from sppm_pipeline.services.formats import image_stack, nrrd, vti, zarr_store
from sppm_pipeline.services.formats.voxel_files import decode_npy, encode_npy
from sppm_pipeline.testing.plain_context import PlainContext

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


@pytest.mark.parametrize("values", [IMAGE, GRAY, IMAGE > 1], ids=["phases", "gray", "bool"])
def test_npy_round_trip_and_numpy_reads_it(values):
    data = b"".join(encode_npy(np.asfortranarray(values)))
    assert (np.load(io.BytesIO(data)) == values).all()
    assert (decode_npy(data, "a.npy").values == values).all()


def test_npy_of_others_in_either_order():
    for order in "CF":
        stream = io.BytesIO()
        np.save(stream, np.asarray(IMAGE, np.int32, order=order))
        assert (decode_npy(stream.getvalue(), "a.npy").values == IMAGE).all()


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


@pytest.mark.parametrize("values", [IMAGE, GRAY, IMAGE > 1], ids=["phases", "gray", "bool"])
def test_vti_is_xml_with_the_values_behind_it(values):
    data = b"".join(vti.encode(np.asfortranarray(values), (1, 2, 3), (0, 0, 0), "phase"))
    head, _, rest = data.partition(b"\n_")
    raw = rest[: -len(b"\n  </AppendedData>\n</VTKFile>\n")]
    (image,) = ElementTree.fromstring(head + b"</AppendedData></VTKFile>").findall("ImageData")
    assert image.get("Spacing") == "1.0 2.0 3.0"
    assert image.get("WholeExtent") == " ".join(f"0 {n}" for n in values.shape)
    (array,) = image.iter("DataArray")
    kind = {"UInt8": np.uint8, "Float32": np.float32}[array.get("type")]
    assert int.from_bytes(raw[:8], "little") == len(raw) - 8
    assert (np.frombuffer(raw[8:], kind).reshape(values.shape, order="F") == values).all()


@pytest.mark.parametrize("values", [IMAGE, GRAY, IMAGE > 1])
def test_tiff_round_trip_and_another_reader(values):
    data = image_stack.encode_tiff(values)
    assert data == image_stack.encode_tiff(values)
    scale = 255 if values.dtype == bool else 1
    assert (image_stack.decode_tiff(data, "a.tif").values == values * scale).all()
    pages = tifffile.imread(io.BytesIO(data))
    assert pages.shape == values.shape[::-1]
    assert (pages[:, ::-1].transpose(2, 1, 0) == values * scale).all()


def test_a_tiff_states_the_size_of_a_voxel_on_every_page():
    data = image_stack.encode_tiff(IMAGE, (0.05, 0.04, 0.125))
    with tifffile.TiffFile(io.BytesIO(data)) as file:
        for page in file.pages:
            found = [page.tags[name].value for name in ("XResolution", "YResolution")]
            assert [10 * below / above for above, below in found] == pytest.approx([0.05, 0.04])
            assert page.tags["ResolutionUnit"].value == 3  # centimeters
        assert file.imagej_metadata["unit"] == "cm"
        assert file.imagej_metadata["spacing"] == pytest.approx(0.0125)
        assert file.imagej_metadata["slices"] == IMAGE.shape[2]
        assert (file.asarray()[:, ::-1].transpose(2, 1, 0) == IMAGE).all()
    found = image_stack.decode_tiff(data, "a.tif")
    assert (found.values == IMAGE).all()
    assert found.spacing == pytest.approx((0.05, 0.04, 0.125))


@pytest.mark.parametrize("edge", [0.02, 0.07, 1 / 3, 7.5 / 64, 1e-4, 25.4])
def test_cubic_voxels_of_a_tiff_stay_cubic(edge):
    spacing = image_stack.decode_tiff(image_stack.encode_tiff(IMAGE, (edge,) * 3), "a.tif").spacing
    assert len(set(spacing)) == 1
    assert spacing == pytest.approx((edge,) * 3)


def imagej_of(resolution=(20.0, 25.0), resolutionunit=1, **about):
    stream = io.BytesIO()
    pages = np.ascontiguousarray(IMAGE.T)
    metadata = {"axes": "ZYX", **about}
    tifffile.imwrite(
        stream, pages, imagej=True, resolution=resolution, resolutionunit=resolutionunit, metadata=metadata
    )
    return stream.getvalue()


@pytest.mark.parametrize(
    ("about", "mm"),
    [
        ({"unit": "mm"}, 1), ({"unit": "cm"}, 10), ({"unit": "um"}, 1e-3), ({"unit": "micron"}, 1e-3),
        ({"unit": "\\u00B5m"}, 1e-3), ({"unit": "nm"}, 1e-6), ({"unit": "inch"}, 25.4), ({"resolutionunit": 2}, 25.4),
        ({"resolutionunit": 3}, 10), ({"unit": "mm", "resolutionunit": 3}, 1),
    ],
)  # fmt: skip
def test_voxels_of_imagej_have_the_size_that_it_states(about, mm):
    found = image_stack.decode_tiff(imagej_of(spacing=0.5, **about), "a.tif")
    assert found.spacing == pytest.approx((0.05 * mm, 0.04 * mm, 0.5 * mm), rel=1e-6)


@pytest.mark.parametrize(
    "about",
    [
        {"unit": "mm"}, {"resolutionunit": 3}, {"spacing": 0.5}, {"unit": "pixel", "spacing": 0.5, "resolutionunit": 3},
        {"unit": "mm", "spacing": 0.0}, {"unit": "mm", "spacing": -1.0}, {"unit": "mm", "spacing": "wide"},
        {"unit": "mm", "spacing": float("inf")},
    ],
)  # fmt: skip
def test_a_tiff_that_does_not_state_all_edges_of_a_voxel_states_none(about):
    found = image_stack.decode_tiff(imagej_of(**about), "a.tif")
    assert found.spacing is None
    assert found.values.shape == IMAGE.shape


@pytest.mark.parametrize("values", [IMAGE, GRAY])
@pytest.mark.parametrize("spacing", [(0.05, 0.04, 0.125), None])
def test_nrrd_round_trip_and_another_reader(values, spacing):
    data = b"".join(nrrd.encode(np.asfortranarray(values), spacing))
    found = nrrd.decode(data, "a.nrrd")
    assert (found.values == values).all()
    assert found.values.dtype == values.dtype
    assert found.spacing == spacing
    stream = io.BytesIO(data)
    header = pynrrd.read_header(stream)
    assert header["encoding"] == "raw"
    assert header.get("units") == (["mm"] * 3 if spacing else None)
    assert (pynrrd.read_data(header, stream) == values).all()


def tiff_of(pages, **how):
    stream = io.BytesIO()
    with tifffile.TiffWriter(stream) as file:
        for page in pages:
            file.write(page, contiguous=False, **how)
    return stream.getvalue()


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.int16, np.float32, np.float64])
@pytest.mark.parametrize("order", ["<", ">"])
def test_tiff_of_others(kind, order):
    pages = (100 * np.random.default_rng(2).random((5, 4, 3))).astype(kind)
    for how in ({}, {"rowsperstrip": 2}, {"compression": "zlib"}, {"bigtiff": True}, {"imagej": order == ">"}):
        if how.get("imagej") and kind not in (np.uint8, np.uint16, np.float32):
            continue
        stream = io.BytesIO()
        big = {key: how[key] for key in how if key in ("bigtiff", "imagej")}
        rest = {key: how[key] for key in how if key not in big}
        tifffile.imwrite(stream, pages, byteorder=order, photometric="minisblack", **big, **rest)
        found = image_stack.decode_tiff(stream.getvalue(), "a.tif").values
        assert (found == pages[:, ::-1].transpose(2, 1, 0)).all()


def test_tiff_where_white_is_zero():
    pages = np.random.default_rng(3).integers(0, 256, (4, 3)).astype(np.uint8)
    found = image_stack.decode_tiff(tiff_of([pages], photometric="miniswhite"), "a.tif").values
    assert (255 - pages == found[:, ::-1, 0].T).all()


def test_a_strip_that_unpacks_to_more_than_its_pixels():
    page = np.zeros((1000, 1000), np.uint8)
    bomb = zlib.compress(bytes(200_000_000), 9)
    with tifffile.TiffFile(io.BytesIO(tiff_of([page], compression="zlib", rowsperstrip=1000))) as file:
        start, count = file.pages[0].dataoffsets[0], file.pages[0].databytecounts[0]
        place = file.pages[0].tags["StripByteCounts"].valueoffset
        offset = file.pages[0].tags["StripOffsets"].valueoffset
    data = bytearray(tiff_of([page], compression="zlib", rowsperstrip=1000))
    assert 0 < start < start + count <= len(data)
    data[place : place + 4] = len(bomb).to_bytes(4, "little")
    data[offset : offset + 4] = len(data).to_bytes(4, "little")
    tracemalloc.start()
    with pytest.raises(InputError, match="unpacks to more than the 1000000 bytes"):
        image_stack.decode_tiff(bytes(data) + bomb, "a.tif")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 30_000_000


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (tiff_of([np.zeros((4, 4, 3), np.uint8)], photometric="rgb"), "color type RGB"),
        (tiff_of([np.zeros((4, 4), np.uint8), np.zeros((4, 5), np.uint8)]), "pages of 2 kinds"),
        (tiff_of([np.zeros((4, 4), np.uint8), np.zeros((4, 4), np.uint16)]), "pages of 2 kinds"),
        (tiff_of([np.zeros((4, 4), np.uint8)]).replace(b"II*", b"II!"), "cannot be read"),
    ],
)
def test_tiff_that_is_no_stack_of_gray_pages(data, message):
    with pytest.raises(InputError, match=message):
        image_stack.decode_tiff(data, "a.tif")


@pytest.mark.parametrize(("decode", "module"), [(image_stack.decode_tiff, "tifffile"), (nrrd.decode, "nrrd")])
def test_a_missing_library_is_named_with_the_command_that_installs_it(decode, module, monkeypatch):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ResourceError, match=module) as caught:
        decode(b"x", "a")
    assert caught.value.hint == "pip install 'sppm-pipeline[images]'"


def test_a_folder_in_the_order_of_its_numbers(tmp_path):
    for k in range(11):
        Image.fromarray(np.full((3, 2), k, np.uint8)).save(tmp_path / f"layer{k}.png")
    found = image_stack.read_folder(tmp_path).values
    assert found.shape == (2, 3, 11)
    assert found[0, 0].tolist() == list(range(11))


def test_a_folder_of_tiff_files(tmp_path):
    pages = np.random.default_rng(4).integers(0, 9, (3, 4, 5)).astype(np.uint8)
    for k, page in enumerate(pages):
        (tmp_path / f"{k}.tif").write_bytes(tiff_of([page], photometric="minisblack"))
    assert (image_stack.read_folder(tmp_path).values == pages[:, ::-1].transpose(2, 1, 0)).all()
    (tmp_path / "3.tif").write_bytes(tiff_of(pages[:2]))
    with pytest.raises(InputError, match="2 pages; in a folder"):
        image_stack.read_folder(tmp_path)


def test_rows_run_down_in_y(tmp_path):
    page = np.zeros((3, 2), np.uint8)
    page[0, 1] = 9
    Image.fromarray(page).save(tmp_path / "0.png")
    assert image_stack.read_folder(tmp_path).values[1, 2, 0] == 9


def saved(array):
    stream = io.BytesIO()
    np.save(stream, array, allow_pickle=True)
    return stream.getvalue()


GOOD = b"".join(encode_npy(np.asfortranarray(IMAGE)))
HOSTILE = {
    "npy empty": (decode_npy, b""),
    "npy objects": (decode_npy, saved(np.array([[[{}]]], object))),
    "npy text": (decode_npy, saved(np.array([[["a"]]]))),
    "npy complex": (decode_npy, saved(np.ones((2, 2, 2), complex))),
    "npy two axes": (decode_npy, saved(np.ones((2, 2)))),
    "npy no voxels": (decode_npy, saved(np.ones((0, 2, 2)))),
    "npy cut": (decode_npy, GOOD[:-1]),
    "npy too long": (decode_npy, GOOD + b"x"),
    "npy huge claim": (decode_npy, GOOD.replace(b"(3, 4, 5)", b"(9999999999, 4, 5)", 1)),
    "npy code in the header": (decode_npy, GOOD.replace(b"(3, 4, 5)", b"exit(1234)", 1)),
    "npy negative": (decode_npy, GOOD.replace(b"(3, 4, 5)", b"(-3,-4,5)", 1)),
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
    "tiff empty": (image_stack.decode_tiff, b""),
    "tiff cut": (image_stack.decode_tiff, image_stack.encode_tiff(IMAGE)[:40]),
    "tiff text": (image_stack.decode_tiff, b"hello"),
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
    (decode_npy, GOOD),
    (nrrd.decode, nrrd_of(IMAGE, "gzip", spacings="1 2 3")),
    (image_stack.decode_tiff, image_stack.encode_tiff(IMAGE)),
]


@given(which=st.integers(0, len(SEEDS) - 1), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=400, derandomize=True, deadline=None)
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


def vti_of(values, form, packed, *, kind="CellData", word="UInt32", order="LittleEndian", blocks=2, **image):
    """A .vti file as VTK writes it, by the rules of its format."""
    n = dict(zip("xyz", values.shape, strict=True))
    raw = values.astype(values.dtype.newbyteorder("<" if order == "LittleEndian" else ">")).tobytes(order="F")
    count = {"UInt32": 4, "UInt64": 8}[word]

    def head(*numbers):
        return b"".join(number.to_bytes(count, "little" if order == "LittleEndian" else "big") for number in numbers)

    def text(data):
        return data if form == "raw" else base64.b64encode(data)

    if packed:
        size = len(raw) // blocks
        parts = [zlib.compress(raw[i : i + size]) for i in range(0, len(raw), size)]
        body = text(head(len(parts), size, len(raw) % size, *map(len, parts))) + text(b"".join(parts))
    else:
        body = text(head(len(raw)) + raw)
    if form == "ascii":
        body = " ".join(map(str, values.reshape(-1, order="F").tolist())).encode()
    more = kind == "PointData"
    extent = " ".join(f"5 {5 + length - more}" for length in n.values())
    about = {"Origin": "1 2 3", "Spacing": "0.5 1 2", **image}
    attributes = " ".join(f'{key}="{value}"' for key, value in about.items())
    inline = form in ("ascii", "binary")
    array = (
        f'type="{values.dtype.name.title().replace("Ui", "UI")}" Name="ct" format="{form if inline else "appended"}"'
    )
    kept = f">{body.decode()}</DataArray>" if inline else ' offset="3"/>'
    tail = b"" if inline else f'<AppendedData encoding="{form}">_'.encode() + b"abc" + body + b"</AppendedData>"
    compressor = 'compressor="vtkZLibDataCompressor"' if packed else ""
    return (
        (
            f'<?xml version="1.0"?><VTKFile type="ImageData" byte_order="{order}" header_type="{word}" {compressor}>'
            f'<ImageData WholeExtent="{extent}" {attributes}><Piece Extent="{extent}"><{kind}>'
            f'<DataArray {array}{kept}<DataArray type="Float32" Name="flow" NumberOfComponents="3" format="ascii"/>'
            f"</{kind}></Piece></ImageData>"
        ).encode()
        + tail
        + b"</VTKFile>"
    )


@pytest.mark.parametrize("packed", [False, True], ids=["plain", "zlib"])
@pytest.mark.parametrize("form", ["ascii", "binary", "raw", "base64"])
@pytest.mark.parametrize("values", [IMAGE, GRAY], ids=["phases", "gray"])
def test_vti_of_all_kinds_are_read(values, form, packed):
    for more in ({}, {"word": "UInt64", "order": "BigEndian", "blocks": 3}):
        found = vti.decode(vti_of(values, form, packed, **more), "a.vti")
        np.testing.assert_array_equal(found.values, values)
        assert found.values.dtype == values.dtype
        assert found.spacing == (0.5, 1, 2)
        assert found.origin == (3.5, 7, 13)  # the low corner of cell 5, 5, 5
    points = vti.decode(vti_of(values, form, packed, kind="PointData"), "a.vti", "ct")
    assert points.origin == (3.25, 6.5, 12)
    np.testing.assert_array_equal(points.values, values)


def test_vti_that_lie():
    good = vti_of(IMAGE, "raw", True)
    for data, words in (
        (good[:-90], "cut short|damaged|another length"), (good.replace(b"ImageData", b"PolyData"), "not an image"),
        (good.replace(b'Spacing="0.5', b'Spacing="-1'), "positive"),
        (good.replace(b'Extent="5 8', b'Extent="5 99'), "announced"),
        (good.replace(b"UInt8", b"Complex"), "not read"), (good.replace(b"ZLib", b"LZMA"), "LZMA"),
        (b'<!DOCTYPE a [<!ENTITY b "ccc">]>' + good[21:], "entities"),
        (good.replace(b'"ct"', b'"flow"'), "no single array"),
        (vti_of(IMAGE, "raw", True, Direction="0 1 0 1 0 0 0 0 1"), "turned"), (b"", "well-formed|not an image"),
        (good.replace(b'Extent="5 8', b'Extent="5 8888888888'), "limit"),
        (vti_of(IMAGE, "ascii", False)[:-200], "well-formed"),
        (good.replace(b'offset="3"', b'offset="99999999"'), "cut short"), (b"<a>" * 10_000, "well-formed"),
    ):  # fmt: skip
        array = "flow" if words == "no single array" else None
        with pytest.raises(InputError, match=words) as caught:
            vti.decode(data, "a.vti", array)
        assert "a.vti" in str(caught.value)
    with pytest.raises(InputError, match="several components"):
        vti.decode(good, "a.vti", "flow")


@given(st.integers(0, 1500), st.integers(0, 255), st.sampled_from(["raw", "binary", "ascii"]))
@settings(max_examples=60, deadline=None)
def test_mutated_vti_are_images_or_errors(at, byte, form):
    data = bytearray(vti_of(IMAGE, form, form != "ascii"))
    data[at % len(data)] = byte
    with contextlib.suppress(InputError):
        vti.decode(bytes(data), "a.vti")


def read_zarr(folder, name):
    """By the format's own words: blocks of an array and its attributes."""
    about = json.loads((folder / name / "zarr.json").read_text())
    assert json.loads((folder / "zarr.json").read_text())["consolidated_metadata"]["metadata"][name] == about
    block = about["chunk_grid"]["configuration"]["chunk_shape"]
    values = np.empty([-(-n // b) * b for n, b in zip(about["shape"], block, strict=True)], about["data_type"])
    for place in np.ndindex(*(n // b for n, b in zip(values.shape, block, strict=True))):
        data = gzip.decompress((folder / name / "c" / "/".join(map(str, place))).read_bytes())
        part = np.frombuffer(data, f"<{values.dtype.str[1:]}").reshape(block)
        values[tuple(slice(i * b, (i + 1) * b) for i, b in zip(place, block, strict=True))] = part
    return values[tuple(map(slice, about["shape"]))], about


def write_zarr(folder, values):
    for name, data in zarr_store.encode(np.asfortranarray(values), (0.05, 0.04, 0.125), "mm", "phase", {"a": 1}):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


BLOCKS = np.random.default_rng(4).integers(0, 2, (70, 64, 3)).astype(np.uint8)


@pytest.mark.parametrize("values", [IMAGE, GRAY, BLOCKS])
def test_zarr_round_trip(values, tmp_path):
    assert write_zarr(tmp_path / "a", values) == write_zarr(tmp_path / "b", values)
    found, about = read_zarr(tmp_path / "a", "phase")
    assert (found == values).all()
    assert about["attributes"] == {"a": 1, "spacing": [0.05, 0.04, 0.125], "spacing_unit": "mm"}
    assert about["dimension_names"] == ["x", "y", "z"]
    z, about = read_zarr(tmp_path / "a", "z")
    assert z == pytest.approx(0.125 * (np.arange(values.shape[2]) + 0.5))
    assert about["attributes"]["units"] == "mm"


def test_xarray_opens_a_zarr_store(tmp_path):
    pytest.importorskip("zarr")
    write_zarr(tmp_path / "a", BLOCKS)
    opened = pytest.importorskip("xarray").open_zarr(tmp_path / "a")
    assert (opened["phase"].to_numpy() == BLOCKS).all()
    assert opened["phase"].dims == ("x", "y", "z")
    assert opened["x"].attrs["units"] == "mm"
    assert opened["phase"].sel(x=0.06, method="nearest").to_numpy().tolist() == BLOCKS[1].tolist()


@pytest.mark.parametrize("fractions", [False, True])
def test_a_stage_writes_a_zarr_folder(tmp_path, fractions):
    context = PlainContext(directory=tmp_path)
    values = GRAY if fractions else IMAGE
    WriteVoxels(path="cell.zarr").run(context, Voxels(values, (1.0, 2.0, 3.0), True, (True,) * 3))
    found, about = read_zarr(tmp_path / "cell.zarr", "fraction" if fractions else "phase")
    assert (found == values).all()
    assert about["attributes"]["spacing"] == [1, 2, 3]
