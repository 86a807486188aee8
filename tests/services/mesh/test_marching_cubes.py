"""Marching cubes: closed, oriented, exact where it can be, the same for every partition into slabs."""

from collections import defaultdict
from itertools import pairwise

import manifold3d
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from sppm_pipeline.errors import ResourceError
from sppm_pipeline.services.mesh import marching_cubes as module
from sppm_pipeline.services.mesh.closing import wrapped
from sppm_pipeline.services.mesh.marching_cubes import EDGE_MARGIN, marching_cubes, marching_cubes_slabs
from sppm_pipeline.services.mesh.marching_tables import case_tables
from sppm_pipeline.services.mesh.measures import edge_counts, euler_number, measure_surface, volume

Field = NDArray[np.float32]
fixed = settings(derandomize=True, deadline=None, max_examples=40)


def surrounded(inner: Field, value: float = 1.0) -> Field:
    return np.pad(inner, 1, constant_values=np.float32(value)).astype(np.float32)


def nodes(n: int, size: float = 1.0) -> tuple[Field, Field, Field, float]:
    axis = np.linspace(-size, size, n)
    z, y, x = np.meshgrid(axis, axis, axis, indexing="ij")
    return x, y, z, 2 * size / (n - 1)


def torus(n: int) -> tuple[Field, float]:
    x, y, z, h = nodes(n)
    return (np.hypot(np.hypot(x, y) - 0.6, z) - 0.25).astype(np.float32), h


def has_one_umbrella_per_vertex(faces: NDArray[np.int32]) -> bool:
    """Whether the triangles around each vertex form a single closed ring."""
    following: dict[int, dict[int, int]] = defaultdict(dict)
    for triangle in faces.tolist():
        for i in range(3):
            following[triangle[i]][triangle[(i + 1) % 3]] = triangle[(i + 2) % 3]
    for ring in following.values():
        start = next(iter(ring))
        at, steps = ring[start], 1
        while at != start:
            at, steps = ring[at], steps + 1
        if steps != len(ring):
            return False
    return True


