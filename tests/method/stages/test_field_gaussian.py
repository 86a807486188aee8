"""Sizes: radii and parameters say the same, in cell sizes, in the paper's cell, and in mm."""

import math
from pathlib import Path

import numpy as np
import pytest

from sppm_pipeline.engine.config.options import options_of, parse_typed, plain_option
from sppm_pipeline.errors import ConfigError
from sppm_pipeline.method.nouns.pores import PoreSet
from sppm_pipeline.method.nouns.tunnels import TunnelGraph
from sppm_pipeline.method.stages.field_gaussian import GaussianField
from sppm_pipeline.method.stages.fill_implicit import ImplicitFill
from sppm_pipeline.method.stages.sample_mirrored_faces import MirroredFaces
from sppm_pipeline.method.stages.tile_scattered import ScatteredTiling
from sppm_pipeline.nouns.length import Cell, Length
from sppm_pipeline.services.grid import Grid, cell_centers
from sppm_pipeline.testing.plain_context import PlainContext


def graph(cell):
    centers = np.array([[0.5, 0.5, 0.5], [0.8, 0.5, 0.5]])
    edges = np.array([[0, 1]])
    return TunnelGraph(PoreSet(cell, centers, np.zeros(2, np.int32)), edges, np.zeros((len(edges), 3), int))


def field(cell, **options):
    stage = GaussianField(**options)
    stage.check_options()
    context = PlainContext(1)
    made = stage.run(context, graph(cell))
    made.check()
    return made, context.reported


RADII = {"pore_radius": Length(0.1), "tunnel_radius": Length(0.04)}


def test_a_lone_pore_and_a_lone_tunnel_have_the_radii_asked_for():
    """At the radius the kernel has the value of the level (paper, eq. 1 to 3)."""
    micro, told = field(Cell(), **RADII, level=0.3)
    piece = micro.pieces[0]
    assert math.exp(-piece.omega[0] * 0.1**2) == pytest.approx(0.3)
    assert math.exp(-piece.mu[0] * 0.04) == pytest.approx(0.3)
    assert (told["pore_radius"], told["tunnel_radius"]) == (pytest.approx(0.1), pytest.approx(0.04))
    squared, _ = field(Cell(), **RADII, level=0.3, tunnel="squared")
    assert math.exp(-squared.pieces[0].mu[0] * 0.04**2) == pytest.approx(0.3)


@pytest.mark.parametrize("tunnel", ["linear", "squared"])
def test_the_same_cell_in_all_units(tunnel):
    plain, told = field(Cell(), **RADII, tunnel=tunnel)
    grid = cell_centers(12)
    expected = plain.sample(grid)

    def same(cell, **options):
        made, _ = field(cell, tunnel=tunnel, **options)
        return np.abs(made.sample(grid) - expected).max() < 1e-5

    power = 2 if tunnel == "squared" else 1
    assert same(Cell(), omega=told["omega"], mu=told["mu"])
    assert same(Cell(2.0), pore_radius=Length(0.1, "cell"), tunnel_radius=Length(0.04, "cell"))
    assert same(Cell(2.0), omega=told["omega"] / 4, mu=told["mu"] / 2**power)
    assert same(Cell(7.5, True), pore_radius=Length(0.75, "mm"), tunnel_radius=Length(300, "um"))
    assert same(Cell(7.5, True), **RADII)
    assert told.keys() == {"pore_radius", "tunnel_radius", "omega", "mu"}
    _, told = field(Cell(7.5, True), **RADII, tunnel=tunnel)
    assert (told["pore_radius_mm"], told["tunnel_radius_mm"]) == (pytest.approx(0.75), pytest.approx(0.3))


