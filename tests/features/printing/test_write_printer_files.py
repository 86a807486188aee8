"""Printer files, read by decoders written here from the formats' descriptions: every pixel, every setting."""

from __future__ import annotations

import configparser
import hashlib
import io
import itertools
import struct
import zipfile
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.printing.printer_writer import Preview
from sppm_pipeline.features.printing.stages import write_goo as goo
from sppm_pipeline.features.printing.stages.write_goo import WriteGoo
from sppm_pipeline.features.printing.stages.write_nanodlp import WriteNanodlp
from sppm_pipeline.features.printing.stages.write_sl1 import WriteSl1
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.nouns.printer import Motion, Printer, cards
from sppm_pipeline.method.part.primitive_meshes import box_mesh
from sppm_pipeline.method.slicing.slice_stack import SliceStack
from sppm_pipeline.method.stages.slice_mesh import SliceMesh
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.testing.plain_context import PlainContext

WRITERS = {"sl1": WriteSl1, "goo": WriteGoo, "nanodlp": WriteNanodlp}
MOTION = Motion(
    lift_mm=(7, 5), lift_mm_min=(80, 100), retract_mm_min=(120, 150), wait_before_cure_s=(3, 2.5),
    wait_after_cure_s=(2, 1), wait_after_lift_s=(0.5, 0.25),
)  # fmt: skip


def machine(kind, **changed):
    """A small printer, with pixels of 19 x 24 um that no part divides evenly."""
    made = Printer(
        name="small", model="Small One", format=kind, pixels=(93, 71), display_mm=(93 * 0.019, 71 * 0.024),
        height_mm=20, mirror_x=True, motion=MOTION, source="a test", verified_on_hardware=False,
    )  # fmt: skip
    return replace(made, **changed)


