"""The base class of layer writers, as authors of printer containers use it."""

from __future__ import annotations

import json
import zipfile
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from sppm_pipeline.engine.plan.session import RunRequest, open_session
from sppm_pipeline.engine.run.runner import run_plan
from sppm_pipeline.errors import PluginError
from sppm_pipeline.method.families.layer_writer import LayerWriter
from sppm_pipeline.method.stages.slice_field import SliceField
from sppm_pipeline.services.bit_rows import unpack
from sppm_pipeline.stage import option
from sppm_pipeline.testing.plain_context import PlainContext


@dataclass(frozen=True, kw_only=True)
class WriteRaw(LayerWriter):
    """A folder of raw layers: only the method that every writer needs."""

    name: ClassVar[str] = "write.raw"
    suffix: ClassVar[str] = ".raw"

    path: str = option("layers", help="folder to write", output=True)

    def encode(self, image, stack):
        assert image.flags.c_contiguous
        return image.tobytes()


@dataclass(frozen=True, kw_only=True)
class WriteContainer(WriteRaw):
    """A file that holds the size of a pixel, all layers and, known only at the end, how much is solid."""

    name: ClassVar[str] = "write.container"

    path: str = option("part.v1.zip", help="file to write", output=True)

    def store(self, target, stack, layers):
        with zipfile.ZipFile(target, "w") as archive:
            archive.writestr("head", json.dumps([stack.pixel_mm, stack.layer_mm, stack.shape]))
            for number, data in enumerate(layers):
                archive.writestr(str(number), data)
            archive.writestr("end", json.dumps(layers.findings))


class Forgetful(WriteRaw):
    """Takes the first layer only."""

    def store(self, target, stack, layers):
        target.write_bytes(next(iter(layers)))


@pytest.fixture
def stack(wang_tiling):
    return SliceField(resolution=7).run(PlainContext(), wang_tiling)


def write(writer, stack, folder, threads=2):
    context = PlainContext(directory=folder, threads=threads)
    writer.run(context, stack)
    return context


@pytest.mark.parametrize("threads", [1, 3])
def test_one_method_makes_a_folder_of_layers(stack, tmp_path, threads):
    context = write(WriteRaw(sheet=0), stack, tmp_path, threads)
    nx, ny, nz = stack.shape
    layers = np.concatenate([slab.copy() for _, slab in stack.slabs()])
    for number in range(nz):
        data = (tmp_path / f"layers/{number:05d}.raw").read_bytes()
        assert np.array_equal(np.frombuffer(data, np.uint8).reshape(ny, nx), layers[number, ::-1])
    manifest = json.loads((tmp_path / "layers/manifest.json").read_text())
    assert (manifest["first_file"], manifest["layers"]) == ("00000.raw", nz)
    assert "bits" not in manifest
    assert len(list((tmp_path / "layers").iterdir())) == nz + 1
    assert context.reported["bytes"] == nx * ny * nz
    assert context.progress_calls[-1][:2] == (nz, nz)


def test_a_container_holds_all_layers_and_what_is_known_at_the_end(stack, tmp_path):
    solid = write(WriteContainer(), stack, tmp_path).reported["solid_voxels"]
    assert solid > 0
    write(WriteRaw(), stack, tmp_path)
    with zipfile.ZipFile(tmp_path / "part.v1.zip") as archive:
        assert json.loads(archive.read("head")) == [list(stack.pixel_mm), stack.layer_mm, list(stack.shape)]
        for number in range(stack.shape[2]):
            assert archive.read(str(number)) == (tmp_path / f"layers/{number:05d}.raw").read_bytes()
        assert json.loads(archive.read("end"))["solid_voxels"] == solid
    assert (tmp_path / "part.v1-overview.png").read_bytes() == (tmp_path / "layers-overview.png").read_bytes()


@dataclass(frozen=True, kw_only=True)
class WriteBits(WriteRaw):
    """The same layers, where they are there as bits."""

    def takes_bits(self, stack):
        return not stack.gray

    def encode_bits(self, rows, stack):
        return unpack(rows[None], stack.shape[0], 255).tobytes()


class Sums:
    """Looks at some layers."""

    wanted = (2, 9)

    def __init__(self):
        self.seen = []

    def add(self, number, image):
        self.seen.append((number, image.shape, int(image[0].sum())))


