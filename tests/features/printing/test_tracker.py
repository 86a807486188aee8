"""Cups, traps and islands: against labels of every half-stack, and on bodies with known answers."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from sppm_pipeline.features.printing.numerics import tracker
from sppm_pipeline.features.printing.numerics.tracker import AT_END, AT_PLATE, JOINED, NEVER, Tracker, complement
from sppm_pipeline.method.connectivity.runs import find_runs


def noise(rng, shape):
    return rng.random(shape) < rng.uniform(0.2, 0.8)


def porous(rng, shape):
    field = ndimage.gaussian_filter(rng.standard_normal(shape), 1.2)
    return field > np.quantile(field, rng.uniform(0.3, 0.8))


def shells(rng, shape):
    """Nested closed surfaces with random holes."""
    z, y, x = np.indices(shape)
    r = np.sqrt(sum((a - s / 2 + 0.5) ** 2 for a, s in zip((z, y, x), shape, strict=True)))
    return (np.floor(r * 1.1) % 2 == 0) & (rng.random(shape) > 0.03)


def serpentine(rng, shape):
    """Walls with one passage each, alternately at both ends."""
    solid = np.zeros(shape, bool)
    solid[:, 0] = solid[:, -1] = True
    solid[:, :, 0] = solid[:, :, -1] = True
    axis = int(rng.integers(3))
    walls = np.moveaxis(solid, axis, 0)
    for i in range(0, shape[axis], 2):
        walls[i] = True
        gap = (0, -1)[(i // 2) % 2] if rng.random() < 0.9 else slice(0, 0)
        walls[i, gap] = False
    return solid


def turned_tube(rng, shape):
    """Solid with a spiral tunnel that may or may not come out."""
    solid = np.ones(shape, bool)
    for t in np.linspace(0, rng.uniform(4, 12), 400):
        z = int(shape[0] * t / 10)
        y, x = (int(s / 2 + s / 3 * f(3 * t)) for s, f in ((shape[1], np.sin), (shape[2], np.cos)))
        if z < shape[0]:
            solid[z, y, x] = False
    return np.roll(solid, int(rng.integers(-2, 3)), 0)


BODIES = (noise, porous, shells, serpentine, turned_tube)


def tracked(solid, plate):
    """Loose pixels of solid and void in each layer, by the tracker, and the events."""
    trackers = {"solid": Tracker("solid"), "void": Tracker("void", plate)}
    filled = np.flatnonzero(solid.any((1, 2)))
    ground = filled[0] if len(filled) else len(solid)
    counts = []
    for k, layer in enumerate(solid):
        runs = find_runs(layer[None].view(np.uint8))
        if k >= ground:
            counts.append((trackers["solid"].add(runs, k), trackers["void"].add(complement(runs), k)))
        else:
            counts.append(None)
    return counts, trackers["solid"].finish(len(solid)), trackers["void"].finish(len(solid))


def labeled(solid, plate):
    """The same by labels of every half-stack; the events as sets of (kind, birth, end, volume)."""
    filled = np.flatnonzero(solid.any((1, 2)))
    ground = filled[0] if len(filled) else len(solid)
    loose = []
    for k in range(ground, len(solid)):
        half = solid[ground : k + 1]
        labels, n = ndimage.label(half)
        hanging = ~np.isin(np.arange(n + 1), labels[0]) & (np.arange(n + 1) > 0)
        closed, n = ndimage.label(~half)
        rims = [closed[:, 0], closed[:, -1], closed[:, :, 0], closed[:, :, -1]]
        if plate == "supports":
            rims.append(closed[0])
        ambient = np.unique(np.concatenate([rim.ravel() for rim in rims]))
        shut = ~np.isin(np.arange(n + 1), ambient) & (np.arange(n + 1) > 0)
        loose.append((int(hanging[labels[-1]].sum()), int(shut[closed[-1]].sum())))
    part = solid[ground:]
    labels, n = ndimage.label(~part)
    rims = [labels[:, 0], labels[:, -1], labels[:, :, 0], labels[:, :, -1]] if n else []
    kinds = {}
    for c in range(1, n + 1):
        here = labels == c
        open_ = any((rim == c).any() for rim in rims)
        if not open_ and not (plate == "supports" and here[0].any()):
            kinds.setdefault(AT_END if here[-1].any() else AT_PLATE if here[0].any() else NEVER, []).append(here.sum())
    labels, n = ndimage.label(part)
    floating = [int((labels == c).sum()) for c in range(1, n + 1) if not (labels[0] == c).any()]
    return loose, {kind: sorted(volumes) for kind, volumes in kinds.items()}, sorted(floating)


@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize("plate", ["sealed", "supports"])
def test_every_half_stack_is_that_of_labels(body, plate):
    rng = np.random.default_rng(5)
    for _ in range(20):
        shape = tuple(int(n) for n in rng.integers(3, 14, 3))
        solid = np.ascontiguousarray(body(rng, shape))
        if rng.random() < 0.3:
            solid[: int(rng.integers(0, 3))] = False
        counts, islands, cups = tracked(solid, plate)
        loose, closed, floating = labeled(solid, plate)
        assert [(s.loose, v.loose) for s, v in filter(None, counts)] == loose
        found = {kind: sorted(cups.volume[cups.kind == kind]) for kind in (NEVER, AT_PLATE, AT_END)}
        # a component that is still open at the end is one event
        assert {kind: volumes for kind, volumes in found.items() if volumes} == closed
        assert sorted(islands.volume[islands.kind == NEVER]) == floating


def test_a_layer_by_itself_is_measured():
    solid = porous(np.random.default_rng(1), (6, 30, 40))
    counts, _, _ = tracked(np.ascontiguousarray(solid), "sealed")
    for layer, (count, rest) in zip(solid, counts, strict=True):
        sizes = np.bincount(ndimage.label(layer)[0].ravel())[1:]
        around = np.pad(layer, 1).astype(int)
        assert (count.components, count.largest, count.area) == (len(sizes), sizes.max(), layer.sum())
        assert count.edges_x == np.abs(np.diff(around, axis=0)).sum()
        assert count.edges_y == np.abs(np.diff(around, axis=1)).sum()
        assert rest.area == (~layer).sum()


def events(solid, plate="sealed"):
    _, islands, cups = tracked(np.ascontiguousarray(solid), plate)
    return [
        list(zip(*(column.tolist() for column in (e.kind, e.birth, e.end, e.volume, e.section)), strict=True))
        for e in (islands, cups)
    ]


def test_a_closed_ball_is_one_trap():
    z, y, x = np.indices((21, 21, 21)) - 10
    r = np.sqrt(z * z + y * y + x * x)
    hollow = r < 7
    islands, cups = events((r <= 9) & ~hollow)
    # the ball begins as a disk, of which nothing is an island
    assert islands == []
    assert cups == [(NEVER, 4, 17, int(hollow.sum()), int(hollow[10].sum()))]


def test_cups_that_open_upwards_downwards_and_not_at_all():
    box = np.zeros((10, 9, 9), bool)
    box[1:, 1:-1, 1:-1] = True
    up, down = box.copy(), box.copy()
    up[3:, 3:6, 3:6] = False
    assert events(up)[1] == [(AT_END, 3, 10, 7 * 9, 9)]
    down[1:8, 3:6, 3:6] = False
    assert events(down)[1] == [(AT_PLATE, 1, 8, 7 * 9, 9)]
    assert events(down, "supports")[1] == []
    down[6, 4, 6:] = False  # a vent: the cup sucks until it is reached
    assert events(down)[1] == [(JOINED, 1, 6, 5 * 9, 9)]


def test_a_tube_bent_like_a_u_is_a_cup_until_its_second_leg_is_open():
    block = np.ones((8, 5, 11), bool)
    block[2:, 2, 2] = block[2:, 2, 8] = False
    block[2, 2, 2:9] = False
    assert events(block)[1] == [(AT_END, 2, 8, 7 + 5 + 5, 7)]
    block[5, 2, 8:] = False
    assert events(block)[1] == [(JOINED, 2, 5, 7 + 2 + 2, 7)]


def test_a_table_has_three_islands_if_it_is_printed_upside_down_on_one_leg():
    table = np.zeros((8, 9, 9), bool)
    for height, (y, x) in zip((0, 2, 2, 3), ((0, 0), (0, 8), (8, 0), (8, 8)), strict=True):
        table[height:7, y, x] = True
    table[7] = True
    assert sorted(events(table)[0]) == [(JOINED, 2, 7, 5, 1), (JOINED, 2, 7, 5, 1), (JOINED, 3, 7, 4, 1)]


def test_two_sweeps_over_neighboring_layers_do_not_see_what_turns():
    """A passage that goes up, over and down again: its far end lies below the place where it comes out."""
    block = np.ones((9, 5, 13), bool)
    block[2:7, 2, 2] = False
    block[6, 2, 2:7] = False
    block[2:7, 2, 6] = False
    block[2, 2, 6:] = False
    # while it is printed there are two cups; the second one is open from the start
    assert events(block)[1] == [(JOINED, 2, 6, 4, 1)]


def test_solid_that_meets_along_an_edge_does_not_hold():
    steps = np.zeros((2, 2, 2), bool)
    steps[0, 0, 0] = steps[1, 1, 0] = True
    assert events(steps)[0] == [(NEVER, 1, 2, 1, 1)]


def test_nothing_and_everything():
    assert events(np.zeros((3, 4, 5), bool)) == [[], []]
    assert events(np.ones((3, 4, 5), bool)) == [[], []]
    assert events(np.ones((1, 1, 1), bool)) == [[], []]


def test_of_many_events_the_largest_are_listed(monkeypatch):
    monkeypatch.setattr(tracker, "MAX_LISTED", 3)
    solid = np.zeros((20, 3, 12), bool)
    solid[0, 0, 0] = True
    for i in range(8):
        solid[2 * i + 1 : 2 * i + 2, 1, : i + 2] = True
    _, islands, _ = tracked(np.ascontiguousarray(solid), "sealed")
    assert islands.counts[NEVER] == 8
    assert islands.totals[NEVER] == sum(range(2, 10))
    assert list(islands.volume[:3]) == [9, 8, 7]


@pytest.mark.parametrize("births", [(2, 4), (4, 2)])
def test_cups_that_meet_are_one_from_the_first_of_them_on(births):
    block = np.ones((9, 5, 11), bool)
    for birth, x in zip(births, (2, 8), strict=True):
        block[birth:7, 2, x] = False
    block[6, 2, 2:9] = False
    volume = sum(7 - birth for birth in births) + 5
    assert events(block)[1] == [(NEVER, 2, 7, volume, 7)]
