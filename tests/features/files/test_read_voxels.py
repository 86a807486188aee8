"""``read.voxels``, ``extract.voxels`` and the writers, from file to file."""

import numpy as np
import pytest
from PIL import Image

from sppm_pipeline.errors import ConfigError, InputError
from sppm_pipeline.features.files.stages.read_voxels import ReadVoxels
from sppm_pipeline.features.files.stages.write_voxels import WriteVoxels
from sppm_pipeline.method.nouns.voxels import Voxels
from sppm_pipeline.method.stages.extract_voxels import ExtractVoxels
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.grid import cell_centers
from sppm_pipeline.testing.plain_context import PlainContext


@pytest.fixture
def save(tmp_path):
    def save(values):
        np.save(tmp_path / "a.npy", values)
        return tmp_path / "a.npy"

    return save


def read(path, **options):
    context = PlainContext()
    return ReadVoxels(path=path, **options).run(context), context


def test_two_values_are_void_and_solid(save):
    values = np.zeros((2, 3, 4))
    values[0] = 255
    made, _ = read(save(values))
    assert (made.values == (values > 0)).all()
    assert made.spacing == (0.5, 0.5, 0.5)
    assert not made.physical
    assert made.periodic == (False,) * 3
    assert (read(save(values), invert=True)[0].values == (values == 0)).all()


def test_mirror_images_make_a_cell_of_a_scan(save):
    values = np.arange(24).reshape(2, 3, 4) % 2
    made, _ = read(save(values), mirror=True)
    assert made.periodic == (True,) * 3
    assert made.shape == (4, 6, 8)
    assert (made.values[:2, :3, :4] == values).all()
    assert (made.values[2:, 3:, 4:] == values[::-1, ::-1, ::-1]).all()
    with pytest.raises(ConfigError, match="`mirror`"):
        ReadVoxels(path=save(values), mirror=True, periodic=True).check_options()


def test_phases_keep_their_numbers(save):
    values = np.arange(24).reshape(2, 3, 4) % 3
    assert (read(save(values))[0].values == values).all()
    with pytest.raises(ConfigError, match="invert"):
        read(save(values), invert=True)


def test_gray_needs_a_decision(save):
    values = np.random.default_rng(0).random((5, 5, 5))
    with pytest.raises(InputError, match="gray image") as caught:
        read(save(values))
    assert "otsu" in caught.value.hint
    made, context = read(save(values), values="threshold", threshold=0.25)
    assert (made.values == (values >= 0.25)).all()
    assert context.reported["threshold"] == 0.25
    assert (read(save(values), values="fractions")[0].values == values.astype(np.float32)).all()
    inverted = read(save(values), values="fractions", invert=True)[0].values
    assert np.allclose(inverted, 1 - values, atol=1e-6)
    with pytest.raises(InputError, match="0 to 1"):
        read(save(values + 1), values="fractions")


def test_otsu_tells_what_it_chose(save):
    values = np.where(np.indices((6, 6, 6)).sum(0) % 2, 200, 40) + np.random.default_rng(0).integers(0, 20, (6,) * 3)
    made, context = read(save(values), values="otsu")
    assert (made.values == (values > 100)).all()
    assert 60 < context.reported["threshold"] < 200
    with pytest.raises(InputError, match="one value"):
        read(save(np.full((2, 2, 2), 7)), values="otsu")


def test_fractions_over_the_range_of_an_integer(save):
    made, _ = read(save(np.array([[[0, 51, 255]]], np.uint8)), values="fractions")
    assert made.values.ravel() == pytest.approx([0, 0.2, 1])


def test_spacing_and_axes(save):
    values = np.zeros((2, 3, 4), bool)
    values[1, 2, 3] = True
    made, _ = read(save(values), voxel=Length(0.02, "mm"), axes="zyx", periodic=True)
    assert made.shape == (4, 3, 2)
    assert made.values[3, 2, 1]
    assert made.spacing == (0.02,) * 3
    assert made.physical
    assert made.periodic == (True,) * 3


def test_all_void_is_said(save):
    made, context = read(save(np.zeros((2, 2, 2))))
    assert not made.values.any()
    assert "void" in context.warnings[0]
    assert "solid" in read(save(np.ones((2, 2, 2))))[1].warnings[0]


def test_what_cannot_be_read(tmp_path, save):
    with pytest.raises(InputError, match="cannot read"):
        read(tmp_path / "none.npy")
    (tmp_path / "a.raw").write_bytes(b"x")
    with pytest.raises(InputError, match="raw"):
        read(tmp_path / "a.raw")
    (tmp_path / "a.vti").write_bytes(b"x")
    with pytest.raises(InputError, match=r"a\.vti: this is no well-formed XML"):
        read(tmp_path / "a.vti")
    with pytest.raises(InputError, match="not finite"):
        read(save(np.full((2, 2, 2), np.nan)))
    with pytest.raises(ConfigError, match="belong together"):
        ReadVoxels(path=tmp_path, threshold=1.0).check_options()
    with pytest.raises(InputError, match="2 different values from -1 to 3"):
        read(save(np.array([[[-1, 3]]])), values="phases")


def test_a_stack_of_pictures(tmp_path):
    for k in range(3):
        Image.fromarray(np.array([[0, 255]], np.uint8)).save(tmp_path / f"{k}.png")
    made, _ = read(tmp_path)
    assert made.values[:, 0].tolist() == [[0, 0, 0], [1, 1, 1]]


@pytest.mark.parametrize("name", ["v.npy", "v.tiff", "v.tif", "v.nrrd"])
def test_a_cell_goes_out_and_comes_back(cell, tmp_path, name):
    context = PlainContext(directory=tmp_path)
    voxels = ExtractVoxels(resolution=20).run(context, cell)
    assert (voxels.values == cell.solid(cell_centers(20))).all()
    assert voxels.periodic == (True,) * 3
    WriteVoxels(path=name).run(context, voxels)
    back, _ = read(tmp_path / name)
    assert (back.values == voxels.values).all()
    fractions = Voxels(np.linspace(0, 1, 24, dtype=np.float32).reshape(2, 3, 4), (1, 2, 3), True, (True,) * 3)
    WriteVoxels(path=name).run(context, fractions)
    back, _ = read(tmp_path / name, values="fractions")
    assert (back.values == fractions.values).all()
    if name != "v.npy":
        assert (back.physical, back.spacing) == (True, pytest.approx((1, 2, 3)))
        assert read(tmp_path / name, values="fractions", voxel=Length(5, "mm"))[0].spacing == (5, 5, 5)


def test_layers_of_a_part_and_its_image_agree(wang_tiling):
    made = ExtractVoxels(resolution=8).run(PlainContext(), wang_tiling)
    assert made.shape == tuple(8 * n for n in wang_tiling.cells)
    assert made.physical