@pytest.mark.parametrize("islands", ["keep", "remove"])
@pytest.mark.parametrize("gray", [1, 2])
def test_layers_of_bits_are_the_same_layers(wang_tiling, tmp_path, islands, gray, monkeypatch):
    seen = []
    monkeypatch.setattr(WriteRaw, "observer", lambda writer, stack: seen.append(Sums()) or seen[-1])
    files = []
    for number, writer in enumerate((WriteRaw, WriteBits)):
        stack = SliceField(resolution=7, gray=gray, islands=islands).run(PlainContext(), wang_tiling)
        context = write(writer(), stack, tmp_path / str(number))
        folder = context.directory
        files.append({file.name: file.read_bytes() for file in folder.rglob("*") if file.is_file()})
    assert files[0] == files[1]
    looked_at = [[entry for entry in sums.seen if entry[0] in Sums.wanted] for sums in seen]
    assert looked_at[0] == looked_at[1]
    assert [number for number, *_ in looked_at[0]] == [2, 9]


def test_a_writer_that_leaves_layers_out_is_found(stack, tmp_path):
    with pytest.raises(RuntimeError, match=r"write\.raw has taken 1 of 21 layers"):
        write(Forgetful(), stack, tmp_path)


STACK = """
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sppm_pipeline.method.slicing.slice_stack import SliceStack
from sppm_pipeline.stage import Context, Stage

@dataclass(frozen=True, eq=False)
class Layers(SliceStack):
    pixel_mm = (0.1, 0.1)
    layer_mm = 0.1
    shape = (4, 3, 5)
    origin_mm = (0.0, 0.0, 0.0)

    def read(self, threads):
        layer = np.full((2, 3, 4), 255, np.uint8)
        %s

@dataclass(frozen=True, kw_only=True)
class Sliced(Stage):
    '''Make layers.'''
    name: ClassVar[str] = "slice.own"

    def run(self, context: Context) -> SliceStack:
        return Layers()
"""
END = "yield 4, layer[:1]\n        return {}"


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (
            "yield 0, layer.astype(float)",
            r"layers as float64 of shape \(2, 3, 4\), expected uint8 of shape \(layers, 3, 4\)",
        ),
        ("yield 0, layer > 0", "layers as bool"),
        ("yield 0, layer.transpose(0, 2, 1)", r"uint8 of shape \(2, 4, 3\), expected .*`shape` is \(4, 3, 5\)"),
        ("yield 0, layer[0]", r"of shape \(3, 4\)"),
        ("yield 0, layer[:0]", r"of shape \(0, 3, 4\)"),
        ("yield layer", "delivers ndarray, expected"),
        ("yield 0, [layer]", "delivers tuple, expected"),
        ("yield 0, layer\n        yield 3, layer", "delivers layers 3 to 4 after 2 of 5"),
        ("yield 0, layer\n        yield 2, layer\n        yield 4, layer", "delivers layers 4 to 5 after 4 of 5"),
        ("yield 0, layer\n        return {}", "delivers 2 layers and announces 5"),
        (f"yield 0, layer\n        yield 2, layer\n        {END[:-10]}", "returns NoneType, expected a dict"),
        ("yield 0, layer\n        1 / 0", "raised ZeroDivisionError when it was read: division by zero"),
        ("return [(0, layer)]", "gives list, expected a generator"),
        (f"yield 0, layer\n        yield 2, layer\n        {END}", None),
    ],
)
def test_layers_of_plugins_are_checked_while_they_are_read(tmp_path, body, words):
    plugin, file = tmp_path / "own_layers.py", tmp_path / "config.yaml"
    plugin.write_text(STACK % body, encoding="utf-8")
    file.write_text("sppm: 1\npipeline:\n  - {stage: slice.own, id: mine}\n  - write.png\n", encoding="utf-8")
    plan = open_session(RunRequest(str(file), plugins=(str(plugin),), distributions=False)).plan()
    if words is None:
        assert run_plan(plan, tmp_path / "out", threads=1)["status"] == "done"
        return
    with pytest.raises(PluginError, match=words) as caught:
        run_plan(plan, tmp_path / "out", threads=1)
    assert caught.value.stage == "mine"
    assert caught.value.where.line == 3
    assert "own_layers.py" in caught.value.message
    assert "made a Layers" in caught.value.message
