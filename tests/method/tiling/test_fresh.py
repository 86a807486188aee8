"""Content of its own for every cell and face."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from sppm_pipeline.method.tiling.lattice import tile_fresh
from sppm_pipeline.method.tiling.statistics import face_violations

masks = hnp.arrays(np.bool_, hnp.array_shapes(min_dims=3, max_dims=3, min_side=1, max_side=6))


@settings(deadline=None, derandomize=True, max_examples=60)
@given(masks, st.booleans())
def test_numbers_are_consecutive_and_used_once(mask, periodic):
    interior, faces = tile_fresh(mask, periodic=periodic)
    assert np.array_equal(interior >= 0, mask)
    assert sorted(interior[mask].tolist()) == list(range(np.count_nonzero(mask)))
    assert not face_violations(interior, faces, periodic=periodic).any()
    for axis in range(3):
        planes = np.delete(faces[axis], -1, axis) if periodic else faces[axis]
        numbers = planes[planes >= 0]
        assert sorted(numbers.tolist()) == list(range(numbers.size))


def test_raster_order_has_x_fastest():
    interior, _ = tile_fresh(np.ones((3, 2, 2), bool))
    assert interior[:, 0, 0].tolist() == [0, 1, 2]
    assert interior[0, 1, 0] == 3
    assert interior[0, 0, 1] == 6