def assert_clean(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> None:
    measures = measure_surface(vertices, faces)
    assert measures.edges.closed
    assert measures.volume > 0
    assert measures.degenerate == 0
    assert measures.vertices == len(vertices) == len(np.unique(vertices, axis=0))
    assert has_one_umbrella_per_vertex(faces)


def obvious(field: Field, level: float) -> set[tuple[tuple[float, float, float], ...]]:
    """Triangles cube by cube, as positions; each starts with its smallest corner."""
    tables = case_tables()
    nz, ny, nx = field.shape
    triangles = set()
    for k, j, i in np.ndindex(nz - 1, ny - 1, nx - 1):
        corners = [(i + (c & 1), j + (c >> 1 & 1), k + (c >> 2)) for c in range(8)]
        values = [float(field[z, y, x]) for x, y, z in corners]
        case = sum((value < level) << c for c, value in enumerate(values))
        points = []
        for edge in tables.triangles[case, : 3 * int(tables.counts[case])].tolist():
            axis, first, second = edge // 4, edge & 1, edge >> 1 & 1
            at = [first, second]
            at.insert(axis, 0)
            a = at[0] + 2 * at[1] + 4 * at[2]
            b = a + (1 << axis)
            share = min(max((level - values[a]) / (values[b] - values[a]), EDGE_MARGIN), 1 - EDGE_MARGIN)
            point = [float(value) for value in corners[a]]
            point[axis] += share
            points.append(tuple(point))
        for t in range(0, len(points), 3):
            turn = min(range(3), key=lambda c, t=t: points[t + c])
            triangles.add(tuple(points[t + (turn + c) % 3] for c in range(3)))
    return triangles


@pytest.mark.parametrize("case", range(1, 256))
def test_each_of_the_256_cases_is_closed(case: int) -> None:
    inner = np.array([-1.0 if case >> c & 1 else 1.0 for c in range(8)], np.float32).reshape(2, 2, 2)
    vertices, faces = marching_cubes(surrounded(inner))
    assert_clean(vertices, faces)
    assert euler_number(faces) % 2 == 0


@pytest.mark.parametrize("shape", [(3, 4, 130), (4, 3, 64), (3, 3, 65), (5, 6, 7), (2, 2, 2)])
def test_same_triangles_as_cube_by_cube(shape: tuple[int, int, int]) -> None:
    field = np.random.default_rng(3).standard_normal(shape).astype(np.float32)
    vertices, faces = marching_cubes(field, 0.125)
    found = set()
    for corners in vertices[faces].tolist():
        turn = min(range(3), key=lambda c, corners=corners: corners[c])
        found.add(tuple(tuple(corners[(turn + c) % 3]) for c in range(3)))
    assert len(found) == len(faces)
    assert found == obvious(field, 0.125)


@fixed
@given(
    seed=st.integers(0, 2**32 - 1),
    shape=st.tuples(st.integers(1, 6), st.integers(1, 6), st.integers(1, 70)),
    steps=st.sampled_from([0, 1, 2, 5]),
)
def test_noise_is_closed_however_many_samples_hit_the_level(seed: int, shape: tuple[int, int, int], steps: int) -> None:
    inner = np.random.default_rng(seed).standard_normal(shape)
    if steps:
        inner = np.round(inner * steps) / steps
    inner.flat[0] = -1.0
    assert_clean(*marching_cubes(surrounded(inner)))


def test_infinities_and_nan_leave_the_surface_closed() -> None:
    values = np.array([-1, 1, 0, np.inf, -np.inf, np.nan], np.float32)
    field = surrounded(np.random.default_rng(8).choice(values, (8, 9, 10)), np.nan)
    vertices, faces = marching_cubes(field)
    assert np.isfinite(vertices).all()
    assert_clean(vertices, faces)


def test_vertices_lie_where_linear_interpolation_puts_them() -> None:
    x, y, z, h = nodes(12)
    field = (0.3 * x + 0.5 * y - 0.7 * z - 0.1).astype(np.float32)
    vertices, faces = marching_cubes(field, 0.05, (-1, -1, -1), (h, h, h))
    assert np.abs(vertices @ [0.3, 0.5, -0.7] - 0.15).max() < EDGE_MARGIN * h
    normals = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    assert (normals @ [0.3, 0.5, -0.7] > 0).all()


def test_a_sample_on_the_level_moves_a_vertex_by_the_margin_only() -> None:
    field = surrounded(np.zeros((1, 1, 1), np.float32))
    field[1, 1, 1] = -1.0
    field[1, 1, 2] = 0.0
    vertices, _ = marching_cubes(field)
    assert vertices[:, 0].max() == 2 - EDGE_MARGIN


def test_volume_and_area_of_a_sphere_converge_with_order_two() -> None:
    radius = 0.8
    exact = 4 / 3 * np.pi * radius**3, 4 * np.pi * radius**2
    errors = []
    for n in (17, 33, 65):
        x, y, z, h = nodes(n)
        measures = measure_surface(*marching_cubes(np.sqrt(x * x + y * y + z * z) - radius, 0, (-1,) * 3, (h,) * 3))
        assert (measures.euler, measures.genus, measures.components) == (2, 0, 1)
        errors.append([abs(measures.volume - exact[0]), abs(measures.area - exact[1])])
    for coarse, fine in pairwise(np.array(errors)):
        assert (coarse / fine > 3.4).all()
        assert (coarse / fine < 4.8).all()


def test_a_torus_has_one_handle() -> None:
    field, h = torus(40)
    measures = measure_surface(*marching_cubes(field, 0, (-1,) * 3, (h,) * 3))
    assert measures.genus == 1
    assert measures.volume == pytest.approx(2 * np.pi**2 * 0.6 * 0.25**2, rel=0.01)


def test_a_level_is_an_offset_of_the_field() -> None:
    x, y, z, _ = nodes(20)
    field = np.sqrt(x * x + y * y + z * z).astype(np.float32)
    low, high = (volume(*marching_cubes(field, level)) for level in (0.5, 0.75))
    assert high / low == pytest.approx(1.5**3, rel=0.03)


@fixed
@given(cuts=st.lists(st.integers(0, 12), max_size=6), seed=st.integers(0, 1000))
def test_slabs_give_the_bytes_of_the_whole(cuts: list[int], seed: int) -> None:
    field = np.random.default_rng(seed).standard_normal((12, 5, 67)).astype(np.float32)
    origin, spacing = (0.1, -3.0, 7.0), (0.1, 0.2, 0.3)
    whole = marching_cubes(field, 0.2, origin, spacing)
    borders = [0, *sorted(cuts), 12]
    slabs = (field[a:b].copy() for a, b in pairwise(borders))
    pieces = list(marching_cubes_slabs(slabs, 0.2, origin, spacing))
    assert len(pieces) == len(borders) - 1
    for which in (0, 1):
        assert np.concatenate([piece[which] for piece in pieces]).tobytes() == whole[which].tobytes()


def test_a_slab_may_be_overwritten_and_names_no_vertex_of_later_pieces() -> None:
    field = np.random.default_rng(5).standard_normal((9, 6, 8)).astype(np.float32)
    buffer = np.empty((1, 6, 8), np.float32)

    def slabs():  # type: ignore[no-untyped-def]
        for plane in field:
            buffer[0] = plane
            yield buffer

    known, pieces = 0, []
    for vertices, faces in marching_cubes_slabs(slabs()):
        known += len(vertices)
        assert faces.size == 0 or faces.max() < known
        pieces.append(faces)
    assert np.array_equal(np.concatenate(pieces), marching_cubes(field)[1])


def test_manifold3d_accepts_the_mesh() -> None:
    rng = np.random.default_rng(11)
    for field in (torus(30)[0], surrounded(rng.standard_normal((14, 14, 14)))):
        vertices, faces = marching_cubes(field)
        solid = manifold3d.Manifold(manifold3d.Mesh64(vertices, faces.astype(np.uint64)))
        assert solid.status() == manifold3d.Error.NoError
        assert solid.num_tri() == len(faces)
        assert solid.volume() == pytest.approx(volume(vertices, faces), rel=1e-12)


def test_no_surface_no_mesh() -> None:
    for value in (-1.0, 0.0, 1.0, np.nan):
        vertices, faces = marching_cubes(np.full((3, 3, 3), value, np.float32))
        assert vertices.shape == (0, 3)
        assert faces.shape == (0, 3)
        assert edge_counts(faces) == (0, 0, 0, 0)


def test_other_types_and_layouts_are_converted() -> None:
    field = np.random.default_rng(2).standard_normal((6, 7, 8)).astype(np.float32)
    expected = marching_cubes(field)
    for other in (field.astype(np.float64), np.asfortranarray(field), np.repeat(field, 2, axis=2)[:, :, ::2]):
        assert np.array_equal(marching_cubes(other)[0], expected[0])


@pytest.mark.parametrize("shape", [(3, 3), (1, 3, 3), (3, 1, 3), (3, 3, 1), (0, 3, 3)])
def test_too_few_samples(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="2 x 2 x 2"):
        marching_cubes(np.zeros(shape, np.float32))


def test_wrong_slabs_and_frames() -> None:
    with pytest.raises(ValueError, match=r"\(k, 3, 4\)"):
        list(marching_cubes_slabs([np.zeros((1, 3, 4), np.float32), np.zeros((1, 4, 3), np.float32)]))
    with pytest.raises(ValueError, match="2 x 2"):
        list(marching_cubes_slabs([np.zeros((2, 1, 4), np.float32)]))
    for spacing in ((1.0, 0.0, 1.0), (1.0, np.nan, 1.0), (1.0, -1.0, 1.0)):
        with pytest.raises(ValueError, match="positive"):
            marching_cubes(np.zeros((2, 2, 2), np.float32), 0.0, (0, 0, 0), spacing)


def test_too_many_vertices_are_refused_before_they_are_made(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "slab_counts", lambda *_: (2**31, 2**32))
    with pytest.raises(ResourceError, match="vertices"):
        marching_cubes(np.zeros((2, 2, 2), np.float32))


@pytest.mark.parametrize(
    ("name", "expected"),
    [("gyroid", -8), ("schwarz p", -4), ("diamond", -16)],  # of the cubic cell; Schoen (1970)
)
@pytest.mark.parametrize("n", [12, 25])
def test_euler_number_of_minimal_surfaces_on_the_torus(name: str, expected: int, n: int) -> None:
    t = 2 * np.pi * (np.arange(n) + 0.3) / n
    z, y, x = np.meshgrid(t, t, t, indexing="ij")
    field = {
        "gyroid": np.sin(x) * np.cos(y) + np.sin(y) * np.cos(z) + np.sin(z) * np.cos(x),
        "schwarz p": np.cos(x) + np.cos(y) + np.cos(z),
        "diamond": np.cos(x) * np.cos(y) * np.cos(z) - np.sin(x) * np.sin(y) * np.sin(z),
    }[name]
    vertices, faces = marching_cubes(wrapped(field.astype(np.float32)))
    _, number = np.unique((vertices % n).round(6) % n, axis=0, return_inverse=True)
    on_torus = number.reshape(-1)[faces]
    assert edge_counts(on_torus).closed  # the rims on opposite faces are the same vertices
    assert euler_number(on_torus) == expected


def test_volume_and_area_of_a_torus_converge_at_second_order() -> None:
    errors = []
    for n in (25, 50, 100):
        field, h = torus(n)
        found = measure_surface(*marching_cubes(field, 0.0, (-1, -1, -1), (h, h, h)))
        assert (found.genus, found.components) == (1, 1)
        exact = 2 * np.pi**2 * 0.6 * 0.25**2, 4 * np.pi**2 * 0.6 * 0.25
        errors.append([abs(found.volume / exact[0] - 1), abs(found.area / exact[1] - 1)])
    for coarse, fine in pairwise(np.array(errors)):
        assert (fine < coarse / 3).all()
