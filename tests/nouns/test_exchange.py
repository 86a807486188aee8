"""Artifacts from arrays and back."""

import numpy as np
import pytest
import trimesh

import sppm_pipeline as sppm


def test_voxels():
    array = np.zeros((2, 3, 4), bool)
    array[1, 2, 3] = True
    voxels = sppm.Voxels.from_array(array, spacing=0.05)
    assert voxels.to_array()[1, 2, 3] == 1
    assert voxels.physical
    assert voxels.spacing == (0.05,) * 3
    turned = sppm.Voxels.from_array(array.transpose(2, 1, 0), axes="zyx", spacing=0.05)
    assert turned.digest() == voxels.digest()
    assert np.array_equal(turned.to_array("zyx"), array.transpose(2, 1, 0))
    assert sppm.Voxels.from_array(array).spacing == (0.25,) * 3
    assert sppm.Voxels.from_array(array * 0.5).fractions
    for wrong in (np.zeros((2, 2)), np.full((2, 2, 2), 300), np.full((2, 2, 2), -1), np.full((2, 2, 2), 1.5)):
        with pytest.raises(ValueError, match=r"axes|phases|fractions"):
            sppm.Voxels.from_array(wrong)


def test_meshes(wedge):
    theirs = wedge.to_trimesh()
    assert theirs.volume == pytest.approx(wedge.summary()["volume_mm3"])
    ours = sppm.SurfaceMesh.from_trimesh(trimesh.creation.box((1, 2, 3)), "box")
    assert ours.summary()["volume_mm3"] == pytest.approx(6)
    with pytest.raises(ValueError, match="does not exist"):
        sppm.SurfaceMesh.from_arrays(wedge.vertices, wedge.faces + 1)
    tet = sppm.VolumeMesh.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 1, 2, 3]])
    assert tet.volume == pytest.approx(1 / 6)


def test_pores_and_tunnels():
    pores = sppm.PoreSet.from_array([[0.1, 0.5, 0.5], [0.9, 0.5, 0.5]], edge="7.5 mm")
    assert pores.cell == sppm.Cell(7.5, physical=True)
    graph = sppm.TunnelGraph.from_arrays(pores, [[0, 1]])
    assert graph.shift.tolist() == [[-1, 0, 0]]  # through the face of the cell
    assert graph.summary()["mean_tunnel_length"] == pytest.approx(0.2)
    with pytest.raises(ValueError, match="does not exist"):
        sppm.TunnelGraph.from_arrays(pores, [[0, 2]])


def test_layers_and_tables():
    layers = np.zeros((3, 4, 5), bool)
    layers[1] = True
    stack = sppm.SliceStack.from_array(layers, pixel_mm=0.1, layer_mm=0.05)
    assert np.array_equal(stack.to_array(), layers * np.uint8(255))
    reading = stack.slabs()
    assert len(list(reading)) == 3
    assert reading.findings["solid_volume_mm3"] == pytest.approx(20 * 0.1**2 * 0.05)
    assert stack.pixel_mm == (0.1, 0.1)
    oblong = sppm.SliceStack.from_array(layers, pixel_mm=(0.1, 0.2), layer_mm=0.05)
    assert (oblong.pixel_mm, oblong.layer_mm) == ((0.1, 0.2), 0.05)
    assert oblong.summary()["pixel_mm"] == [0.1, 0.2]
    reading = oblong.slabs()
    assert len(list(reading)) == 3
    assert reading.findings["solid_volume_mm3"] == pytest.approx(20 * 0.1 * 0.2 * 0.05)
    with pytest.raises(ValueError, match="255"):
        sppm.SliceStack.from_array(np.full((1, 1, 1), 256), pixel_mm=1)
    with pytest.raises(ValueError, match="layer_mm"):
        sppm.SliceStack.from_array(layers, pixel_mm=(0.1, 0.2))
    for wrong in ({"pixel_mm": 0.0}, {"pixel_mm": (0.1, -0.1), "layer_mm": 1}, {"pixel_mm": 0.1, "layer_mm": 0.0}):
        with pytest.raises(ValueError, match="can't be printed"):
            sppm.SliceStack.from_array(layers, **wrong)
    table = sppm.Table.from_arrays({"a": np.arange(3), "b": ["x", "y", "z"]})
    assert table.to_arrays()["a"].tolist() == [0, 1, 2]
    assert table.to_arrays()["b"].tolist() == ["x", "y", "z"]


def test_a_library_that_is_not_there_is_named(wedge, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pyvista", None)
    with pytest.raises(sppm.ResourceError, match="pip install pyvista"):
        wedge.to_pyvista()
