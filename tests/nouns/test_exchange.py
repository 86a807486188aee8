"""Artifacts from arrays and back."""

import numpy as np
import pytest
import trimesh

import sppm_pipeline as sppm


def test_voxels():
    array = np.zeros((2, 3, 4), bool)
    array[1, 2, 3] = True
    voxels = sppm.Voxels.from_array(array, spacing=0.05)
    assert voxels.to_numpy()[1, 2, 3] == 1
    assert voxels.physical
    assert voxels.spacing == (0.05,) * 3
    turned = sppm.Voxels.from_array(array.transpose(2, 1, 0), axes="zyx", spacing=0.05)
    assert turned.digest() == voxels.digest()
    assert np.array_equal(turned.to_numpy("zyx"), array.transpose(2, 1, 0))
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


def test_pores_and_tunnels():
    placed = [[0.75, 3.75, 3.75], [6.75, 3.75, 3.75]]  # mm
    pores = sppm.PoreSet.from_array(placed, edge="7.5 mm")
    assert pores.cell == sppm.Cell(7.5, physical=True)
    np.testing.assert_allclose(pores.centers, [[0.1, 0.5, 0.5], [0.9, 0.5, 0.5]])
    np.testing.assert_allclose(pores.to_numpy(), placed)
    np.testing.assert_allclose(pores.centers_mm, placed)
    with pytest.raises(ValueError, match=r"from 0 to 5 mm, got 0\.75 to 6\.75 mm"):
        sppm.PoreSet.from_array(placed, edge="5 mm")
    bare = sppm.PoreSet.from_array([[0.1, 0.5, 0.5]])
    assert bare.to_numpy().tolist() == [[0.1, 0.5, 0.5]]
    with pytest.raises(sppm.DesignError, match="no physical size"):
        _ = bare.centers_mm
    graph = sppm.TunnelGraph.from_arrays(pores, [[0, 1]])
    assert graph.shift.tolist() == [[-1, 0, 0]]  # through the face of the cell
    assert graph.summary()["mean_tunnel_length"] == pytest.approx(0.2)
    exported = graph.to_networkx()
    assert exported.nodes[1] == {"x": pytest.approx(6.75), "y": 3.75, "z": 3.75, "piece": 0}
    assert [*exported.edges(data=True)] == [(0, 1, {"length": pytest.approx(1.5), "shift": "-1 0 0"})]
    with pytest.raises(ValueError, match="does not exist"):
        sppm.TunnelGraph.from_arrays(pores, [[0, 2]])


def test_layers_and_tables():
    layers = np.zeros((3, 4, 5), bool)
    layers[1] = True
    stack = sppm.SliceStack.from_array(layers, pixel_mm=0.1, layer_mm=0.05)
    assert np.array_equal(stack.to_numpy(), layers * np.uint8(255))
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
    with pytest.raises(sppm.errors.ResourceError, match="pip install pyvista"):
        wedge.to_pyvista()


@pytest.fixture(scope="module")
def cell():
    pores = sppm.PoreSet.from_array([[1, 1, 1], [3, 1, 1]], edge="4 mm")
    graph = sppm.TunnelGraph.from_arrays(pores, [[0, 1]])
    return sppm.field.gaussian(pore_radius="0.9 mm", tunnel_radius="0.5 mm")(graph)


def test_cells_as_arrays_voxels_meshes_and_pictures(cell):
    solid = cell.to_numpy(16)
    assert (solid.dtype, solid.shape) == (bool, (16, 16, 16))
    assert np.array_equal(solid, cell.sample(16) < 0)
    assert not solid[4, 4, 4]  # the first pore
    assert solid[8, 12, 12]
    voxels = cell.voxels(16)
    assert np.array_equal(voxels.to_numpy(), solid)
    assert voxels.spacing == (0.25,) * 3
    mesh = cell.mesh(24)
    assert mesh.vertices.max() <= 4 + 1e-9
    assert mesh.digest() == sppm.extract.marching_cubes(resolution=24)(cell).digest()
    np.testing.assert_allclose(cell.centers_mm, [[1, 1, 1], [3, 1, 1]])


def test_sections_are_drawn_to_scale(cell):
    pyplot = pytest.importorskip("matplotlib.pyplot")
    figure, ax = pyplot.subplots()
    assert cell.plot("x", 0.25, resolution=32, ax=ax) is ax
    (image,) = ax.images
    assert image.get_extent() == [0, 4, 0, 4]
    assert ax.get_xlabel() == "y (mm)"
    shown = image.get_array()
    # rows are z and columns y, from below: the pore is at y = z = 1 mm
    assert shown[8, 8] == 0
    assert shown[24, 24] == 1
    assert np.array_equal(shown, cell.to_numpy(32)[8].T)
    pyplot.close(figure)
    with pytest.raises(sppm.ConfigError, match="perpendicular to x, y or z"):
        cell.plot("w")


def test_what_is_not_installed_is_said(cell, monkeypatch):
    import sys

    for name in ("pandas", "xarray", "pyvista"):
        monkeypatch.setitem(sys.modules, name, None)
    table = sppm.Table.from_arrays({"a": [1, 2]})
    for call, name in ((table.to_pandas, "pandas"), (table.to_xarray, "xarray"), (cell.to_pyvista, "pyvista")):
        words = f"needs {name}, which is not installed(.|\n)*pip install {name}"
        with pytest.raises(sppm.errors.ResourceError, match=words):
            call()
