"""``design.sizes``: similarity, hand-over to the tile rules, ratios out of reach, the same bytes."""

import re
from dataclasses import replace

import numpy as np
import pytest

import sppm_pipeline as sppm
from sppm_pipeline.errors import ConfigError, DesignError, SppmError
from sppm_pipeline.features.design.stages.design_sizes import DesignSizes, Draws
from sppm_pipeline.method.families.tiler import designed
from sppm_pipeline.method.nouns.cell_sizes import CellSizes
from sppm_pipeline.method.stages.tile_scattered import ScatteredTiling
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.local_thickness import limit_sizes, local_thickness

QUICK = {"draws": 1, "resolution": 40, "recipe": "paper", "seed": 1}


@pytest.fixture(scope="module")
def small() -> CellSizes:
    return sppm.design.sizes(pore="0.6 mm", strut="0.4 mm", **QUICK)


def test_the_sizes_are_those_asked_for(small):
    assert small.strut / small.pore == pytest.approx(0.4 / 0.6, rel=0.02)
    assert small.strut == pytest.approx(0.4, rel=0.01)
    assert small.pore == pytest.approx(0.6, rel=0.01)
    assert small.strut_thinnest < small.strut_low < small.strut < small.strut_high
    assert 0.5 < small.porosity < 0.75


def test_twice_the_sizes_are_twice_the_cell(small):
    """Similarity is exact: the same porosity, and a cell of exactly twice the edge."""
    large = sppm.design.sizes(pore="1.2 mm", wall="0.8 mm", **QUICK)
    assert large.porosity == small.porosity
    assert large.edge_mm == 2 * small.edge_mm
    assert large.strut_low == 2 * small.strut_low


def test_the_same_input_gives_the_same_numbers(small):
    assert sppm.design.sizes(pore="0.6 mm", strut="0.4 mm", **QUICK).digest() == small.digest()


@pytest.mark.filterwarnings("ignore:design.sizes")  # at its ends a range is coarse on this grid
def test_a_ratio_out_of_reach_names_the_nearest_that_is_reached():
    with pytest.raises(DesignError, match="out of reach") as caught:
        sppm.design.sizes(pore="0.6 mm", strut="6 mm", **QUICK)
    strut = re.search(r"`strut: (\S+ mm)`", caught.value.hint).group(1)
    found = sppm.design.sizes(pore="0.6 mm", strut=strut, **QUICK)
    assert found.pore == pytest.approx(0.6, rel=0.02)


def test_one_size_of_the_solid_is_given():
    with pytest.raises(ConfigError, match="neither"):
        DesignSizes(pore=Length(1, "mm")).check_options()
    with pytest.raises(ConfigError, match="both"):
        DesignSizes(pore=Length(1, "mm"), wall=Length(1, "mm"), strut=Length(1, "mm")).check_options()
    for void in ({}, {"pore": Length(1, "mm"), "throat": Length(1, "mm")}):
        with pytest.raises(ConfigError, match="either `pore` or `throat`"):
            DesignSizes(strut=Length(1, "mm"), **void).check_options()
    with pytest.raises(SppmError, match="need a Microstructure"):
        sppm.design.sizes(
            pore="1 mm", strut="1 mm", recipe=[sppm.step.sample.mirrored_faces(total=20, share=0.5)], seed=1
        )


def test_the_throat_of_crossing_channels_is_their_diameter():
    """Channels along x, y and z of 0.3, and of 0.2 along z: what passes is the narrower ball."""

    def channels(n, along_z):
        x = (np.arange(n) + 0.5) / n - 0.47  # on no symmetry of the grid
        x, y, z = np.meshgrid(x, x, x, indexing="ij")
        depths = [0.15 - np.hypot(y, z), 0.15 - np.hypot(x, z), along_z - np.hypot(x, y)]
        return np.max(depths, axis=0).astype(np.float32)

    for along_z in (0.15, 0.1):
        finer, fine, coarse = (channels(n, along_z) for n in (112, 56, 28))
        cells = Draws([fine], [coarse], [finer])
        assert cells.passing(float((finer >= 0).mean())) == pytest.approx(2 * along_z, rel=0.05)
    blocked = np.where(np.arange(56)[:, None, None] < 10, np.float32(-1), channels(56, 0.15))
    assert Draws([blocked], [blocked], [blocked]).passing(0.1) < 1e-5