def noise(printer, gray=False, shape=(6, 37, 44), seed=1):
    """Layers like a porous part's: blobs, a layer that is black, one that is white, and pixels at all borders."""
    rng = np.random.default_rng(seed)
    layers = np.kron(rng.random((shape[0], shape[1] // 3 + 1, shape[2] // 5 + 1)) < 0.5, np.ones((1, 3, 5)))
    layers = layers[:, : shape[1], : shape[2]].astype(np.uint8) * 255
    if gray:
        layers[rng.random(shape) < 0.2] = 0
        some = rng.random(shape) < 0.3
        layers[some] = rng.integers(0, 256, some.sum())
    layers[1], layers[2] = 0, 255
    return SliceStack.from_array(layers, pixel_mm=printer.pixel_mm, layer_mm=0.05, printer=printer), layers


def written(stack, folder, **options):
    context = PlainContext(directory=folder, threads=2)
    stage = WRITERS[stack.printer.format](**{"sheet": 0, **options})
    stage.check_options()
    stage.run(context, stack)
    return folder / stage.path, context


# Decoders --------------------------------------------------------------------------------------------------------


def goo_runs(data):
    """(length, gray) of a layer by the format's text: kind and size of the length in the first byte."""
    at, gray = 0, 0
    while at < len(data):
        head = data[at]
        kind, extra, length = head >> 6, head >> 4 & 3, head & 15
        at += 1
        if kind == 2:  # a difference to the gray before
            gray += -length if extra & 2 else length
            length = data[at] if extra & 1 else 1
            at += extra & 1
        else:
            if kind == 1:
                gray = data[at]
                at += 1
            gray = {0: 0, 1: gray, 3: 255}[kind]
            length |= int.from_bytes(data[at : at + extra], "big") << 4
            at += extra
        yield length, gray


def read_goo(path, order=">"):
    data = path.read_bytes()
    assert data[:12] == b"V3.0\x07\x00\x00\x00DLP\x00"
    assert data[-11:] == b"\x00\x00\x00\x07\x00\x00\x00DLP\x00"
    assert data[27106:27108] == data[195308:195310] == b"\r\n"
    layers, width, height = struct.unpack_from(order + "IHH", data, 195310)
    (at,) = struct.unpack_from(order + "I", data, 195470)
    pictures, records = [], []
    for _ in range(layers):
        record = struct.unpack_from(order + "H15fH", data, at)
        assert data[at + 64 : at + 66] == b"\r\n"
        (length,) = struct.unpack_from(order + "I", data, at + 66)
        body = data[at + 70 : at + 70 + length]
        assert body[0] == 0x55
        assert body[-1] == ~sum(body[1:-1]) & 255
        at += 70 + length + 2
        assert data[at - 2 : at] == b"\r\n"
        runs = list(goo_runs(body[1:-1]))
        flat = np.repeat([gray for _, gray in runs], [n for n, _ in runs])
        assert flat.size == width * height  # the printer's buffer is not cleared
        pictures.append(flat.reshape(height, width))
        records.append(record)
    assert at == len(data) - 11
    return np.array(pictures, np.uint8), data, records


def read_archive(path, name=lambda k: f"{k + 1}.png"):
    with zipfile.ZipFile(path) as archive:
        assert archive.testzip() is None
        names = archive.namelist()
        count = sum(n.endswith(".png") and "/" not in n for n in names)
        pictures = []
        for k in range(count):
            with Image.open(io.BytesIO(archive.read(name(k)))) as image:
                pixels = np.asarray(image)
                pictures.append(pixels.reshape(pixels.shape[0], -1))
                mode = image.mode
        return np.array(pictures), mode, {n: archive.read(n) for n in names if not n.endswith(".png")}, names


def read_sl1(path):
    return read_archive(path, lambda k: f"{path.stem}{k:05d}.png")


def on_plate(pictures, printer):
    """Layers (nz, ny, nx) of the whole plate, rows in order of increasing y, as a person faces the printer."""
    if printer.mirror_x:
        pictures = pictures[:, :, ::-1]
    if printer.mirror_y:
        pictures = pictures[:, ::-1]
    pictures = pictures[:, ::-1]  # row 0 is at the top
    return pictures.transpose(0, 2, 1)[:, ::-1] if printer.portrait else pictures


def all_pictures(path, kind):
    return {"sl1": read_sl1, "goo": read_goo, "nanodlp": read_archive}[kind](path)[0]


def expected(layers, printer):
    """The part in the middle of the plate."""
    nz, ny, nx = layers.shape
    plate = np.zeros((nz, printer.pixels[1], printer.pixels[0]), np.uint8)
    x, y = (printer.pixels[0] - nx) // 2, (printer.pixels[1] - ny) // 2
    plate[:, y : y + ny, x : x + nx] = layers
    return plate


CHANGES = [
    {}, {"mirror_x": False}, {"mirror_y": True}, {"portrait": True}, {"portrait": True, "mirror_x": False},
    {"portrait": True, "mirror_y": True}, {"pixels": (44, 37)}, {"pixels": (45, 37)}, {"pixels": (44, 40)},
]  # fmt: skip
"""Displays that differ from `machine`: mirrored, turned, and with little or no room around the part."""


@pytest.fixture
def no_thumbnails(monkeypatch):
    """Rendering takes most of the time of a small file."""
    monkeypatch.setattr(Preview, "picture", lambda self, width, height: np.zeros((height, width, 3), np.uint8))


@pytest.mark.usefixtures("no_thumbnails")
@pytest.mark.parametrize(
    ("changed", "gray"),
    [
        ({}, False),
        *((change, True) for change in CHANGES),
    ],
    ids=str,
)
@pytest.mark.parametrize("kind", WRITERS)
def test_every_pixel_is_where_it_belongs(kind, changed, gray, tmp_path):
    printer = machine(kind, **changed)
    printer = replace(printer, display_mm=(printer.pixels[0] * 0.019, printer.pixels[1] * 0.024))
    stack, layers = noise(printer, gray)
    path, _ = written(stack, tmp_path)
    assert np.array_equal(on_plate(all_pictures(path, kind), printer), expected(layers, printer))


@pytest.mark.parametrize(
    ("changed", "gray"),
    [({}, False), ({"mirror_x": True, "portrait": True}, True), ({"mirror_y": True}, True)],
    ids=str,
)
@pytest.mark.parametrize("kind", WRITERS)
def test_what_is_written_is_read_again_for_reports(kind, changed, gray, tmp_path, monkeypatch):
    printer = machine(kind, **changed)
    printer = replace(printer, display_mm=(printer.pixels[0] * 0.019, printer.pixels[1] * 0.024))
    stack, layers = noise(printer, gray)
    path, context = written(stack, tmp_path)
    own = SimpleNamespace(printer={printer.name: printer}.__getitem__)
    monkeypatch.setattr("sppm_pipeline.features.printing.printer_writer.cards", lambda file: own)
    found = WRITERS[kind].stored(path, context.reported, {"cards": None})
    assert found.layers == stack.shape[2]
    assert found.size == stack.shape[:2]
    for k in (3, 0, 5, 1):
        assert np.array_equal(found.image(k)[::-1], layers[k])
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])  # a broken file is no layer, and no crash
    with pytest.raises((OSError, ValueError, LookupError, zipfile.BadZipFile, struct.error)):
        WRITERS[kind].stored(path, context.reported, {}).image(5)


@pytest.mark.parametrize(("width", "gray"), [(7, 255), (8, 9), (64, 255), (1, 1), (4096, 77)])
def test_long_runs_and_narrow_blocks(width, gray):
    block = np.full((5, width), gray, np.uint8)
    for top, left, height, columns in [
        (0, 0, 5, width),
        (3, 0, 900, width),
        (1, 2, 7, width + 3),
        (0, 5, 5, 5 + width),
    ]:
        data = goo.encode_layer(block, top, left, height, columns)
        runs = list(goo_runs(data[1:-1]))
        assert sum(n for n, _ in runs) == height * columns
        assert all(a[1] != b[1] for a, b in itertools.pairwise(runs))  # no two runs that could be one
        flat = np.repeat([g for _, g in runs], [n for n, _ in runs]).reshape(height, columns)
        assert np.array_equal(flat[top : top + 5, left : left + width], block)
        assert flat.sum() == block.sum(dtype=int)
    with pytest.raises(ValueError, match="do not lie in"):
        goo.encode_layer(block, 0, 1, 5, width)


def test_a_run_may_be_longer_than_its_length_field():
    data = goo.encode_layer(np.full((1, 1), 255, np.uint8), 40000, 0, 40001, 20000)
    runs = list(goo_runs(data[1:-1]))
    assert [gray for _, gray in runs] == [0, 0, 0, 255, 0]
    assert sum(n for n, gray in runs[:3]) == 40000 * 20000


def test_the_header_of_a_goo_file(tmp_path):
    printer = machine("goo", mirror_y=True)
    stack, layers = noise(printer, gray=True)
    path, context = written(stack, tmp_path, bottom_layers=2, exposure=1.5, bottom_exposure=20.0)
    _, data, records = read_goo(path)

    def at(offset, code):
        return struct.unpack_from(">" + code, data, offset)

    volume = layers.sum(dtype=float) / 255 * 0.019 * 0.024 * 0.05
    assert data[68:92].rstrip(b"\0") == b"1980-01-01 00:00:00"
    assert data[92:124].rstrip(b"\0") == b"Small One"
    assert at(195310, "IHH??") == (6, 93, 71, True, True)
    assert at(195320, "5f") == pytest.approx((93 * 0.019, 71 * 0.024, 20, 0.05, 1.5))
    assert at(195340, "?7f") == pytest.approx((True, 0, 2, 0.5, 3, 1, 0.25, 2.5))
    assert at(195369, "fI") == pytest.approx((20, 2))
    assert at(195377, "8f") == pytest.approx((7, 80, 5, 100, 7, 120, 5, 150))
    assert at(195441, "HH?") == (255, 255, False)
    seconds = 2 * (20 + 5.5 + 7 * 60 * (1 / 80 + 1 / 120)) + 4 * (1.5 + 3.75 + 5 * 60 * (1 / 100 + 1 / 150))
    assert at(195446, "I3f") == pytest.approx((round(seconds), volume, volume * 1.1e-3, volume * 30e-6))
    assert at(195470, "I?H") == (195477, True, 0)
    assert context.reported["print_time_s"] == pytest.approx(seconds)
    assert context.reported["resin_ml"] == pytest.approx(volume / 1000)
    for number, record in enumerate(records):
        k = int(number >= 2)
        waits = [(2, 0.5, 3), (1, 0.25, 2.5)][k]
        moves = [(7, 80, 0, 0, 7, 120, 0, 0), (5, 100, 0, 0, 5, 150, 0, 0)][k]
        assert record == pytest.approx((0, 20, 0.05 * (number + 1), (20, 1.5)[k], 0, *waits, *moves, 255))


def test_little_endian_files_differ_in_their_numbers_alone(tmp_path):
    stack, layers = noise(machine("goo", little_endian=True))
    path, _ = written(stack, tmp_path)
    pictures, data, _ = read_goo(path, "<")
    assert np.array_equal(on_plate(pictures, stack.printer), expected(layers, stack.printer))
    assert struct.unpack_from("<f", data, 195332)[0] == pytest.approx(0.05)


def test_the_settings_of_an_sl1_file(tmp_path):
    stack, layers = noise(machine("sl1", portrait=True))
    path, _ = written(stack, tmp_path, path="thumb.sl1")
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
        assert {info.date_time for info in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
        ini = {}
        for name in ("config.ini", "prusaslicer.ini"):
            parser = configparser.ConfigParser()
            parser.optionxform = str
            parser.read_string("[a]\n" + archive.read(name).decode())
            ini[name] = dict(parser["a"])
        sizes = {}
        for name in names:
            if name.startswith("thumbnail/"):
                with Image.open(io.BytesIO(archive.read(name))) as image:
                    sizes[name] = (image.size, image.mode)
                    assert np.asarray(image).std() > 5  # something is seen
            elif name.endswith(".png"):
                with Image.open(io.BytesIO(archive.read(name))) as image:
                    assert (image.size, image.mode) == ((71, 93), "L")
    assert sizes == {
        "thumbnail/thumbnail400x400.png": ((400, 400), "RGBA"), "thumbnail/thumbnail800x480.png": ((800, 480), "RGBA")
    }  # fmt: skip
    config, profile = ini["config.ini"], ini["prusaslicer.ini"]
    job = config["jobDir"]  # the firmware takes every PNG whose name starts with it
    assert [n for n in names if n.endswith(".png") and n.startswith(job)] == [f"{job}{k:05d}.png" for k in range(6)]
    assert int(config["numFast"]) + int(config["numSlow"]) == 6
    assert config["printerModel"] == "Small One"
    assert (config["expTime"], config["expTimeFirst"], config["numFade"]) == ("2.5", "25", "5")
    assert config["layerHeight"] == "0.05"
    assert float(config["usedMaterial"]) == pytest.approx(layers.sum() / 255 * 0.019 * 0.024 * 0.05e-3, rel=1e-3)
    assert [profile[f"display_{w}"] for w in ("pixels_x", "pixels_y", "mirror_x", "mirror_y", "orientation")] == [
        "93", "71", "1", "0", "portrait"
    ]  # fmt: skip
    assert (profile["layer_height"], profile["initial_layer_height"]) == ("0.05", "0.05")


def test_three_pixels_may_be_the_colors_of_one(tmp_path):
    stack, layers = noise(machine("nanodlp", subpixels=True), gray=True)
    path, _ = written(stack, tmp_path)
    pictures, mode, others, names = read_archive(path)
    assert (mode, others, names[0]) == ("RGB", {}, "1.png")
    assert np.array_equal(on_plate(pictures, stack.printer), expected(layers, stack.printer))


@pytest.mark.usefixtures("no_thumbnails")
@pytest.mark.parametrize("kind", WRITERS)
def test_grays_start_where_the_resin_cures(kind, tmp_path):
    layers = np.arange(256, dtype=np.uint8).reshape(1, 16, 16)
    printer = machine(kind)
    stack = SliceStack.from_array(layers, pixel_mm=printer.pixel_mm, layer_mm=0.05, printer=printer)
    path, _ = written(stack, tmp_path, gray_from=100)
    found = on_plate(all_pictures(path, kind), printer)[expected(np.ones_like(layers), printer) > 0]
    assert (found[0], found[1], found[255]) == (0, 100, 255)
    assert (np.diff(found[1:].astype(int)) >= 0).all()
    assert found[128] == round(100 + 127 * 155 / 254)


@pytest.mark.parametrize("kind", WRITERS)
def test_the_same_bytes_every_time(kind, tmp_path):
    stack, _ = noise(machine(kind))
    seen = set()
    for threads in (1, 3):
        folder = tmp_path / str(threads)
        folder.mkdir()
        WRITERS[kind](path="a" + {"sl1": ".sl1", "goo": ".goo", "nanodlp": ".zip"}[kind]).run(
            PlainContext(directory=folder, threads=threads), stack
        )
        seen.add(hashlib.sha256(next(f for f in folder.iterdir() if f.suffix != ".png").read_bytes()).hexdigest())
    assert len(seen) == 1


@pytest.mark.parametrize("name", ["elegoo_mars_4_dlp", "prusa_sl1s"])
def test_a_cube_of_10_mm_measures_10_mm(name, tmp_path):
    printer = cards().printer(name)
    cube = SurfaceMesh(*box_mesh((0.123, -3.21, 7.7), (10, 10, 0.3)), name="cube")
    stack = SliceMesh(printer=name, layer=Length(0.1, "mm")).run(PlainContext(), cube)
    path, _ = written(stack, tmp_path)
    plate = on_plate(all_pictures(path, printer.format), printer)
    assert len(plate) == 3
    for axis, pitch in ((2, printer.pixel_mm[0]), (1, printer.pixel_mm[1])):
        solid = np.flatnonzero(plate.any(axis=tuple({0, 1, 2} - {axis})))
        assert (solid[-1] - solid[0] + 1) * pitch == pytest.approx(10, abs=pitch)
        middle = (solid[0] + solid[-1] + 1) / 2 - plate.shape[axis] / 2
        assert abs(middle) <= 1


def test_what_is_refused_before_a_layer_is_written(tmp_path):
    stack, layers = noise(machine("goo"))
    with pytest.raises(ConfigError, match=r"cut for none"):
        WriteGoo().run(PlainContext(directory=tmp_path), SliceStack.from_array(layers, pixel_mm=0.05))
    with pytest.raises(ConfigError, match=r"no files for small") as caught:
        WriteSl1().run(PlainContext(directory=tmp_path), stack)
    assert "write.goo" in caught.value.hint
    large, _ = noise(machine("goo", pixels=(40, 71), display_mm=(40 * 0.019, 71 * 0.024)))
    with pytest.raises(DesignError, match=r"the part is 0.836 x 0.888 x 0.3 mm; small prints 0.76 x 1.704 x 20 mm"):
        WriteGoo().run(PlainContext(directory=tmp_path), large)
    wrong = SliceStack.from_array(layers, pixel_mm=0.02, layer_mm=0.05, printer=machine("goo"))
    with pytest.raises(ConfigError, match="those of small are 19 x 24 um"):
        WriteGoo().run(PlainContext(directory=tmp_path), wrong)
    with pytest.raises(ConfigError, match="no resin called 'generic_grey'") as caught:
        WriteGoo(resin="generic_grey").check_options()
    assert "generic_gray" in caught.value.hint
    assert not list(tmp_path.iterdir())