def test_parameters_without_a_unit_in_a_cell_with_one():
    for name, other, radius in (("omega", "mu", "pore_radius: 0.215"), ("mu", "omega", "tunnel_radius: 0.04621")):
        rest = {"tunnel_radius" if other == "mu" else "pore_radius": Length(0.1)}
        with pytest.raises(ConfigError, match=f"`{name}: 30` has no unit") as caught:
            field(Cell(7.5, True), **{name: 30.0}, **rest)
        assert f"`{radius} mm`" in caught.value.hint
        assert f"`{radius} cell`" in caught.value.hint


def test_the_paper_s_parameters_in_its_cell():
    """omega = mu = 30, C = 0.25 in [-1, 1]^3: pores of 0.1075, tunnels of 0.0231 cell sizes."""
    _, told = field(Cell(2.0), omega=30.0, mu=30.0)
    assert told["pore_radius"] == pytest.approx(0.1075, abs=5e-5)
    assert told["tunnel_radius"] == pytest.approx(0.0231, abs=5e-5)


def test_the_sum_by_hand():
    micro, told = field(Cell(), **RADII)
    grid = Grid((0.4, 0.45, 0.52), (0.07, 0.03, 0.05), (5, 4, 3))
    values = micro.sample(grid)
    x, y, z = np.meshgrid(*(grid.axis(axis) for axis in range(3)), indexing="ij")
    p = np.stack([x, y, z], -1)
    total = np.zeros(p.shape[:3])
    for shift in np.ndindex(3, 3, 3):
        s = np.array(shift) - 1.0
        a, b = np.array([0.5, 0.5, 0.5]) + s, np.array([0.8, 0.5, 0.5]) + s
        for c in (a, b):
            total += np.exp(-told["omega"] * ((p - c) ** 2).sum(-1))
        t = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
        total += np.exp(-told["mu"] * np.linalg.norm(p - a - t[..., None] * (b - a), axis=-1))
    assert np.abs(values + 0.25 - total).max() < 1e-4


def test_spreads_vary_sizes_about_the_median():
    centers = np.random.default_rng(0).random((400, 3))
    edges = np.stack([np.arange(399), np.arange(1, 400)], 1)
    many = TunnelGraph(PoreSet(Cell(), centers, np.zeros(400, np.int32)), edges, np.zeros((399, 3), int))
    for tunnel, power in (("linear", 1), ("squared", 2)):
        made = GaussianField(**RADII, pore_spread=0.2, tunnel_spread=0.1, tunnel=tunnel).run(PlainContext(1), many)
        piece = made.pieces[0]
        pore = np.sqrt(math.log(4) / piece.omega) / 0.1
        tunnels = (math.log(4) / piece.mu) ** (1 / power) / 0.04
        for radii, spread in ((pore, 0.2), (tunnels, 0.1)):
            assert np.log(radii).std() == pytest.approx(0.9 * spread, rel=0.1)  # the tails are cut
            assert abs(np.log(radii)).max() <= 2 * spread + 1e-9
            assert np.median(radii) == pytest.approx(1, abs=0.03)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"omega": 3.0},
        {"mu": 3.0, "tunnel_radius": Length(0.1), "omega": 3.0},
        {"mu": 3.0, "omega": 3.0, "pore_radius": Length(0.1)},
    ],
)
def test_one_size_for_each(options):
    with pytest.raises(ConfigError, match="one of"):
        GaussianField(**options).check_options()


def test_lengths_of_a_cell_may_be_written_in_cell_sizes_and_others_may_not():
    radius = options_of(GaussianField)["pore_radius"]
    assert parse_typed(radius, "0.11 cell", Path()) == Length(0.11, "cell")
    assert plain_option(Length(0.11, "cell")) == "0.11 cell"
    for stage, name in ((ScatteredTiling, "cell"), (MirroredFaces, "edge"), (ImplicitFill, "skin")):
        with pytest.raises(ValueError, match="only lengths of a cell can be given in cell sizes"):
            parse_typed(options_of(stage)[name], "0.11 cell", Path())


def test_mm_without_a_size():
    with pytest.raises(ConfigError, match="physical"):
        field(Cell(), pore_radius=Length(1, "mm"), tunnel_radius=Length(0.1))
