"""Contours as CLI and SVG, read back: areas and fillings equal to the layers', heights, places, and smooth ones."""

import itertools
import re
import struct
from xml.etree import ElementTree

import numpy as np
import pytest

from sppm_pipeline import SliceStack
from sppm_pipeline.errors import ConfigError
from sppm_pipeline.features.printing.stages.write_cli import WriteCli, area
from sppm_pipeline.features.printing.stages.write_svg import WriteSvg
from sppm_pipeline.services.outlines import level_lines
from sppm_pipeline.testing.plain_context import PlainContext

PIXEL, LAYER = (0.1, 0.25), 0.05


def stack_of(layers):
    return SliceStack.from_array(layers, pixel_mm=PIXEL, layer_mm=LAYER)


def random_layers(seed=0):
    layers = np.random.default_rng(seed).random((5, 20, 30)) < 0.5
    layers[2] = False
    return layers


def write(stage, layers, folder, threads=1):
    stage.check_options()
    stage.run(PlainContext(directory=folder, threads=threads), stack_of(layers))
    return folder / stage.path


def read_cli(data):
    """Header, and (height, [(direction, points)]) of each layer."""
    head, _, rest = data.partition(b"$$HEADEREND")
    header = dict(re.findall(r"\$\$(\w+)/(.*)", head.decode()))
    layers = []
    if b"$$ASCII" in head:
        for line in rest.decode().split("\n"):
            word, _, values = line.partition("/")
            if word == "$$LAYER":
                layers.append((float(values), []))
            elif word == "$$POLYLINE":
                _, way, count, *numbers = values.split(",")
                points = np.array(numbers, float).reshape(-1, 2)
                assert len(points) == int(count)
                layers[-1][1].append((int(way), points))
        assert rest.startswith(b"\n$$GEOMETRYSTART\n")
        assert rest.endswith(b"$$GEOMETRYEND\n")
    at = 0
    while b"$$BINARY" in head and at < len(rest):
        (command,) = struct.unpack_from("<H", rest, at)
        if command == 127:
            layers.append((struct.unpack_from("<f", rest, at + 2)[0], []))
            at += 6
        else:
            assert command == 130
            _, way, count = struct.unpack_from("<3i", rest, at + 2)
            points = np.frombuffer(rest, "<f4", 2 * count, at + 14).reshape(-1, 2)
            layers[-1][1].append((way, points.astype(float)))
            at += 14 + 8 * count
    return header, layers


def filled(rings, shape):
    """Pixels (ny, nx) whose middle has an odd number of crossings to its left."""
    y = (np.arange(shape[0]) + 0.5) * PIXEL[1]
    inside = np.zeros(shape, bool)
    for ring in rings:
        for (x0, y0), (x1, y1) in itertools.pairwise(ring):
            if y0 != y1:
                rows = (y > min(y0, y1)) & (y < max(y0, y1))
                inside[rows, round((x0 + x1) / 2 / PIXEL[0]) :] ^= True
    return inside


@pytest.mark.parametrize("binary", [False, True])
def test_cli_holds_the_layers_to_the_pixel(binary, tmp_path):
    layers = random_layers()
    data = write(WriteCli(binary=binary), layers, tmp_path).read_bytes()
    header, found = read_cli(data)
    assert header["UNITS"] == "1.000000"
    assert int(header["LAYERS"]) == len(found) == 5
    assert np.allclose(np.array(header["DIMENSION"].split(","), float), [0, 0, 0, 3, 5, 0.25])
    assert np.allclose([z for z, _ in found], LAYER * np.arange(1, 6))
    for layer, (_, rings) in zip(layers, found, strict=True):
        assert all(np.array_equal(ring[0], ring[-1]) for _, ring in rings)
        assert all((area(ring[:-1]) > 0) == way for way, ring in rings)
        assert sum(area(ring[:-1]) for _, ring in rings) == pytest.approx(layer.sum() * PIXEL[0] * PIXEL[1], abs=1e-5)
        assert np.array_equal(filled([ring for _, ring in rings], layer.shape), layer)
    (tmp_path / "again").mkdir()
    assert write(WriteCli(binary=binary), layers, tmp_path / "again", threads=3).read_bytes() == data


def test_svg_holds_the_layers_to_the_pixel(tmp_path):
    layers = random_layers(1)
    folder = write(WriteSvg(), layers, tmp_path)
    assert sorted(path.name for path in folder.glob("*.svg")) == [f"{k:05d}.svg" for k in range(5)]
    for k, layer in enumerate(layers):
        root = ElementTree.parse(folder / f"{k:05d}.svg").getroot()
        assert (root.get("width"), root.get("height")) == ("3.000000mm", "5.000000mm")
        path = root[0].get("d")
        rings = [
            np.array([point.split(",") for point in text.split()], float) for text in re.findall("M([^Z]*)Z", path)
        ]
        rings = [np.vstack([ring, ring[:1]]) for ring in rings]
        # y points down, and so do areas
        assert -sum(area(ring[:-1]) for ring in rings) == pytest.approx(layer.sum() * PIXEL[0] * PIXEL[1], abs=1e-5)
        assert np.array_equal(filled(rings, layer.shape)[::-1], layer)


def disk(radius):
    """A disk by the covered share of its pixels, from 8 x 8 samples of each."""
    y, x = (np.mgrid[:160, :320] + 0.5) / 8
    solid = np.hypot(x - 20, y - 10) < radius
    return np.round(255 * solid.reshape(20, 8, 40, 8).mean((1, 3))).astype(np.uint8)


def test_smooth_contours_run_through_grays(tmp_path):
    radius = 7.3
    _, ((_, rings),) = read_cli(write(WriteCli(through_grays=True), disk(radius)[None], tmp_path).read_bytes())
    ((way, ring),) = rings
    distance = np.hypot(ring[:, 0] / PIXEL[0] - 20, ring[:, 1] / PIXEL[1] - 10)
    assert way == 1
    assert np.abs(distance - radius).max() < 1 / 8
    assert area(ring[:-1]) == pytest.approx(np.pi * radius**2 * PIXEL[0] * PIXEL[1], rel=1e-2)


def test_lines_are_those_of_another_program():
    measure = pytest.importorskip("skimage.measure")
    values = np.random.default_rng(3).random((30, 40))
    ours = level_lines(values, 0.5)
    others = measure.find_contours(np.pad(values, 1), 0.5, fully_connected="low")
    assert sorted(abs(area(ring)) for ring in ours) == pytest.approx(sorted(abs(area(r[:-1])) for r in others))
    assert level_lines(np.zeros((3, 4)), 0.5) == []


def test_smooth_contours_need_grays(tmp_path):
    with pytest.raises(ConfigError, match="these are black and white"):
        write(WriteSvg(through_grays=True), random_layers(), tmp_path)
