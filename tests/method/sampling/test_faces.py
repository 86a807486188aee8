"""Face patterns: spacing against every pattern that can meet, margins, equal laws, honest failures."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.sampling.capacity import face_capacity
from sppm_pipeline.method.sampling.faces import face_counts, mirrored_faces

SHIFTS = np.array(list(itertools.product((-1, 0, 1), repeat=3)), dtype=float)


def pair_distances(a: NDArray[np.float64], b: NDArray[np.float64], shifts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distances of all points of a to all shifted points of b."""
    return np.linalg.norm(a[None, :, None] - (b[None] + shifts[:, None])[:, None], axis=-1)


@settings(deadline=None, derandomize=True, max_examples=60)
@given(
    spacing=st.floats(0.08, 0.4),
    colors=st.integers(1, 4),
    share=st.floats(0.2, 0.9),
    wider=st.sampled_from([None, 0.5, 0.8]),
    seed=st.integers(0, 2**32),
)
def test_spacing_holds_wherever_patterns_meet(
    spacing: float, colors: int, share: float, wider: float | None, seed: int
) -> None:
    margin = None if wider is None else wider * spacing
    count = math.floor(share * face_capacity(spacing, colors, margin))
    faces = mirrored_faces(np.random.default_rng(seed), 3 * count, spacing, colors, margin)
    border = margin if margin is not None else (0.0 if colors == 1 else spacing / 2)
    assert len(faces) == 3
    for axis, color in itertools.product(range(3), range(colors)):
        points = faces[axis][color]
        assert points.shape == (count, 3)
        assert np.all(points[:, axis] == 0.0)
        in_plane = np.delete(points, axis, axis=1)
        assert np.all((in_plane >= border) & (in_plane <= 1.0 - border))
        own = pair_distances(points, points, SHIFTS)
        own[own == 0.0] = math.inf
        assert own.min(initial=math.inf) >= spacing
        for other, theirs in itertools.product(range(3), range(colors)):
            if other != axis:
                assert pair_distances(points, faces[other][theirs], SHIFTS).min(initial=math.inf) >= spacing
            elif theirs != color:
                # Faces of another color lie beside this one in its plane, never on it.
                beside = SHIFTS[(SHIFTS[:, axis] == 0) & np.any(SHIFTS != 0, axis=1)]
                distance = pair_distances(points, faces[axis][theirs], beside)
                assert distance.min(initial=math.inf) >= spacing * (1 - 1e-12)


def test_colors_of_one_axis_may_overlap() -> None:
    """Two colors never share a face: together they hold more than one face could."""
    faces = mirrored_faces(np.random.default_rng(0), 45, 0.16, 3)
    distance = pair_distances(faces[0][0], faces[0][1], np.zeros((1, 3)))
    assert distance.min() < 0.16


def test_axes_and_colors_follow_the_same_law() -> None:
    """Over many throws of dense faces the mean distance from the border is the same for every pattern."""
    spacing, colors, runs = 0.25, 2, 250
    depth = np.empty((runs, 3, colors))
    for run in range(runs):
        faces = mirrored_faces(np.random.default_rng(run), 21, spacing, colors)
        for axis, color in itertools.product(range(3), range(colors)):
            in_plane = np.delete(faces[axis][color], axis, axis=1)
            depth[run, axis, color] = np.minimum(in_plane, 1.0 - in_plane).mean()
    error = depth.std() / math.sqrt(runs)
    assert np.abs(depth.mean(axis=0) - depth.mean()).max() < 4 * error


def test_same_seed_same_bytes() -> None:
    first, second, other = (
        np.vstack([p for axis in mirrored_faces(np.random.default_rng(s), 36, 0.16, 3) for p in axis]).tobytes()
        for s in (1, 1, 2)
    )
    assert first == second
    assert first != other


@pytest.mark.parametrize(("total", "colors"), [(0, 1), (1, 1), (17, 3), (18, 3), (19, 4)])
def test_totals_are_spread_evenly(total: int, colors: int) -> None:
    counts = face_counts(total, colors)
    assert counts.shape == (3, colors)
    assert np.all(counts.sum(axis=0) == total)
    assert counts.max() - counts.min() <= 1
    if colors == 3:
        assert np.all(counts.sum(axis=1) == total)
    faces = mirrored_faces(np.random.default_rng(0), total, 0.14, colors)
    assert [[len(p) for p in axis] for axis in faces] == counts.tolist()


def test_failure_names_the_best_total_and_a_way_out() -> None:
    spacing = 0.125
    wish = math.floor(0.6966 / spacing**2)  # a lone face holds that, three together do not
    with pytest.raises(DesignError, match=f"of {3 * wish} face pores") as caught:
        mirrored_faces(np.random.default_rng(0), 3 * wish, spacing)
    best = int(caught.value.message.split()[1])
    assert 0.8 < best / (3 * wish) < 0.95
    hint = caught.value.hint
    assert hint is not None
    realistic, closer = int(hint.split("at most ")[1].split()[0]), float(hint.split("about ")[1].split()[0])
    mirrored_faces(np.random.default_rng(1), 3 * realistic, spacing)
    mirrored_faces(np.random.default_rng(1), 3 * wish, closer)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((1500, 0.1), "do not fit"),
        ((3, 0.0), r"\(0, 1\]"),
        ((3, 1.2), r"\(0, 1\]"),
        ((3, 1.0, 2), "no face"),
    ],
)
def test_impossible_wishes(arguments: tuple, words: str) -> None:
    with pytest.raises(DesignError, match=words):
        mirrored_faces(np.random.default_rng(0), *arguments)
