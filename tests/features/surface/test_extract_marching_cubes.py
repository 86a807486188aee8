"""Meshes of cells, tilings and parts: closed, oriented, of the right volume."""

import hashlib
import importlib

import numpy as np
import pytest

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.files.stages.write_mesh import ENCODERS
from sppm_pipeline.features.surface import field_surface
from sppm_pipeline.features.surface.stages import extract_marching_cubes as marching_cubes
from sppm_pipeline.features.surface.stages.extract_marching_cubes import MarchingCubes
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.grid import cell_centers
from sppm_pipeline.services.mesh.measures import components, measure_surface
from sppm_pipeline.services.paging import mapping_of
from sppm_pipeline.testing.plain_context import PlainContext


def mesh(field, **options):
    context = PlainContext()
    made = MarchingCubes(**{"resolution": 24, **options}).run(context, field)
    made.check()
    return made, measure_surface(made.vertices, made.faces), context


def test_a_cell(cell):
    made, found, context = mesh(cell)
    assert found.edges.closed
    assert found.volume == pytest.approx(cell.solid(cell_centers(48)).mean(), rel=0.02)
    assert made.vertices.min() == 0.0
    assert made.vertices.max() == 1.0
    assert "cell size" in context.warnings[0]


def side(vertices, axis, at):
    """Places on a face of the unit cell of all vertices there, sorted."""
    on = np.delete(vertices[vertices[:, axis] == at], axis, axis=1).round(12)
    return on[np.lexsort(on.T)]


@pytest.mark.parametrize("caps", [True, False])
@pytest.mark.parametrize("islands", ["keep", "remove"])
def test_opposite_sides_of_a_cell_match_node_for_node(cell, caps, islands):
    made, found, _ = mesh(cell, islands=islands, caps=caps)
    assert found.edges.closed == caps
    assert found.edges.consistent
    for axis in range(3):
        low, high = side(made.vertices, axis, 0.0), side(made.vertices, axis, 1.0)
        assert len(low) > 50
        assert np.array_equal(low, high)


