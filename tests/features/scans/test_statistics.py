"""Statistics of images against counts by definition, bodies and the closed forms of random ones."""

import math

import numpy as np
import pytest

from sppm_pipeline.errors import DesignError
from sppm_pipeline.features.scans.numerics import statistics as st
from sppm_pipeline.features.scans.numerics.describing import balls_of, curves_of, entry_of
from sppm_pipeline.features.scans.numerics.stretching import stretch_of
from sppm_pipeline.features.scans.stages.measure_statistics import MeasureStatistics
from sppm_pipeline.method.nouns.voxels import Voxels
from sppm_pipeline.numerics import find_components, paint_runs
from sppm_pipeline.testing.plain_context import PlainContext
from tests.features.scans.test_image_field import ball, centers


def labels_of(phase, wraps):
    found = find_components(phase.T, (wraps,) * 3)
    labels = np.zeros(phase.T.shape, np.int32)
    paint_runs(found.runs.rows, found.runs.bounds, found.of_run + 1, labels)
    return labels.T


def spheres(n, radius, share, seed=0):
    """Overlapping balls in a periodic box that fill about a share, (n, n, n) bool."""
    rng = np.random.default_rng(seed)
    volume = 4 / 3 * math.pi * radius**3
    count = rng.poisson(-math.log(1 - share) / volume * n**3)
    solid = np.zeros((n, n, n), bool)
    r = math.ceil(radius) + 1
    for center in rng.uniform(0, n, (count, 3)):
        base = np.floor(center).astype(int)
        axes = [base[a] + np.arange(-r, r + 1) for a in range(3)]
        d = [(axis + 0.5 - c) ** 2 for axis, c in zip(axes, center, strict=True)]
        near = d[0][:, None, None] + d[1][:, None] + d[2] < radius**2
        solid[np.ix_(*(axis % n for axis in axes))] |= near
    return solid


@pytest.mark.parametrize("wraps", [False, True])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_curves_along_an_axis_are_what_counting_finds(wraps, axis):
    rng = np.random.default_rng(3)
    phase = rng.random((9, 10, 11)) < 0.6
    phase[:, 3, 4] = phase[2, :, 5] = phase[1, 2] = True
    labels = labels_of(phase, wraps)
    found = st.along_axis(labels.T, axis, 5, wraps)
    rows = np.moveaxis(labels, axis, 2).reshape(-1, labels.shape[axis])
    n = rows.shape[1]
    for r in range(6):
        at = np.arange(n if wraps else n - r)
        ends = rows[:, at], rows[:, (at + r) % n]
        both = (ends[0] > 0) & (ends[1] > 0)
        line = np.all([rows[:, (at + i) % n] > 0 for i in range(r + 1)], axis=0)
        assert found.pairs[r] == pytest.approx(both.mean())
        assert found.cluster[r] == pytest.approx((both & (ends[0] == ends[1])).mean())
        assert found.path[r] == pytest.approx(line.mean())
    if not wraps:
        inside = []
        for row in rows > 0:
            edges = np.flatnonzero(np.diff(np.concatenate([[0], row, [0]])))
            inside += [b - a for a, b in edges.reshape(-1, 2) if a > 0 and b < n]
        assert found.chords.tolist() == np.bincount(inside, minlength=n + 1).tolist()


@pytest.mark.parametrize("wraps", [False, True])
def test_radial_pairs_are_what_counting_finds(wraps):
    phase = np.random.default_rng(5).random((8, 9, 10)) < 0.4
    at, found, rest = st.radial_pairs(phase, 3, wraps)
    assert rest == pytest.approx(st.radial_pairs(~phase, 3, wraps)[1], abs=1e-5)
    assert at[0] == 0
    assert at[2] == pytest.approx(2, abs=0.3)
    total, weight = np.zeros(4), np.zeros(4)
    for step in np.ndindex(7, 7, 7):
        step = np.array(step) - 3
        if wraps:
            value = np.mean(phase & np.roll(phase, step, (0, 1, 2)))
        else:
            cut = [slice(max(0, s), n + min(0, s)) for s, n in zip(step, phase.shape, strict=True)]
            other = [slice(max(0, -s), n + min(0, -s)) for s, n in zip(step, phase.shape, strict=True)]
            value = np.mean(phase[tuple(cut)] & phase[tuple(other)])
        length = np.linalg.norm(step)
        k = int(length)
        if k < 3:
            for shell, share in ((k, 1 - length + k), (k + 1, length - k)):
                total[shell] += share * value
                weight[shell] += share
    assert found == pytest.approx(total / weight, abs=1e-6)
    assert found[0] == pytest.approx(phase.mean(), abs=1e-6)


def test_a_ball_has_the_minkowski_numbers_of_a_ball():
    n, radius = 64, 0.36
    numbers = st.minkowski(st.configurations(ball(n, radius) < 0, False), (1 / n,) * 3)
    assert numbers.volume == pytest.approx(4 / 3 * math.pi * radius**3, rel=0.06)  # patterns lie inside
    scale = ((n - 1) / n) ** 3
    assert numbers.surface * scale == pytest.approx(4 * math.pi * radius**2, rel=0.01)
    assert numbers.curvature * scale == pytest.approx(4 * math.pi * radius, rel=0.01)
    assert numbers.euler * scale == pytest.approx(1)