def test_a_throat_is_met():
    found = sppm.design.sizes(throat="0.35 mm", strut="0.3 mm", **QUICK)
    assert found.throat == pytest.approx(0.35, rel=0.01)
    assert found.strut == pytest.approx(0.3, rel=0.01)
    assert found.throat < found.pore
    assert found.pore_asked is None


def test_thin_walls_are_found_though_they_vanish_on_the_grid_at_first():
    recipe = [
        sppm.step.sample.hyperuniform(total=30), sppm.step.connect.mbdst(mode="greedy"),
        sppm.step.field.walls(tunnel_radius=0.09),
    ]  # fmt: skip
    with pytest.warns(sppm.SppmWarning, match="voxels in the mean, too few"):
        found = sppm.design.sizes(pore="3 mm", wall="0.5 mm", **{**QUICK, "recipe": recipe})
    assert found.strut / found.pore == pytest.approx(0.5 / 3, rel=0.01)


def test_options_of_a_tile_rule_come_before_a_design(small):
    filled = designed(ScatteredTiling(), small)
    assert filled.cell.mm() == small.edge_mm
    assert filled.porosity == small.porosity
    own = designed(ScatteredTiling(cell=Length(5, "mm"), porosity=0.4), small)
    assert (own.cell.mm(), own.porosity) == (5, 0.4)
    assert designed(own, None) is own
    assert designed(own, replace(small, lay="cells")) is own
    with pytest.raises(ConfigError, match="lay: cells"):
        designed(ScatteredTiling(), replace(small, lay="cells"))


@pytest.mark.parametrize(
    ("rule", "set_"),
    [("tile.scattered", ""), ("tile.fresh", ""), ("tile.periodic", "set"), ("tile.wang_3color", "set"),
     ("tile.free_faces", "free")],
)  # fmt: skip
def test_every_tile_rule_takes_the_design(tmp_path, rule, set_):
    before = {
        "": [],
        "set": [sppm.step.tileset.wang_3color(recipe="paper", colors=2)],
        "free": [sppm.step.tileset.free_faces(recipe="paper", interiors=2, colors=1)],
    }[set_]
    laid = {"stage": rule, "cells": [2, 1, 1], **({} if set_ else {"recipe": "paper"})}
    sizes = {"stage": "design.sizes", "recipe": "paper", "pore": "0.6 mm", "strut": "0.4 mm", "draws": 1,
             "resolution": 40, "lay": "scattered" if rule == "tile.scattered" else "cells"}  # fmt: skip
    run = sppm.run(sppm.Pipeline([sizes, *before, laid]), seed=1, output=tmp_path / "run")
    design, tiling = run["design.sizes"], run[rule]
    assert tiling.edge_mm == design.edge_mm
    assert (tiling.sample(48) >= 0).mean() == pytest.approx(design.porosity, abs=0.01)


def test_sizes_in_the_limit_of_balls_are_their_diameters():
    """Parallel slabs: of 0.3 and 0.2 of the period, on grids that halve no voxel."""

    def slabs(n):
        x = (np.arange(n) + 0.5) / n
        solid = np.where((x < 0.3) | ((x > 0.5) & (x < 0.7)), np.uint8(1), np.uint8(0))
        return local_thickness(np.broadcast_to(solid, (n, n, n)).copy())

    found = limit_sizes(slabs(90), slabs(30), (1 / 90, 1 / 30))
    assert found.mean == pytest.approx((0.3**2 + 0.2**2) / 0.5, rel=0.04)
    assert found.low < found.mean < found.high


def test_the_ratio_falls_with_the_porosity():
    noise = np.random.default_rng(3).normal(size=(32, 32, 32))
    k = np.sqrt(sum(np.meshgrid(*[np.fft.fftfreq(32, 1 / 32) ** 2] * 3, indexing="ij")))
    values = np.fft.ifftn(np.fft.fftn(noise) * np.exp(-(((k - 4) / 1.5) ** 2))).real.astype(np.float32)
    cells = Draws([values], [values[::2, ::2, ::2].copy()])
    ratios = [cells.coarse_ratio(p) for p in (0.2, 0.35, 0.5, 0.65, 0.8)]
    assert (np.diff(ratios) < 0).all()
    assert cells.connected(0.5)
    assert not cells.connected(0.04)