def test_without_caps_the_surface_ends_in_rims_on_the_faces(cell):
    made, found, _ = mesh(cell, caps=False)
    edges = np.sort(made.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    edges, uses = np.unique(edges, axis=0, return_counts=True)
    rim = made.vertices[edges[uses == 1]]  # (n, 2, 3)
    assert len(rim) == found.edges.boundary > 0
    assert (((rim == 0.0) | (rim == 1.0)).all(1).any(1)).all()


@pytest.mark.parametrize("backend", ["compiled", "reference"])
def test_a_tiling_in_mm(wang_tiling, backend):
    made, found, context = mesh(wang_tiling, resolution=20, backend=backend, islands="keep")
    assert not context.warnings
    assert found.edges.bounds_solid
    solid = wang_tiling.solid(cell_centers(24, wang_tiling.cells)).mean() * np.prod(wang_tiling.cells) * 64
    assert found.volume == pytest.approx(solid, rel=0.03)
    assert np.allclose(made.lower, 0, atol=0.35)
    assert np.allclose(made.upper, [16, 12, 12], atol=0.35)
    if backend == "compiled":
        assert found.degenerate == 0
        assert np.allclose(made.lower, 0, atol=1e-9)
        assert np.allclose(made.upper, [16, 12, 12], atol=1e-9)


def test_both_backends_agree(cell):
    volumes = [mesh(cell, resolution=32, backend=b)[1].volume for b in ("compiled", "reference")]
    assert volumes[0] == pytest.approx(volumes[1], rel=0.03)  # the reference rounds the cap off


@pytest.mark.parametrize("skin", [0.0, 0.8])
def test_a_part_is_closed_and_lies_in_its_domain(wang_tiling, ball, skin):
    part = Part(wang_tiling, ball, skin)
    made, found, _ = mesh(part, resolution=20, islands="keep")
    assert found.edges.closed
    outside = np.linalg.norm(made.vertices - 5, axis=1) - 5
    assert outside.max() < 0.02 * 0.2  # of the pitch: at the rims of pores a crossing is interpolated across a crease
    assert (outside > 1e-4).mean() < 1e-4
    h = 4 / 24
    voxels = part.solid(cell_centers(24, wang_tiling.cells)).sum() * h**3
    assert found.volume == pytest.approx(voxels, rel=0.05)


def test_islands_go_or_stay(cell):
    loose = cell.with_level(0.03)
    kept, _, _ = mesh(loose, islands="keep")
    removed, found, context = mesh(loose)
    assert context.reported["removed_share"] > 0.001
    assert components(removed.faces)[0] < components(kept.faces)[0]
    assert found.edges.closed


def test_nothing_to_mesh(cell):
    with pytest.raises(DesignError, match="no solid"):
        mesh(cell.with_level(1e-9))


def part_of(tiling, domain, skin):
    return Part(tiling, domain, skin, "remove")


@pytest.mark.parametrize("what", ["cell", "tiling", "part", "skin"])
def test_same_bytes_however_it_is_cut(what, cell, wang_tiling, ball, monkeypatch):
    def made(threads):
        source = {
            "cell": lambda: cell.with_level(0.05),
            "tiling": lambda: wang_tiling,
            "part": lambda: part_of(wang_tiling, ball, 0.0),
            "skin": lambda: part_of(wang_tiling, ball, 1.3),
        }[what]()
        return MarchingCubes(resolution=13).run(PlainContext(threads=threads), source)

    whole = made(1)
    assert len(whole.faces) > 1000
    for slab, kept, piece in ((1, 2**25, 2**17), (4000, 0, 1), (10**9, 0, 3000), (9000, 2**25, 2**17)):
        monkeypatch.setattr(field_surface, "SLAB_SAMPLES", slab)
        monkeypatch.setattr(field_surface, "PIECE_SAMPLES", piece)
        monkeypatch.setattr(field_surface, "KEPT_SAMPLES", kept)
        for threads in (1, 3):
            again = made(threads)
            assert again.vertices.tobytes() == whole.vertices.tobytes()
            assert again.faces.tobytes() == whole.faces.tobytes()
            assert again.summary() == SurfaceMesh(whole.vertices, whole.faces, name="surface").summary()


def test_spacing_is_the_largest_edge_of_a_voxel(wang_tiling):
    made, _, context = mesh(wang_tiling, resolution=None, voxel=Length(0.3, "mm"))
    assert context.reported["resolution"] == 14
    assert context.reported["voxel"] == pytest.approx(4 / 14)
    assert made.digest() == mesh(wang_tiling, resolution=14)[0].digest()


@pytest.mark.parametrize("spacing", [3.0, 1e-5])
def test_a_spacing_that_makes_no_sense(wang_tiling, spacing):
    with pytest.raises(DesignError, match="along an edge of the cell"):
        mesh(wang_tiling, resolution=None, voxel=Length(spacing, "mm"))


def test_a_spacing_needs_a_size(cell):
    with pytest.raises(DesignError, match="physical size"):
        mesh(cell, resolution=None, voxel=Length(0.1, "mm"))


@pytest.mark.parametrize("options", [{"resolution": 20, "voxel": Length(0.1)}, {"backend": "reference", "caps": False}])
def test_options_that_contradict_each_other(options):
    with pytest.raises(ConfigError):
        MarchingCubes(**options).check_options()


def test_progress_reaches_its_end(wang_tiling):
    _, _, context = mesh(wang_tiling)
    done, total, what = context.progress_calls[-1]
    assert done == total == 3 * 24 + 1
    assert what == "planes"


def test_a_mesh_in_files_is_the_mesh_in_memory(wang_tiling, ball, monkeypatch):
    part = Part(wang_tiling, ball, 0.4)
    in_memory, found, _ = mesh(part, resolution=12)
    monkeypatch.setattr(marching_cubes, "MEMORY_SHARE", 2**40)
    monkeypatch.setattr(field_surface, "SLAB_SAMPLES", 5000)
    monkeypatch.setattr(field_surface, "PIECE_SAMPLES", 2000)
    in_files, _, _ = mesh(part, resolution=12)
    assert found.edges.closed
    assert mapping_of(in_files.vertices) is not None
    assert mapping_of(in_memory.vertices) is None
    assert in_files.digest() == in_memory.digest()
    assert in_files.summary() == in_memory.summary()
    for module in ENCODERS.values():
        encode = importlib.import_module(module).encode
        one, other = (
            hashlib.sha256(b"".join(bytes(piece) for piece in encode(made.vertices, made.faces))).hexdigest()
            for made in (in_memory, in_files)
        )
        assert one == other
