"""Slice stacks, read back by lib3mf and filled again: every pixel, every height."""

from __future__ import annotations

import lib3mf
import numpy as np
import pytest
from sppm_lib3mf.slices import WriteSlices

from sppm_pipeline import SliceStack
from sppm_pipeline.numerics import outlines
from sppm_pipeline.testing.plain_context import PlainContext


def filled(rings, shape):
    """Pixels (ny, nx) by the winding number: each side along y turns all pixels to its right."""
    winding = np.zeros((shape[0], shape[1] + 1), int)
    for ring in rings:
        for (x, y), (u, v) in zip(ring, np.roll(ring, -1, axis=0), strict=True):
            assert (x == u) != (y == v)  # along one axis, and not a point
            winding[min(y, v) : max(y, v), x:] += 1 if v < y else -1
    assert set(np.unique(winding)) <= {0, 1}
    return winding[:, :-1] > 0


def area(ring):
    x, y = ring[:, 0].astype(int), ring[:, 1].astype(int)
    return (x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2


@pytest.mark.parametrize("share", [0.05, 0.3, 0.5, 0.7, 0.95])
@pytest.mark.parametrize("seed", range(6))
def test_outlines_hold_the_solid_pixels(share, seed):
    rng = np.random.default_rng(seed)
    solid = rng.random((23, 31)) < share
    rings = outlines(solid)
    assert np.array_equal(filled(rings, solid.shape), solid)
    assert sum(area(ring) for ring in rings) == solid.sum()


def test_pixels_that_meet_at_a_corner_are_apart():
    for solid in (np.eye(2, dtype=bool), np.eye(2, dtype=bool)[::-1]):
        assert sorted(area(ring) for ring in outlines(solid)) == [1, 1]
        assert sorted(area(ring) for ring in outlines(np.pad(~solid, 1, constant_values=True))) == [-2, 16]
    assert outlines(np.zeros((3, 4), bool)) == []
    (one,) = outlines(np.ones((3, 4), bool))
    assert one.tolist() == [[0, 0], [4, 0], [4, 3], [0, 3]]


@pytest.mark.parametrize("gray", [False, True])
def test_lib3mf_reads_what_was_written(gray, tmp_path):
    rng = np.random.default_rng(4)
    layers = rng.integers(0, 256, (5, 20, 30)).astype(np.uint8) if gray else rng.random((5, 20, 30)) < 0.5
    layers[2] = 0
    stack = SliceStack.from_array(layers, pixel_mm=(0.1, 0.25), layer_mm=0.05)
    kept = []
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
        WriteSlices(sheet=0).run(PlainContext(directory=tmp_path / folder, threads=2), stack)
        kept.append((tmp_path / folder / "part.3mf").read_bytes())
    assert kept[0] == kept[1]
    model = lib3mf.get_wrapper().CreateModel()
    reader = model.QueryReader("3mf")
    reader.ReadFromFile(str(tmp_path / "one/part.3mf"))
    assert reader.GetWarningCount() == 0
    objects = model.GetMeshObjects()
    assert objects.MoveNext()
    mesh = objects.GetCurrentMeshObject()
    assert mesh.HasSlices(False)
    slices = mesh.GetSliceStack()
    assert (slices.GetBottomZ(), slices.GetSliceCount()) == (0, 5)
    for number, layer in enumerate(layers):
        one = slices.GetSlice(number)
        assert one.GetZTop() == pytest.approx(0.05 * (number + 1))
        places = np.array([list(v.Coordinates) for v in one.GetVertices()]).reshape(-1, 2) / (0.1, 0.25)
        corners = np.rint(places).astype(int)
        assert np.allclose(places, corners, atol=1e-3)
        rings = []
        for index in range(one.GetPolygonCount()):
            polygon = list(one.GetPolygonIndices(index))
            assert polygon[0] == polygon[-1]
            rings.append(corners[polygon[:-1]])
        assert np.array_equal(filled(rings, layer.shape), layer >= 128 if gray else layer)