def test_euler_numbers_of_rings_shells_and_parts_that_touch():
    x, y, z = (axis - 0.5 for axis in centers(32))
    ring = (np.hypot(x, y) - 0.3) ** 2 + z**2 < 0.1**2
    shell = (np.sqrt(x * x + y * y + z * z) < 0.4) & (np.sqrt(x * x + y * y + z * z) > 0.2)
    touching = np.zeros((6, 6, 6), bool)
    touching[2, 2, 2] = touching[3, 3, 3] = True  # at a corner only: two parts
    for phase, euler in ((ring, 0), (shell, 2), (touching, 2)):
        counts = st.configurations(phase, True)
        assert st.minkowski(counts, (1.0,) * 3).euler * phase.size == pytest.approx(euler)


def test_fabric_of_a_stretched_structure():
    """Mean intercepts of stretched overlapping balls are longer by the stretch, exactly."""
    solid = spheres(96, 6, 0.3, seed=1)
    lengths, axes = st.fabric(st.configurations(solid, True), (1.0, 1.0, 1.7))
    assert lengths[0] / lengths[1:] == pytest.approx([1.7, 1.7], rel=0.05)
    assert abs(axes[0][2]) == pytest.approx(1, abs=0.01)
    # in a plane of lamellae there is no intercept along two axes
    lamellae = np.zeros((8, 8, 8), bool)
    lamellae[:4] = True
    assert np.isnan(st.fabric(st.configurations(lamellae, True), (1.0,) * 3)[0]).all()
    # so that nothing says how it is stretched
    found = MeasureStatistics().run(PlainContext(), Voxels.from_array(lamellae.repeat(2, 1).repeat(2, 2).repeat(2, 0)))
    assert np.isnan(found.stretch).all()
    assert np.isnan(stretch_of(np.array([np.inf, 2.0, 1.0]), np.eye(3))[0]).any()


def test_overlapping_balls_have_the_curves_of_the_closed_form():
    """S2 of the void is exp(-eta v2(r) / v1), its lineal path (1 - share)^(1 + 3 r / (4 R)); Torquato 2002, ch. 5."""
    n, radius, share = 128, 6.0, 0.4
    solid = spheres(n, radius, share, seed=2)
    eta = -math.log(1 - float(solid.mean()))
    r = np.arange(25.0)
    report = MeasureStatistics(subcubes=2, distance=24).run(PlainContext(), Voxels.from_array(solid, periodic=True))
    both = report.curves["void.S2"]
    x = np.minimum(n * both[:, 0] / (2 * radius), 1)
    assert both[:, 1] == pytest.approx(np.exp(-eta * (1 + 1.5 * x - 0.5 * x**3)), abs=0.006)
    assert report.curves["void.path"][:, 1] == pytest.approx(np.exp(-eta * (1 + 0.75 * r / radius)), abs=0.006)
    assert (report.curves["void.cluster"][:, 1] <= report.curves["void.S2"][:, 1] + 0.01).all()
    # area per volume: eta (1 - share) 3 / R, less the edges between balls that steps of a voxel cut short
    assert report.surface / n == pytest.approx(eta * math.exp(-eta) * 3 / radius, rel=0.07)
    steps = np.linalg.norm(st.DIRECTIONS, axis=1)
    pairs = np.exp(-eta * (1 + 0.75 * steps / radius - 0.0625 * (steps / radius) ** 3))
    cut = 4 * st._weights((1.0,) * 3) @ ((math.exp(-eta) - pairs) / steps)
    assert report.surface / n == pytest.approx(cut, rel=0.025)
    assert 0 < report.porosity_error < 0.05
    assert report.summary()["void"]["connected"] > 0.99


def test_chords_and_sizes_of_lamellae():
    solid = np.zeros((48, 48, 48), bool)
    for start in range(4, 48, 16):
        solid[start : start + 8] = True
    curves = curves_of(solid, 12, True)
    assert curves.mean_chords[0] == 8
    assert math.isnan(curves.mean_chords[1])
    assert balls_of(solid, True, 2).mean == pytest.approx(8, abs=0.1)


def test_balls_enter_as_wide_as_the_neck():
    void = np.zeros((40, 21, 21), bool)
    void[:12] = True  # open at the side
    void[12:20, 8:13, 8:13] = True  # a neck of 5 voxels
    void[20:34, 3:18, 3:18] = True  # a chamber behind it
    size = st.entry_sizes(np.where(void, 1, 0).astype(np.int32).T)
    assert (size.T > 0).tolist() == void.tolist()
    low, _, high = entry_of(void)
    assert low == pytest.approx(5, abs=1)
    assert high > 10
    closed = void.copy()
    closed[:20] = False
    assert entry_of(closed) == (0, 0, 0)


def test_images_without_statistics_are_refused():
    with pytest.raises(DesignError, match="8 x 8 x 8 voxels is too small"):
        MeasureStatistics().run(PlainContext(), Voxels.from_array(np.ones((8, 8, 8))))
    with pytest.raises(DesignError, match="all solid"):
        MeasureStatistics().run(PlainContext(), Voxels.from_array(np.ones((16, 16, 16))))


def test_a_table_and_the_curves_of_a_report():
    solid = spheres(32, 4, 0.4)
    report = MeasureStatistics().run(PlainContext(), Voxels.from_array(solid))
    report.check()
    assert report.sides == "open"
    assert report.table("solid.path").columns["distance"][1] == pytest.approx(1 / 32)
    assert len(report.report_charts(report.summary())) == 5
