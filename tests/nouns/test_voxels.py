"""Images as periodic cells: faces that fit, mirror images, solid that voxels resolve."""

import numpy as np
import pytest

from sppm_pipeline.method.nouns.voxels import Voxels


def waves(n, shift=0.0):
    x = (np.arange(n) + 0.5) / n
    turn = 2 * np.pi * (1 + shift) * x
    return np.cos(turn)[:, None, None] + np.cos(turn)[:, None] + np.cos(turn) > 0


def test_an_array_is_no_cell_by_default():
    assert Voxels.from_array(waves(8)).periodic == (False,) * 3
    assert Voxels.from_array(waves(8), periodic=True).periodic == (True,) * 3


@pytest.mark.parametrize("kind", [np.uint8, np.float32])
def test_faces_of_a_cell_fit(kind):
    assert max(Voxels.from_array(waves(20).astype(kind)).face_mismatch()) <= 1
    assert min(Voxels.from_array(waves(20, 0.3).astype(kind)).face_mismatch()) > 1.5
    plates = np.zeros((6, 5, 4), kind)
    plates[:, :, :2] = 1
    assert Voxels.from_array(plates).face_mismatch() == (0, 0, 1)
    assert Voxels.from_array(plates[:1, :1, :1]).face_mismatch() == (0, 0, 0)


def test_mirror_images_make_a_cell():
    made = Voxels.from_array(waves(20, 0.3), spacing=(1.0, 2.0, 3.0)).mirrored()
    assert made.shape == (40, 40, 40)
    assert made.periodic == (True,) * 3
    assert made.spacing == (1.0, 2.0, 3.0)
    assert made.face_mismatch() == (0, 0, 0)
    assert np.array_equal(made.values[20:, 20:, 20:], made.values[19::-1, 19::-1, 19::-1])


def test_solid_thinner_than_three_voxels():
    for width, share in ((1, 1), (2, 1), (3, 0), (4, 0)):
        plate = np.zeros((8, 8, 8), bool)
        plate[:, :, 6 - width : 6] = True
        image = Voxels.from_array(plate, periodic=True)
        assert image.thin_share() == share
        assert any("thinner than 3 voxels" in doubt for doubt in image.doubts()) == bool(share)
        assert Voxels.from_array(~plate, periodic=True).thin_share(void=True) == share
    assert Voxels.from_array(np.zeros((4, 4, 4), bool)).thin_share() == 0
    assert Voxels.from_array(np.ones((2, 2, 2), bool), periodic=True).thin_share() == 0


def test_blocks_of_eight_voxels():
    values = np.zeros((4, 2, 2), np.uint8)
    values[:2] = 2
    values[2, 0, 0] = 1
    made = Voxels.from_array(values, spacing=0.5).coarsened()
    assert made.values.ravel().tolist() == [2, 0]
    assert made.spacing == (1.0,) * 3
    assert Voxels.from_array(values / 2).coarsened().values.ravel().tolist() == [1, 0.0625]
    with pytest.raises(ValueError, match="no coarser one"):
        Voxels.from_array(np.ones((3, 2, 2))).coarsened()
