"""Caps at the border of the box, and surfaces left open for the next periodic cell."""

from itertools import pairwise

import manifold3d
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sppm_pipeline.features.surface.mesh_stream import count_mesh
from sppm_pipeline.method.connectivity.islands import clear_runs
from sppm_pipeline.method.connectivity.runs import find_runs
from sppm_pipeline.services.mesh.closing import capped_marching_cubes, capped_marching_cubes_slabs, wrapped
from sppm_pipeline.services.mesh.marching_cubes import marching_cubes
from sppm_pipeline.services.mesh.measures import measure_surface

ORIGIN, SPACING = (0.3, -1.0, 2.0), (0.5, 0.25, 0.125)
fixed = settings(derandomize=True, deadline=None, max_examples=30)


def test_a_full_box() -> None:
    field = np.full((4, 5, 6), -1, np.float32)
    measures = measure_surface(*capped_marching_cubes(field, 0, ORIGIN, SPACING))
    steps, low = np.array([5, 4, 3]), np.array(ORIGIN)
    assert measures.low == pytest.approx(low, abs=1e-15)
    assert measures.high == pytest.approx(low + steps * SPACING, abs=1e-15)
    assert measures.volume == pytest.approx(np.prod(steps * SPACING), rel=1e-6)
    assert measures.genus == 0
    assert measures.degenerate == 0


@fixed
@given(
    seed=st.integers(0, 2**32 - 1),
    shape=st.tuples(st.integers(2, 7), st.integers(2, 7), st.integers(2, 66)),
)
def test_caps_close_noise_and_lie_in_the_border(seed: int, shape: tuple[int, int, int]) -> None:
    field = np.random.default_rng(seed).standard_normal(shape).astype(np.float32)
    field[0, 0, 0] = -1
    vertices, faces = capped_marching_cubes(field, 0, ORIGIN, SPACING)
    measures = measure_surface(vertices, faces)
    assert measures.edges.closed
    assert measures.degenerate == 0
    assert len(np.unique(vertices, axis=0)) == len(vertices)
    assert measures.volume > 0
    low = np.array(ORIGIN)
    high = low + (np.array(shape[::-1]) - 1) * SPACING
    assert (vertices >= low).all()
    assert (vertices <= high + 1e-15).all()


def test_manifold3d_accepts_the_caps() -> None:
    field = np.random.default_rng(4).standard_normal((9, 10, 11)).astype(np.float32)
    vertices, faces = capped_marching_cubes(field)
    solid = manifold3d.Manifold(manifold3d.Mesh64(vertices, faces.astype(np.uint64)))
    assert solid.status() == manifold3d.Error.NoError
    assert solid.volume() == pytest.approx(measure_surface(vertices, faces).volume, rel=1e-12)


def test_inside_the_box_a_cap_changes_nothing() -> None:
    field = np.random.default_rng(6).standard_normal((6, 7, 8)).astype(np.float32)
    plain = marching_cubes(field)[0]
    capped = capped_marching_cubes(field)[0]
    assert {tuple(v) for v in plain.round(9).tolist()} <= {tuple(v) for v in capped.round(9).tolist()}


def test_solid_and_void_share_the_box() -> None:
    field = np.random.default_rng(7).standard_normal((12, 12, 12)).astype(np.float32)
    # Away from noise both signs separate their own corners; a smooth field has no ambiguous face.
    x = np.arange(12)
    smooth = (np.sin(0.7 * x[:, None, None]) + np.cos(0.5 * x[:, None]) + np.sin(0.6 * x) + 0 * field).astype(
        np.float32
    )
    solid, void = (measure_surface(*capped_marching_cubes(sign * smooth, 0.0)).volume for sign in (1, -1))
    assert solid + void == pytest.approx(11**3, rel=1e-4)


@fixed
@given(cuts=st.lists(st.integers(0, 9), max_size=5))
def test_slabs_give_the_bytes_of_the_whole(cuts: list[int]) -> None:
    field = np.random.default_rng(9).standard_normal((9, 4, 6)).astype(np.float32)
    whole = capped_marching_cubes(field, 0.1, ORIGIN, SPACING)
    slabs = (field[a:b] for a, b in pairwise([0, *sorted(cuts), 9]))
    pieces = list(capped_marching_cubes_slabs(slabs, 0.1, ORIGIN, SPACING))
    for which in (0, 1):
        assert np.concatenate([piece[which] for piece in pieces]).tobytes() == whole[which].tobytes()


def test_more_planes_than_are_padded_at_once() -> None:
    field = np.random.default_rng(10).standard_normal((40, 4, 5)).astype(np.float32)
    once = list(capped_marching_cubes_slabs([field]))
    assert np.array_equal(np.concatenate([v for v, _ in once]), capped_marching_cubes(field)[0])


def test_wrapped_repeats_the_first_planes() -> None:
    field = np.random.default_rng(13).standard_normal((3, 4, 5)).astype(np.float32)
    assert np.array_equal(wrapped(field), np.pad(field, (0, 1), mode="wrap"))


def test_a_mirrored_field_has_the_mirrored_caps() -> None:
    field = np.random.default_rng(14).standard_normal((5, 6, 7)).astype(np.float32)
    vertices = capped_marching_cubes(field)[0]
    for axis in range(3):
        mirrored = capped_marching_cubes(np.ascontiguousarray(np.flip(field, 2 - axis)))[0]
        mirrored[:, axis] = field.shape[2 - axis] - 1 - mirrored[:, axis]
        assert {tuple(v) for v in mirrored.round(9).tolist()} == {tuple(v) for v in vertices.round(9).tolist()}


def test_no_slabs_no_mesh() -> None:
    assert list(capped_marching_cubes_slabs([])) == []


def test_wrong_arguments() -> None:
    with pytest.raises(ValueError, match="2 x 2 x 2"):
        capped_marching_cubes(np.zeros((2, 1, 2), np.float32))


@pytest.mark.parametrize("capped", [True, False])
@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("shape", [(5, 6, 7), (9, 3, 64), (4, 5, 62), (3, 4, 130), (2, 2, 2)])
def test_counts_from_runs_are_those_of_the_mesh(capped: bool, threads: int, shape: tuple[int, int, int]) -> None:
    random = np.random.default_rng(sum(shape))
    for share in (0.5, 0.1, 0.95, 0.0, 1.0):
        solid = random.random(shape) < share
        runs = find_runs(solid.view(np.uint8))
        keep = random.random(runs.n_runs) < 0.8
        clear_runs(runs.rows, runs.bounds, keep, solid.view(np.uint8))
        field = np.where(solid, np.float32(-1), np.float32(1))
        vertices, faces = (capped_marching_cubes if capped else marching_cubes)(field)
        found = count_mesh(runs, keep, capped, threads)
        assert (found.vertices, found.faces) == (len(vertices), len(faces))
        if solid.any():
            z, y, x = np.nonzero(solid)
            assert found.low.tolist() == [x.min(), y.min(), z.min()]
            assert found.high.tolist() == [x.max(), y.max(), z.max()]
