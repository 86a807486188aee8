"""Sizes that are told ahead of time, against what is made."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from sppm_pipeline.features.surface.field_surface import FieldSurface
from sppm_pipeline.method.part.part import node_grid
from sppm_pipeline.nouns.palette import Palette
from sppm_pipeline.nouns.size import Geometry, Size
from sppm_pipeline.services.grid import cell_centers
from sppm_pipeline.services.mesh.measures import surface_area, volume
from sppm_pipeline.testing.plain_context import PlainContext

RESOLUTION = 32


@pytest.fixture(scope="module")
def cell_and_size(recipe):
    """A cell and the size that its stages tell."""
    made, size = recipe(), None
    for step in made._steps:
        size = step.stage.estimate(Palette(), size)
    return made.run(PlainContext(3)), size


def test_counts_of_a_cell(cell_and_size):
    cell, size = cell_and_size
    assert size.cell.pores == pytest.approx(len(cell.graph.pores.centers), rel=0.05)
    assert size.cell.tunnels == pytest.approx(len(cell.graph.edges), rel=0.35)


def test_geometry_of_a_cell(cell_and_size):
    cell, size = cell_and_size
    porosity = 1 - cell.solid(cell_centers(RESOLUTION, cell.cells)).mean()
    assert size.body.porosity == pytest.approx(porosity, rel=0.35)
    at = size.at_porosity(porosity)
    assert at.body.porosity == pytest.approx(porosity)
    faces = FieldSurface(cell, node_grid(cell, RESOLUTION)).mesh()[1]
    assert at.body.triangles(RESOLUTION) == pytest.approx(len(faces), rel=0.35)


def test_a_body_in_another_unit():
    porous = Geometry(edge_mm=4.0, box=(2.0, 3.0, 1.0), volume=6.0, envelope=22.0, porosity=0.5, surface=5.0)
    solid = porous.in_unit(1.0)
    assert (solid.box, solid.volume) == ((8.0, 12.0, 4.0), pytest.approx(6 * 64 * 0.5))
    assert solid.envelope == pytest.approx(16 * (5 * 6 + 11))
    again = solid.in_unit(4.0)
    assert (again.box, again.porosity) == (porous.box, 0.0)


def test_outlines_of_a_ball():
    """``pi / 4`` of the area is the length of all outlines times the distance of layers."""
    r, pixel = 5.0, 0.1
    ball = Geometry(edge_mm=1.0, box=(10.0,) * 3, volume=4 / 3 * math.pi * r**3, envelope=4 * math.pi * r**2)
    heights = np.arange(-r + pixel / 2, r, pixel)
    lengths = 2 * math.pi * np.sqrt(r**2 - heights**2)
    assert ball.outline(pixel, pixel) == pytest.approx(lengths.sum() / pixel, rel=0.01)


def test_no_more_outline_than_pairs_that_can_differ():
    dense = Geometry(volume=1.0, porosity=0.5, surface=1000.0)
    assert dense.outline(0.1, 0.1) == pytest.approx(1000 * 0.5, rel=1e-6)


def test_patches_are_evaluated_once():
    lone = Geometry(kernels=10.0)
    tiled = Geometry(kernels=10.0, volume=1000.0, box=(10.0,) * 3, patches=8.0, reach=0.2)
    assert lone.sums(32**3, 32) == 10 * 32**3
    assert tiled.sums(tiled.samples(32), 32) == 10 * 8 * 32**3
    assert tiled.sums(tiled.samples(32), 32, commensurate=False) == 10 * 1000 * 32**3
    assert tiled.sums(tiled.samples(512), 512) == 10 * 1000 * 512**3


def test_fine_grids_are_summed_on_a_coarse_one():
    fresh = Geometry(kernels=10.0, volume=1000.0, box=(10.0,) * 3, coarse=64.0)
    assert fresh.sums(fresh.samples(128), 128) == 10 * 1000 * 64**3
    assert fresh.sums(fresh.samples(80), 80) == 10 * 1000 * 80**3
    tiled = replace(fresh, patches=8.0, reach=0.2)
    assert tiled.sums(tiled.samples(80.5), 80.5, commensurate=False) == 10 * 8 * 64**3
    assert tiled.sums(tiled.samples(32), 32) == 10 * 8 * 32**3


def test_what_is_unknown_is_an_error():
    with pytest.raises(LookupError):
        _ = Size().body
    with pytest.raises(LookupError):
        _ = Size().cell


@pytest.mark.parametrize("shape", ["box", "ball", "cylinder", "torus", "torus_knot"])
@pytest.mark.parametrize("facets", [8, 40, 200])
def test_primitives(shape, facets):
    from sppm_pipeline.method.stages.read_primitive import ReadPrimitive
    from sppm_pipeline.nouns.length import Length

    stage = ReadPrimitive(shape=shape, size=(Length(8), Length(6), Length(5)), facets=facets)
    size, made = stage.estimate(Palette()), stage.run(PlainContext(1))
    assert size.triangles == pytest.approx(len(made.faces), rel=0.1)
    assert size.body.volume == pytest.approx(volume(made.vertices, made.faces), rel=0.1)
    assert size.body.envelope == pytest.approx(surface_area(made.vertices, made.faces), rel=0.1)


@pytest.mark.parametrize("extension", ["stl", "ply", "off", "obj", "glb", "3mf"])
def test_mesh_files(tmp_path, extension, ball):
    """Numbers are in the header or follow from the length; of an STL some triangles tell the box."""
    from sppm_pipeline.features.files.formats.detect import FORMATS
    from sppm_pipeline.features.files.stages.read_mesh import ReadMesh
    from sppm_pipeline.nouns.length import Length

    path = tmp_path / f"ball.{extension}"
    path.write_bytes(b"".join(FORMATS[extension].encode(ball.vertices, ball.faces)))
    size = ReadMesh(path=path).estimate(Palette())
    assert size.triangles == pytest.approx(len(ball.faces), rel=0.7)
    if extension == "stl":
        assert size.body.box == pytest.approx((10, 10, 10), rel=0.01)
        assert size.body.volume == pytest.approx(volume(ball.vertices, ball.faces), rel=0.5)
    else:
        assert size.geometry is None
    assert ReadMesh(path=path, height=Length(2, "cm")).estimate(Palette()).body.box[2] == pytest.approx(20)
