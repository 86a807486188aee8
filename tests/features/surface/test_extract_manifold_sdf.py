"""manifold3d's extractor against marching cubes, on the same fields."""

from __future__ import annotations

import pytest

from sppm_pipeline.engine.process import budget
from sppm_pipeline.errors import ConfigError, DesignError, InputError, ResourceError
from sppm_pipeline.features.surface.stages.extract_manifold_sdf import ManifoldSdf
from sppm_pipeline.features.surface.stages.extract_marching_cubes import MarchingCubes
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.method.part.primitive_meshes import box_mesh
from sppm_pipeline.method.stages.tile_periodic import PeriodicTiling
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.mesh.measures import measure_surface, volume
from sppm_pipeline.testing.contracts import StageContract
from sppm_pipeline.testing.plain_context import PlainContext


def mesh(field, cls=ManifoldSdf, **options):
    context = PlainContext()
    made = cls(**{"resolution": 24, **options}).run(context, field)
    made.check()
    return made, measure_surface(made.vertices, made.faces), context.reported


def test_a_cell_is_as_marching_cubes_has_it(cell):
    made, found, told = mesh(cell, resolution=64)
    _, other, _ = mesh(cell, MarchingCubes, resolution=64)
    assert found.edges.closed
    assert (found.genus, found.components) == (other.genus, other.components)
    assert found.volume == pytest.approx(other.volume, rel=0.01)
    assert made.vertices.min() == 0.0
    assert made.vertices.max() == 1.0
    assert told["status"] == "NoError"
    assert told["samples"] == 65**3 + 66**3


@pytest.mark.parametrize("skin", [0.0, 0.9])
def test_a_part_keeps_the_surface_and_edges_of_its_domain(wang_tiling, skin):
    domain = SurfaceMesh(*box_mesh((8.0, 6.0, 6.0), (6.2, 5.5, 5.1)), "box")
    part = Part(wang_tiling, domain, skin)
    made, found, told = mesh(part, islands="keep", resolution=20)
    _, other, _ = mesh(part, MarchingCubes, resolution=48, islands="keep")
    assert found.edges.closed
    assert found.volume == pytest.approx(other.volume, rel=0.03)
    if skin:
        assert {tuple(v) for v in domain.vertices.tolist()} <= {tuple(v) for v in made.vertices.tolist()}
    assert told["bodies"] >= 1
    alone, single, told = mesh(part, resolution=20)
    assert single.volume <= found.volume
    assert len(alone.faces) <= len(made.faces)


def test_a_skin_thicker_than_the_part_leaves_the_part(wang_tiling, ball):
    made, found, _ = mesh(Part(wang_tiling, ball, 6.0), resolution=8)
    assert found.volume == pytest.approx(volume(ball.vertices, ball.faces), rel=1e-12)
    assert len(made.faces) == len(ball.faces)


def test_tolerance_brings_vertices_to_the_surface(wang):
    laid = PeriodicTiling(cells=(1, 1, 1), cell=Length(4, "mm"))
    sized = laid.run(PlainContext(), wang.micro.alone(0, (0, 0, 0)), None)
    exact = mesh(sized, MarchingCubes, resolution=96)[1].volume
    rough = mesh(sized, resolution=14)[1].volume
    fine = mesh(sized, resolution=14, surface_tolerance=Length(10, "um"))[1].volume
    assert abs(fine - exact) < 0.7 * abs(rough - exact)


def test_islands_of_a_cell_go(cell):
    loose = cell.with_level(0.03)
    _, kept, _ = mesh(loose, islands="keep")
    _, removed, told = mesh(loose)
    assert told["removed_share"] > 0.001
    assert removed.components < kept.components


def test_what_cannot_be(cell, wang_tiling, ball, monkeypatch):
    with pytest.raises(DesignError, match="no solid"):
        mesh(cell.with_level(1e-9))
    with pytest.raises(InputError, match="open edges"):
        mesh(Part(wang_tiling, SurfaceMesh(ball.vertices, ball.faces[2:], "torn")))
    with pytest.raises(ConfigError):
        ManifoldSdf(resolution=9, voxel=Length(1)).check_options()
    monkeypatch.setattr(budget, "available_memory", lambda limit: 1000)
    with pytest.raises(ResourceError, match="lattice"):
        mesh(cell)


class TestContract(StageContract):
    @pytest.fixture(autouse=True)
    def _given(self, wang_tiling, wedge):
        part = SurfaceMesh(0.5 * wedge.vertices, wedge.faces, "wedge")
        self.given = {"field": Part(wang_tiling, part, 0.4)}

    def stages(self):
        return [
            ManifoldSdf(resolution=8),
            ManifoldSdf(voxel=Length(0.6, "mm"), surface_tolerance=Length(0.01), islands="keep"),
        ]

    def inputs(self):
        return self.given
