"""PNG layers as Pillow reads them."""

import json

import numpy as np
import pytest
from PIL import Image

from sppm_pipeline.errors import ConfigError
from sppm_pipeline.method.stages.slice_field import SliceField
from sppm_pipeline.method.stages.write_png import WritePng
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.testing.plain_context import PlainContext


def written(field, tmp_path, threads=1, slice_options=None, **options):
    context = PlainContext(directory=tmp_path, threads=threads)
    stack = SliceField(**(slice_options or {"resolution": 7})).run(context, field)
    stage = WritePng(**options)
    stage.check_options()
    stage.run(context, stack)
    return stack, context.reported


def files(folder):
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


@pytest.mark.parametrize("bits", [None, 1, 8])
def test_files_are_the_layers_upside_up(wang_tiling, tmp_path, bits):
    stack, told = written(wang_tiling, tmp_path, bits=bits, sheet=0)
    found = np.concatenate([slab.copy() for _, slab in stack.slabs()])
    names = sorted(p.name for p in (tmp_path / "slices").glob("*.png"))
    assert names == [f"{k:05d}.png" for k in range(21)]
    for k, name in enumerate(names):
        with Image.open(tmp_path / "slices" / name) as image:
            assert image.mode == ("L" if bits == 8 else "1")
            assert image.info["dpi"][0] == pytest.approx(25.4 / stack.pixel_mm[0], rel=2e-3)
            assert np.array_equal(np.asarray(image.convert("L")), found[k, ::-1])
    assert told["layers"] == 21
    assert told["bytes"] == sum((tmp_path / "slices" / n).stat().st_size for n in names)
    assert not (tmp_path / "slices-overview.png").exists()


def test_the_manifest_says_what_a_printer_needs(wang_tiling, tmp_path):
    stack, told = written(wang_tiling, tmp_path, path="out/layers")
    manifest = json.loads((tmp_path / "out/layers/manifest.json").read_text())
    assert (manifest["width_px"], manifest["height_px"], manifest["layers"]) == (28, 21, 21)
    assert manifest["pixel_mm"] == pytest.approx([4 / 7, 4 / 7])
    assert manifest["layer_mm"] == pytest.approx(4 / 7)
    assert manifest["origin_mm"] == [0, 0, 0]
    assert manifest["bits"] == 1
    solid = sum(int((slab > 0).sum()) for _, slab in stack.slabs())
    assert manifest["solid_voxels"] == solid == told["solid_voxels"]
    assert manifest["removed_share"] == told["removed_share"]
    with Image.open(tmp_path / "out/layers-overview.png") as sheet:
        assert sheet.size[0] > 28


def test_gray_layers_take_eight_bits(wang_tiling, tmp_path):
    how = {"pixel": Length(1, "mm"), "gray": 3}
    stack, _ = written(wang_tiling, tmp_path, slice_options=how)
    found = np.concatenate([slab.copy() for _, slab in stack.slabs()])
    with Image.open(tmp_path / "slices/00002.png") as image:
        assert image.mode == "L"
        assert np.array_equal(np.asarray(image), found[2, ::-1])
    with pytest.raises(ConfigError, match="gray"):
        written(wang_tiling, tmp_path / "again", slice_options=how, bits=1)


def test_threads_change_no_byte(wang_tiling, tmp_path):
    for threads in (1, 2):
        written(wang_tiling, tmp_path / str(threads), threads)
    assert files(tmp_path / "1") == files(tmp_path / "2")


def test_bits():
    with pytest.raises(ConfigError, match="1 or 8"):
        WritePng(bits=4).check_options()
