"""What all tilers have in common: shapes, types and the presence of faces."""

from __future__ import annotations

import numpy as np
import pytest

from sppm_pipeline.method.tiling.corners import tile_corners
from sppm_pipeline.method.tiling.hashed import tile_hashed
from sppm_pipeline.method.tiling.lattice import face_presence, tile_fresh
from sppm_pipeline.method.tiling.wang import tile_wang


@pytest.mark.parametrize("periodic", [False, True])
def test_all_tilers_return_contiguous_int32_of_the_agreed_shapes(periodic):
    mask = np.random.default_rng(0).random((5, 4, 6)) < 0.6
    for interior, faces in (
        tile_wang(mask, 1, periodic=periodic),
        tile_hashed(mask, 1, 4, 3, periodic=periodic),
        tile_corners(mask, 1, 2, periodic=periodic),
        tile_fresh(mask, periodic=periodic),
    ):
        arrays = (interior, *faces)
        assert [a.shape for a in arrays] == [(5, 4, 6), (6, 4, 6), (5, 5, 6), (5, 4, 7)]
        assert all(a.dtype == np.int32 and a.flags.c_contiguous for a in arrays)


def test_faces_are_where_a_cell_is_on_either_side():
    mask = np.zeros((3, 1, 1), bool)
    mask[2] = True
    assert face_presence(mask)[0].ravel().tolist() == [False, False, True, True]
    assert face_presence(mask, periodic=True)[0].ravel().tolist() == [True, False, True, True]
    assert face_presence(mask)[1].tolist() == [[[False], [False]], [[False], [False]], [[True], [True]]]
