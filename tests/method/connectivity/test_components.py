"""Labels, wrapping and spanning against a breadth-first search over single voxels."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from sppm_pipeline.method.connectivity.components import find_components, phase_report


def slow_components(mask, periodic, connectivity):
    """[(voxels, wraps)] by walking from voxel to voxel and keeping count of the cells that were crossed."""
    mask = np.asarray(mask) != 0
    nz, ny, nx = mask.shape
    size = (nx, ny, nz)
    steps = [s for s in itertools.product((-1, 0, 1), repeat=3) if any(s)]
    if connectivity == 6:
        steps = [s for s in steps if sum(map(abs, s)) == 1]
    cell_of = {}
    found = []
    for z, y, x in zip(*np.nonzero(mask), strict=True):
        if (x, y, z) in cell_of:
            continue
        cell_of[x, y, z] = (0, 0, 0)
        queue, wraps = [(x, y, z)], [False] * 3
        for here in queue:
            for step in steps:
                raw = [h + s for h, s in zip(here, step, strict=True)]
                cross = [r // n for r, n in zip(raw, size, strict=True)]
                if any(c and not p for c, p in zip(cross, periodic, strict=True)):
                    continue
                there = tuple(r % n for r, n in zip(raw, size, strict=True))
                if not mask[there[2], there[1], there[0]]:
                    continue
                cell = tuple(a + b for a, b in zip(cell_of[here], cross, strict=True))
                if there not in cell_of:
                    cell_of[there] = cell
                    queue.append(there)
                else:
                    wraps = [w or a != b for w, a, b in zip(wraps, cell, cell_of[there], strict=True)]
        found.append((queue, wraps))
    return sorted(found, key=lambda c: -len(c[0]))


@settings(deadline=None, derandomize=True, max_examples=150)
@given(
    st.integers(0, 2**32 - 1),
    st.tuples(st.integers(1, 5), st.integers(1, 5), st.integers(1, 6)),
    st.floats(0.1, 0.9),
    st.tuples(st.booleans(), st.booleans(), st.booleans()),
    st.sampled_from([6, 26]),
)
def test_components_equal_a_walk_over_voxels(label, seed, shape, share, periodic, connectivity):
    mask = np.random.default_rng(seed).random(shape) < share
    expected = slow_components(mask, periodic, connectivity)
    labels, sizes = label(mask, periodic, connectivity)
    assert sizes.tolist() == [len(voxels) for voxels, _ in expected]
    wanted = np.zeros(shape, np.int32)
    for number, (voxels, _) in enumerate(expected):
        for x, y, z in voxels:
            wanted[z, y, x] = number + 1
    np.testing.assert_array_equal(labels, wanted)
    found = find_components(mask, periodic, connectivity)
    assert found.wraps.tolist() == [wraps for _, wraps in expected]
    for (voxels, _), faces in zip(expected, found.faces, strict=True):
        v = np.array(voxels)
        last = np.array(shape[::-1]) - 1
        low, high = (v == 0).any(axis=0), (v == last).any(axis=0)
        assert faces.tolist() == [bool(f) for pair in zip(low, high, strict=True) for f in pair]


@settings(deadline=None, derandomize=True, max_examples=150)
@given(st.integers(0, 2**32 - 1), st.integers(3, 9), st.integers(1, 5), st.integers(5, 60), st.sampled_from([6, 26]))
def test_threads_that_cross_the_seams_many_times_wrap_where_the_walk_says(seed, n, walks, length, connectivity):
    """Thin walks on the torus: pieces of the box that only the seams join, with shifts that add up or cancel."""
    rng = np.random.default_rng(seed)
    mask = np.zeros((n, n, n), bool)
    for _ in range(walks):
        position = rng.integers(0, n, 3)
        direction = np.eye(3, dtype=int)[rng.integers(3)] * rng.choice([-1, 1])
        for _ in range(length):
            mask[tuple(position)] = True
            if rng.random() < 0.2:
                direction = np.eye(3, dtype=int)[rng.integers(3)] * rng.choice([-1, 1])
            position = (position + direction) % n
    expected = slow_components(mask, (True, True, True), connectivity)
    found = find_components(mask, (True, True, True), connectivity)
    assert found.sizes.tolist() == [len(voxels) for voxels, _ in expected]
    assert found.wraps.tolist() == [wraps for _, wraps in expected]


@settings(deadline=None, derandomize=True, max_examples=20)
@given(st.integers(0, 2**32 - 1), st.floats(0.1, 0.6), st.sampled_from([6, 26]))
def test_box_labels_equal_scipy_at_a_size_where_rows_span_words(label, seed, share, connectivity):
    mask = np.random.default_rng(seed).random((9, 11, 150)) < share
    structure = ndimage.generate_binary_structure(3, 1 if connectivity == 6 else 3)
    theirs, count = ndimage.label(mask, structure)
    labels, sizes = label(mask, (False, False, False), connectivity)
    assert sizes.size == count
    assert np.unique(np.stack([labels[mask], theirs[mask]]), axis=1).shape[1] == count
    assert (np.diff(sizes) <= 0).all()
    np.testing.assert_array_equal(np.bincount(labels.ravel())[1:], sizes)


def test_shifting_a_torus_changes_no_size_and_no_wrap():
    rng = np.random.default_rng(3)
    mask = ndimage.gaussian_filter(rng.standard_normal((20, 22, 24)), 1.5, mode="wrap") > 0.02
    moved = np.roll(mask, (7, 5, 13), axis=(0, 1, 2))
    for connectivity in (6, 26):
        a, b = (find_components(m, (True, True, True), connectivity) for m in (mask, moved))
        assert a.sizes.tolist() == b.sizes.tolist()
        assert a.wraps[0].tolist() == b.wraps[0].tolist()


def test_numbers_go_by_size_and_then_by_the_first_voxel(label):
    mask = np.zeros((1, 1, 9), np.uint8)
    mask[0, 0, [0, 2, 4, 5, 7]] = 1
    labels, sizes = label(mask, (False, False, False))
    assert labels.tolist() == [[[2, 0, 3, 0, 1, 1, 0, 4, 0]]]
    assert sizes.tolist() == [2, 1, 1, 1]


def test_a_helix_wraps_only_along_its_axis():
    mask = np.zeros((8, 4, 4), bool)
    for step, (y, x) in enumerate([(0, 0), (0, 1), (0, 2), (1, 2), (2, 2), (2, 1), (2, 0), (1, 0)]):
        mask[step, y, x] = True
        mask[(step + 1) % 8, y, x] = True
    report = phase_report(mask)
    assert report.components == 1
    assert report.wraps == (False, False, True)


def test_a_diagonal_loop_wraps_along_both_axes_together():
    mask = np.eye(6, dtype=bool)[None]
    assert phase_report(mask, (True, True, False), 26).wraps == (True, True, True)
    assert phase_report(np.concatenate([mask, mask * False]), (True, True, True), 26).wraps == (True, True, False)
    assert phase_report(mask, (True, True, False), 6).components == 6


def test_a_wall_wraps_along_it_and_spans_where_the_box_ends():
    mask = np.zeros((5, 6, 7), np.uint8)
    mask[:, 2, :] = 9
    assert phase_report(mask).wraps == (True, False, True)
    assert phase_report(mask, (False, False, False)).wraps == (True, False, True)
    mask[:, 2, -1] = 0
    assert phase_report(mask).wraps == (False, False, True)
    assert phase_report(mask, (False, True, False)).wraps == (False, False, True)
    void = phase_report(mask, zeros=True)
    assert void == phase_report(mask == 0)
    assert void.components == 1
    assert void.wraps == (True, True, True)


def test_shares_of_the_phase():
    mask = np.zeros((3, 3, 8), bool)
    mask[1, 1, [1, 2, 3, 5]] = True
    report = phase_report(mask)
    assert (report.components, report.largest_share, report.removed_share) == (2, 0.75, 0.25)


@pytest.mark.parametrize("connectivity", [6, 26])
def test_empty_and_full(label, connectivity):
    empty = np.zeros((3, 4, 5), bool)
    assert phase_report(empty, connectivity=connectivity) == (0, 0.0, (False, False, False), 0.0)
    assert phase_report(~empty, connectivity=connectivity) == (1, 1.0, (True, True, True), 0.0)
    assert label(empty)[1].size == 0
