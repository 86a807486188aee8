"""Pores on edges and corners: each owned once, spaced from all they may meet, evenly used, and as many as is level."""

import itertools

import numpy as np
import pytest

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.sampling import edges
from sppm_pipeline.method.sampling.edges import (
    MAX_GAP,
    chosen_sites,
    edge_sites,
    homogeneous_counts,
    homogeneous_design,
    homogeneous_faces,
    intervals,
)


def rng(seed=1):
    return np.random.default_rng(seed)


@pytest.mark.parametrize("spacing", [0.04, 0.1, 0.18, 0.3, 0.45, 0.5, 0.55, 0.7, 0.95])
def test_sites_are_neither_too_near_nor_too_far(spacing):
    for seed in range(20):
        sites = edge_sites(rng(seed), spacing)
        gaps = np.diff([*sites, 1.0])
        assert sites[0] == 0.0
        assert len(sites) == intervals(spacing)
        assert gaps.min() >= spacing - 1e-12
        if spacing <= 0.5:  # beyond, only the corner has room
            assert gaps.max() <= MAX_GAP * spacing + 1e-9


def test_pairs_of_intervals_are_drawn_as_whole_divisions_are(monkeypatch):
    whole = np.array([edge_sites(rng(seed), 0.13) for seed in range(800)])
    monkeypatch.setattr(edges, "REJECTED", 0)
    pairs = np.array([edge_sites(rng(seed), 0.13) for seed in range(800)])
    for made in (whole, pairs):
        assert np.abs(made.mean(0) - np.arange(made.shape[1]) / made.shape[1]).max() < 0.01
    assert pairs.std(0)[1:] == pytest.approx(whole.std(0)[1:], rel=0.12)


@pytest.mark.parametrize(
    ("sites", "colors", "share"), [(4, 3, 0.65), (1, 3, 0.5), (5, 1, 0.3), (0, 2, 0.5), (3, 16, 0.9)]
)
def test_every_site_is_used_equally_often(sites, colors, share):
    for seed in range(5):
        chosen = chosen_sites(rng(seed), sites, colors, share)
        assert chosen.shape == (colors, sites)
        used = chosen.sum(0)
        assert ((used == np.floor(share * colors)) | (used == np.ceil(share * colors))).all()
        assert abs(chosen.sum() - share * sites * colors) < 1


def test_choices_are_unbiased():
    chosen = np.array([chosen_sites(rng(seed), 4, 3, 0.65) for seed in range(600)])
    assert np.abs(chosen.mean(0) - 0.65).max() < 5 * np.sqrt(0.65 * 0.35 / 600)


def lattice_pores(patterns, colors_at):
    """All face, edge and corner pores of a periodic lattice of 2 x 2 x 2 cells."""
    sites = list(itertools.product(range(2), repeat=3))
    return np.concatenate(
        [patterns[axis][colors_at[axis][site]] + np.array(site) for axis in range(3) for site in sites]
    )


@pytest.mark.parametrize("colors", [(1, 1, 1), (3, 3, 3), (2, 3, 1), (20, 20, 20)])
def test_any_assembly_keeps_the_spacing(colors):
    """Patterns of any colors side by side: across faces, edges and corners."""
    spacing = 0.2
    generator = rng(3)
    patterns = homogeneous_faces(generator, 55.0, spacing, colors)
    owned = [[((p == 0).sum(1) > 1) for p in per_axis] for per_axis in patterns]
    assert all(
        (p[:, axis] == 0).all() and (p >= 0).all() and (p < 1).all() for axis in range(3) for p in patterns[axis]
    )
    assert sum(int(o.sum()) for per_axis in owned for o in per_axis) > 0
    for _ in range(4):
        layout = [generator.integers(colors[axis], size=(2, 2, 2)) for axis in range(3)]
        pores = lattice_pores(patterns, layout)
        gap = np.abs(pores[:, None] - pores[None])
        gap = np.minimum(gap, 2 - gap)
        distance = np.sqrt((gap**2).sum(-1))
        np.fill_diagonal(distance, np.inf)
        assert distance.min() >= spacing - 1e-9


def test_each_edge_has_one_owner():
    patterns = homogeneous_faces(rng(4), 400.0, 0.1, (1, 1, 1))
    owners = {}
    for axis in range(3):
        (pattern,) = patterns[axis]
        for zeros in {tuple(z) for z in (pattern == 0).tolist() if sum(z) > 1}:
            owners.setdefault(zeros, []).append(axis)
    # the edge along x has y = z = 0, and so on
    edges = {(False, True, True): [1], (True, False, True): [2], (True, True, False): [0]}
    assert {zeros: who for zeros, who in owners.items() if sum(zeros) == 2} == edges
    assert owners.get((True, True, True), [0]) == [0]


@pytest.mark.parametrize(("total", "share"), [(20, 0.3), (68, 0.6), (150, 0.8), (8, 0.2)])
def test_designs_agree_whatever_is_given(total, share):
    pores, spacing = homogeneous_design(total=total, face_count=None, spacing=None, share=share)
    assert pores == total or share * 100 > 0
    again, _ = homogeneous_design(total=None, face_count=None, spacing=spacing, share=share)
    assert again == pytest.approx(total, rel=1e-6)
    inside, on_edges = homogeneous_counts(total, spacing)
    assert inside + on_edges < total
    assert inside >= min(3, total / 2)
    faces = round(inside + on_edges)
    back, same = homogeneous_design(total=None, face_count=faces, spacing=spacing, share=None)
    assert same == spacing
    assert sum(homogeneous_counts(back, spacing)) == pytest.approx(faces, rel=1e-6)


def test_what_does_not_fit_is_said():
    with pytest.raises(DesignError, match="half a cell"):
        homogeneous_design(total=2, face_count=None, spacing=None, share=1.0)
    with pytest.raises(DesignError, match="face pores fit"):
        homogeneous_faces(rng(), 68.0, 0.18, (3, 3, 3), face_count=90)
    with pytest.raises(DesignError, match="border"):
        homogeneous_faces(rng(), 2.0, 0.8, (20, 20, 20))
    with pytest.raises(DesignError, match=r"\(0, 1\)"):
        homogeneous_faces(rng(), 2.0, 1.0, (1, 1, 1))


def test_the_same_seed_gives_the_same_pores():
    first, second = (homogeneous_faces(rng(9), 68.0, 0.18, (3, 3, 3)) for _ in range(2))
    assert all(np.array_equal(a, b) for x, y in zip(first, second, strict=True) for a, b in zip(x, y, strict=True))
