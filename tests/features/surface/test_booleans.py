"""Booleans: exact volumes, and the failures that manifold3d keeps to itself."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sppm_pipeline.errors import DesignError, InputError
from sppm_pipeline.features.surface import solids as booleans
from sppm_pipeline.features.surface.solids import boolean, check_solid, run_boolean
from sppm_pipeline.method.part.primitive_meshes import ball_mesh, box_mesh, torus_mesh
from sppm_pipeline.services.mesh.measures import edge_counts, volume

UNIT = box_mesh((0.5, 0.5, 0.5), (1.0, 1.0, 1.0))


def box(low, high):
    low, high = np.array(low, float), np.array(high, float)
    return box_mesh(tuple((low + high) / 2), tuple(high - low))


@settings(derandomize=True, deadline=None, max_examples=40)
@given(st.tuples(*[st.integers(-4, 4)] * 3), st.tuples(*[st.integers(1, 6)] * 3))
def test_boxes_on_a_lattice(corner, size):
    """Faces, edges and corners coincide in all ways; the volumes are exact."""
    low, high = np.array(corner) / 4, (np.array(corner) + size) / 4
    common = float(np.prod(np.clip(np.minimum(high, 1) - np.maximum(low, 0), 0, None)))
    own = float(np.prod(high - low))
    expected = {"union": 1 + own - common, "difference": 1 - common, "intersection": common}
    for operation, wanted in expected.items():
        if wanted < 1e-9:
            with pytest.raises(DesignError, match="nothing is left"):
                boolean(UNIT, box(low, high), operation)
            continue
        vertices, faces = boolean(UNIT, box(low, high), operation)
        assert edge_counts(faces).bounds_solid
        assert volume(vertices, faces) == pytest.approx(wanted, rel=1e-9)


def test_same_bytes_twice():
    ball, torus = ball_mesh((0, 0, 0), 1.0, 5), torus_mesh((0.3, 0, 0), 1.0, 0.4, 90, 45)
    once, again = (boolean(ball, torus, "difference") for _ in range(2))
    assert once[0].tobytes() == again[0].tobytes()
    assert once[1].tobytes() == again[1].tobytes()


def test_read_only_operands_stay_as_they_are():
    ball = ball_mesh((0, 0, 0), 1.0, 3)
    for array in ball:
        array.setflags(write=False)
    before = [array.copy() for array in ball]
    boolean(ball, UNIT, "union")
    assert all(np.array_equal(a, b) for a, b in zip(ball, before, strict=True))


def test_what_does_not_bound_a_solid():
    vertices, faces = UNIT
    for bad, words in (
        ((vertices, faces[:0]), "no triangle"),
        ((vertices, faces[1:]), "3 open edges"),
        ((vertices, faces[:, ::-1]), "inside out"),
        ((vertices, np.concatenate([faces, faces[:, ::-1]])), "double sheet"),
        ((vertices, np.concatenate([faces[:1, ::-1], faces[1:]])), "winding"),
    ):
        with pytest.raises(InputError, match=words):
            boolean(bad, UNIT, "union")
        with pytest.raises(InputError, match=words):
            boolean(UNIT, bad, "union")
    assert check_solid(vertices, faces, "box") == pytest.approx(1)


def test_a_sheet_inside_of_a_solid_is_no_volume_lost():
    """A thick and a thin body in one mesh; the thin one is a double sheet, which manifold3d drops without a word."""
    sheet = np.array([[0, 0, 9], [1, 0, 9], [0, 1, 9]], float)
    flat = np.array([[8, 9, 10], [8, 10, 9]])
    mesh = np.concatenate([UNIT[0], sheet]), np.concatenate([UNIT[1], flat]).astype(np.int32)
    made = boolean(mesh, box((0.5, 0, 0), (2, 1, 1)), "intersection")
    assert volume(*made) == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({"statuses": ("NotManifold", "NoError", "NotManifold")}, InputError, "one is no oriented manifold"),
        ({"volumes": (1.0, 0.2, 0.5)}, InputError, "two encloses"),
        ({"statuses": ("NoError", "NoError", "Cancelled")}, DesignError, "Cancelled"),
        ({"faces": UNIT[1][1:]}, DesignError, "came out"),
        ({"vertices": 3 * UNIT[0]}, DesignError, "between 0 and 1 is possible"),
        ({"faces": UNIT[1][:0]}, DesignError, "nothing is left"),
    ],
)
def test_results_that_cannot_be(monkeypatch, change, error, words):
    real = run_boolean(*UNIT, *UNIT, "intersection")
    monkeypatch.setattr(booleans, "run_boolean", lambda *_: real._replace(**change))
    with pytest.raises(error, match=words):
        boolean(UNIT, UNIT, "intersection", ("one", "two"))
