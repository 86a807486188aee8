"""``tileset.join`` and ``tile.joined``: sets stay as they are, and cells between them have the porosity between."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sppm_pipeline.errors import ConfigError
from sppm_pipeline.features.grading.laid_graph import kernel_sizes
from sppm_pipeline.features.grading.laws import FormulaLaw
from sppm_pipeline.features.grading.local_porosity import LatticeCells
from sppm_pipeline.features.grading.stages.tile_joined import JoinedTiling
from sppm_pipeline.features.grading.stages.tileset_join import JoinTileSets
from sppm_pipeline.features.grading.stages.tune_local_porosity import TuneLocalPorosity
from sppm_pipeline.method.fields.level_field import LevelField
from sppm_pipeline.method.nouns.maps import Grading
from sppm_pipeline.method.stages.check_connectivity import CheckConnectivity
from sppm_pipeline.method.stages.connect_mbdst import BoundedDegreeSubgraph
from sppm_pipeline.method.stages.field_gaussian import GaussianField
from sppm_pipeline.method.stages.sample_dart_throwing import DartThrowing
from sppm_pipeline.method.stages.sample_mirrored_faces import MirroredFaces
from sppm_pipeline.method.stages.tileset_corner_colors import CornerColorsTileSet
from sppm_pipeline.method.stages.tileset_free_faces import FreeFacesTileSet
from sppm_pipeline.method.stages.tileset_wang_3color import WangTileSet
from sppm_pipeline.nouns.length import Cell, Length
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.testing.plain_context import PlainContext, recipe_of


def recipe(total, radius):
    return recipe_of(
        MirroredFaces(total=total, share=0.5),
        DartThrowing(total=total),
        BoundedDegreeSubgraph(degree=(3, 5), mode="greedy"),
        GaussianField(pore_radius=Length(radius), tunnel_radius=Length(0.3 * radius)),
    )


def drawn(kind, total, radius, porosity, **options):
    options = {"resolution": 20, "porosity": porosity, "tolerance": 0.05} | options
    return kind(**options).run(PlainContext(seed=total), recipe(total, radius))


@pytest.fixture(scope="module")
def sets():
    return (
        drawn(FreeFacesTileSet, 50, 0.11, 0.3, colors=2, interiors=3),
        drawn(CornerColorsTileSet, 30, 0.15, 0.6, colors=1, interiors=2),
    )


def graded(**formulas):
    return Grading(tuple(FormulaLaw(name, "", text, (), (), None, None) for name, text in formulas.items()))


def laid(sets, weight, context=None, **options):
    joined = JoinTileSets().run(PlainContext(), *sets)
    options = {"cell": Length(5.0, "mm"), "cells": (4, 1, 1), "resolution": 24} | options
    return JoinedTiling(**options).run(context or PlainContext(), joined, graded(weight=weight), None)


def tiling_of(made):
    return made.base if isinstance(made, LevelField) else made


def test_pores_and_tunnels_of_both_sets_are_untouched(sets):
    tiling = tiling_of(laid(sets, "step(8, x)"))
    union = tiling.tileset.micro
    omega, mu = kernel_sizes(union)
    pore, tunnel, interior = 0, 0, 0
    for number, tileset in enumerate(sets):
        graph, offset = tileset.micro.graph, pore
        own_omega, own_mu = kernel_sizes(tileset.micro)
        n, m = len(graph.pores.centers), len(graph.edges)
        np.testing.assert_array_equal(union.graph.pores.centers[pore : pore + n], graph.pores.centers)
        np.testing.assert_array_equal(union.graph.edges[tunnel : tunnel + m] - offset, graph.edges)
        np.testing.assert_array_equal(union.graph.shift[tunnel : tunnel + m], graph.shift)
        np.testing.assert_array_equal(omega[pore : pore + n], own_omega)
        np.testing.assert_array_equal(mu[tunnel : tunnel + m], own_mu)
        pore, tunnel = pore + n, tunnel + m
        own, all_pieces = tileset.micro.pieces, union.pieces
        for axis in range(3):
            shift = number * sets[0].micro.colors[axis]
            for color in range(tileset.micro.colors[axis]):
                mine = own[own.interiors + axis * own.colors + color]
                there = all_pieces[all_pieces.interiors + axis * all_pieces.colors + color + shift]
                for a, b in zip(mine[:5], there[:5], strict=True):
                    np.testing.assert_array_equal(a, b)
        for t in range(own.interiors):
            for a, b in zip(own[t][:5], all_pieces[interior + t][:5], strict=True):
                np.testing.assert_array_equal(a, b)
        interior += own.interiors
    tiling.check()


def test_cells_far_from_the_other_set_are_cells_of_their_set(sets):
    """Their field is that of the set alone, but for kernels that reach in from the next cell but one."""
    context = PlainContext()
    made = laid(sets, "step(8, x)", context, cells=(5, 1, 1))
    assert context.reported["cells_first"] == 1
    assert context.reported["transition_cells"] == 1
    assert context.reported["cells_second"] == 3
    arrays = tiling_of(made).arrays
    k = sets[0].micro.interiors
    assert (arrays.box[0] < k).all()
    assert (arrays.box[2:] >= k).all()
    assert (arrays.box[2:] < k + sets[1].micro.interiors).all()
    assert (arrays.box[1] >= k + sets[1].micro.interiors).all()
    whole = laid(sets, "0*x")
    assert (tiling_of(whole).arrays.box < k).all()
    expected = np.mean(sets[0].porosity)
    assert abs((whole.sample(24) >= 0).mean() - expected) < 0.03


def test_transition_cells_have_the_porosity_between(sets):
    errors = []
    for seed in range(3):
        context = PlainContext(seed)
        made = laid(sets, "clip((x - 4)/12, 0, 1)", context, rounds=3)
        errors.append(context.reported["error_max"])
        cells = LatticeCells(made, 30)
        measured = cells.counted()
        weight = np.array([0, (7.5 - 4) / 12, 1, 1])  # the face at x = 10 belongs to the second set
        low, high = (np.mean(tileset.porosity) for tileset in sets)
        np.testing.assert_allclose(measured, (1 - weight) * low + weight * high, atol=0.05)
    assert max(errors) < 0.03, errors


def test_after_tuning_each_cell_is_exact_and_the_void_is_one_piece(sets):
    from scipy.ndimage import label

    made = laid(sets, "step(8, x)")
    assert isinstance(made, LevelField)
    maps = graded(porosity="where(x < 10, 0.3, 0.6)")
    tuned = TuneLocalPorosity(resolution=40, tolerance=0.002).run(PlainContext(), made, maps)
    cells = LatticeCells(tuned, 47)
    measured = cells.counted()
    np.testing.assert_allclose(measured, [0.3, 0.3, 0.6, 0.6], atol=0.002)
    void = tuned.sample(32) >= 0
    parts, count = label(void)
    sizes = np.bincount(parts.ravel(), minlength=count + 1)[1:]
    assert sizes.max() > 0.985 * void.sum()  # what is cut off by the sides of the box is no closed pore


def test_the_field_has_no_seam(sets):
    made = laid(sets, "step(8, x)")
    e = 1e-6
    for plane in (1.0, 2.0, 3.0):
        for field in (made, tiling_of(made)):
            pair = field.exactly().sample(Grid((plane - e, 0.01, 0.02), (2 * e, 0.05, 0.05), (2, 20, 20)))
            assert np.abs(pair[0] - pair[1]).max() < 1e-4


def test_joining_is_deterministic_and_depends_on_the_seed(sets):
    made = [laid(sets, "step(8, x)", PlainContext(seed), rounds=0).digest() for seed in (1, 1, 2)]
    assert made[0] == made[1] != made[2]


def test_wang_tiles_and_one_level(sets):
    wang = drawn(WangTileSet, 30, 0.15, 0.6, colors=2)
    level = sets[0].micro.level
    wang = replace(wang, micro=wang.micro.with_level(level))
    made = laid((sets[0], wang), "step(8, x)", cells=(4, 2, 2), rounds=0)
    assert not isinstance(made, LevelField)
    assert made.solid_below == pytest.approx(level)
    made.check()
    # a cell of the paper's set meets the faces that its number stands for
    box, first = made.arrays.box, sets[0].micro
    own = (box >= first.interiors) & (box < first.interiors + 8)
    assert own[2:].all()
    for axis, place in enumerate((4, 2, 1)):
        color = (box[own] - first.interiors) // place % 2 + first.colors[axis]
        for side in range(2):
            planes = [slice(1 + (side if a == axis else 0), None) for a in range(3)]
            around = made.arrays.faces[axis][tuple(planes)][tuple(slice(n) for n in box.shape)]
            np.testing.assert_array_equal(around[own], color)


def test_sets_that_do_not_fit(sets):
    other = sets[1].micro
    squared = replace(other.pieces, kernels=other.pieces.kernels._replace(profile="squared"))
    sized = [
        replace(s, micro=replace(s.micro, cell=Cell(size, True))) for s, size in zip(sets, (5.0, 3.0), strict=True)
    ]
    fresh = replace(sets[1], kind="fresh")
    for pair, words in (
        ((sets[0], replace(sets[1], micro=replace(other, pieces=squared))), "profile 'linear', those of the second"),
        (sized, "5 mm large, one of the second 3 mm"), ((sets[0], fresh), "second set is of kind 'fresh'"),
    ):  # fmt: skip
        with pytest.raises(ConfigError, match=words):
            JoinTileSets().run(PlainContext(), *pair)
    with pytest.raises(ConfigError, match="no map 'weight'"):
        JoinedTiling(cells=(2, 1, 1), cell=Length(5.0, "mm")).run(
            PlainContext(), JoinTileSets().run(PlainContext(), *sets), graded(porosity="0.5"), None
        )


def on_face(made, axis, low):
    """Pores of a mapped tiling in the unit square at `low` of a plane of its blocks, from its corner, and radii."""
    pores, arrays = made.tileset.micro.graph.pores, made.arrays
    site = np.argwhere(arrays.interior >= 0)[np.argsort(arrays.interior[arrays.interior >= 0])]
    place = pores.centers + site[pores.piece] - arrays.halo - low
    inside = (np.abs(place[:, axis]) < 1e-9) & (place >= -1e-9).all(1) & (place < 1).all(1)
    return place[inside], kernel_sizes(made.tileset.micro)[0][inside]


def test_a_large_cell_meets_the_united_patterns_of_small_ones(sets):
    """1:2, the larger set first, then second: no face is changed, no seam, and each cell exact after tuning."""
    sized = [
        replace(s, micro=replace(s.micro, cell=Cell(size, True))) for s, size in zip(sets, (5.0, 2.5), strict=True)
    ]
    box = {"cells": (2, 1, 1), "rounds": 0}
    alone = [tiling_of(laid(pair, "0*x", **box)).exactly().sample(12) for pair in (sized, sets)]
    np.testing.assert_allclose(*alone, atol=1e-5)  # large cells alone are those of their set
    for pair, weight, per_edge in ((sized, "step(8, x)", (1, 2)), (sized[::-1], "1 - step(8, x)", (2, 1))):
        context = PlainContext()
        assert JoinTileSets().run(PlainContext(), *pair).per_edge == per_edge
        made = laid(pair, weight, context, cells=(3, 1, 1), rounds=3)
        tiling = tiling_of(made)
        tiling.check()
        tiling.tileset.micro.graph.check()
        large = per_edge.index(1)
        found = context.reported["cells_first"], context.reported["cells_second"]
        assert (found[large], found[1 - large], context.reported["transition_cells"]) == (1, 8, 1)
        for plane, which, m in ((1, large, 1), (2, 1 - large, 2)):
            micro = pair[which].micro
            pores, omega = micro.graph.pores, kernel_sizes(micro)[0]
            patterns = [pores.of_piece(pores.face_piece(0, color)) for color in range(pores.colors[0])]
            points, widths = on_face(tiling, 0, np.array([plane, 0, 0]))
            np.testing.assert_allclose(widths, omega[pores.indices(pores.face_piece(0, 0))[0]] * m**2)
            for corner in np.ndindex(m, m):
                own = m * points - np.array([0, *corner])
                own = own[((own > -1e-9) & (own < 1 - 1e-9)).all(1)]
                # pores on an edge of the cell may belong to another face
                alone = own[(own[:, 1:] > 1e-9).all(1)]
                fits = [
                    np.isclose(p[:, None], own[None], atol=1e-9).all(2).any(1).all()
                    and np.isclose(alone[:, None], p[None], atol=1e-9).all(2).any(1).all()
                    for p in patterns
                ]
                assert any(fits)
                assert len(alone)
        e = 2e-7  # small tunnels are steep
        for x in (1.0, 1.5, 2.0, 2.5):
            jump = made.exactly().sample(Grid((x - e, 0.01, 0.02), (2 * e, 0.05, 0.05), (2, 20, 20)))
            assert np.abs(jump[0] - jump[1]).max() < 1e-4
    maps = graded(porosity="where(x > 10, 0.3, 0.6)" if large == 0 else "where(x > 10, 0.6, 0.3)")
    tuned = TuneLocalPorosity(resolution=72, tolerance=0.001).run(PlainContext(), made, maps)
    cells = LatticeCells(tuned, 91)
    expected = [0.6, 0.6, 0.3] if large == 0 else [0.3, 0.3, 0.6]
    np.testing.assert_allclose(cells.counted(), expected, atol=0.001)
    from scipy.ndimage import label

    void = tuned.sample(40) >= 0
    assert np.bincount(label(void)[0].ravel())[1:].max() > 0.985 * void.sum()
    # levels stay below 1, so that all axes are void, and the graph is one
    context = PlainContext()
    CheckConnectivity(resolution=12).run(context, tuned)
    assert context.reported["graph_parts"] == 1
    assert np.exp(tuned.control.max()) < 1
