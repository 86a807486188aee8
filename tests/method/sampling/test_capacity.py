"""Capacity formulas: exact values, inverse, and against measured saturation."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.sampling.capacity import box_capacity, check_capacity, face_capacity, largest_spacing
from sppm_pipeline.method.sampling.darts import throw
from sppm_pipeline.method.sampling.faces import mirrored_faces


def test_formulas_of_the_method() -> None:
    assert box_capacity(0.6, 0.1) == pytest.approx(0.7336 * 6.64**3)
    assert box_capacity((0.6, 0.4, 0.5), 0.1) == pytest.approx(0.7336 * 6.64 * 4.64 * 5.64)
    assert box_capacity((1.0, 1.0, 0.0), 0.1) == pytest.approx(0.6966 * 10.64**2)
    assert box_capacity(1.0, 0.1, True) == pytest.approx(733.6)
    assert box_capacity(1.0, 0.1, (True, False, True)) == pytest.approx(0.7336 * 100 * 10.64)
    assert box_capacity((1.0, 0.5, 0.0), 0.1, (True, False, False)) == pytest.approx(0.6966 * 10 * 5.64)


def test_jammed_fractions() -> None:
    spacing = 0.01
    assert box_capacity(1.0, spacing, True) * math.pi / 6 * spacing**3 == pytest.approx(0.3841, rel=1e-3)
    assert box_capacity((1.0, 1.0, 0.0), spacing, (True, True, False)) * math.pi / 4 * spacing**2 == pytest.approx(
        0.5470, rel=1e-3
    )


def test_flat_and_small_boxes() -> None:
    assert box_capacity((1.0, 0.0, 1.0), 0.1) == box_capacity((1.0, 1.0, 0.0), 0.1)
    assert box_capacity((1.0, 1.0, 1e-6), 0.1) == pytest.approx(box_capacity((1.0, 1.0, 0.0), 0.1))
    assert box_capacity(0.0, 0.1) == 1.0
    assert box_capacity(0.1, 5.0) == 1.0
    assert box_capacity(1.0, 1.1, True) == 0.0
    assert box_capacity(1.0, 0.0) == math.inf


@pytest.mark.parametrize("spacing", [0.4, 0.3, 0.2, 0.1])
@pytest.mark.parametrize("wraps", [False, True])
@pytest.mark.parametrize("dimension", [2, 3])
def test_formula_against_measured_saturation(spacing: float, wraps: bool, dimension: int) -> None:
    upper = [1.0, 1.0, 1.0 if dimension == 3 else 0.0]
    counts = [
        len(throw(np.random.default_rng(seed), None, spacing, [0.0] * 3, upper, periodic=(wraps,) * 3, share=1.0))
        for seed in range(round(60 * spacing))
    ]
    capacity = box_capacity(upper, spacing, wraps)
    # Three standard errors of the measured mean come on top of the 5 % of the formula: .3 sqrt(n) wander a count.
    noise = 3 * 0.35 * math.sqrt(capacity / len(counts))
    assert abs(float(np.mean(counts)) - capacity) < 0.05 * capacity + noise


@pytest.mark.parametrize(
    ("spacing", "colors", "margin"), [(0.25, 1, None), (0.12, 1, 0.03), (0.2, 3, None), (0.1, 2, 0.08)]
)
def test_face_capacity_against_measured_saturation(spacing: float, colors: int, margin: float | None) -> None:
    capacity = face_capacity(spacing, colors, margin)
    for seed in range(3):
        with pytest.raises(DesignError):
            mirrored_faces(np.random.default_rng(seed), 3 * math.ceil(1.12 * capacity), spacing, colors, margin)
    for seed in range(3):
        mirrored_faces(np.random.default_rng(seed), 3 * math.floor(0.88 * capacity), spacing, colors, margin)


@settings(deadline=None, derandomize=True, max_examples=60)
@given(
    count=st.integers(2, 5000),
    sides=st.lists(st.floats(0.1, 1.0), min_size=1, max_size=3),
    wraps=st.booleans(),
)
def test_largest_spacing_inverts_capacity(count: int, sides: list[float], wraps: bool) -> None:
    spacing = largest_spacing(count, sides, periodic=wraps)
    padded = [*sides, 0.0, 0.0][:3]
    assert box_capacity(padded, spacing * (1 - 1e-9), wraps) >= count
    if not (wraps and spacing > 0.999):
        assert box_capacity(padded, spacing * (1 + 1e-9), wraps) < count


def test_largest_spacing_of_one_pore() -> None:
    assert largest_spacing(1, (1.0, 1.0, 1.0)) == math.inf
    assert largest_spacing(1, (1.0, 1.0, 1.0), periodic=True) == 1.0


def test_above_the_capacity_is_refused_with_numbers() -> None:
    capacity = box_capacity(1.0, 0.2)
    assert check_capacity(math.floor(capacity), 0.2, (1.0, 1.0, 1.0)) == pytest.approx(math.floor(capacity) / capacity)
    wish = math.ceil(capacity) + 1
    with pytest.raises(DesignError) as caught:
        check_capacity(wish, 0.2, (1.0, 1.0, 1.0))
    assert str(wish) in caught.value.message
    assert f"{capacity:.1f}" in caught.value.message
    assert caught.value.hint is not None
    assert f"{largest_spacing(wish, (1.0, 1.0, 1.0)):.4g}" in caught.value.hint


def test_own_image_is_named() -> None:
    with pytest.raises(DesignError, match="image"):
        check_capacity(1, 1.2, (1.0, 1.0, 1.0), periodic=True)
