"""Artifacts: read-only, checked, with digests that tell different content apart."""

import dataclasses

import numpy as np
import pytest

from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.nouns.pores import PoreSet
from sppm_pipeline.method.nouns.tunnels import TunnelGraph
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.method.stages.check_connectivity import CheckConnectivity
from sppm_pipeline.method.stages.slice_field import SliceField
from sppm_pipeline.nouns.artifact import frozen, twin_rows
from sppm_pipeline.nouns.length import Cell
from sppm_pipeline.nouns.table import Table
from sppm_pipeline.testing.plain_context import PlainContext


def test_arrays_are_frozen_and_those_of_others_left_alone():
    mine = np.zeros((4, 3))
    pores = PoreSet(Cell(), mine, np.zeros(4, np.int32))
    mine[0] = 1  # a copy or not: the artifact must not change with it
    with pytest.raises(ValueError, match="read-only"):
        pores.centers[0] = 2
    view = np.zeros((5, 3))[1:]
    assert not frozen(view).flags.writeable
    assert view.flags.writeable
    assert frozen(frozen(view)) is not view


def pores(**changes):
    values = {
        "cell": Cell(),
        "centers": np.array([[0.5, 0.5, 0.5], [0, 0.2, 0.3], [0.4, 0, 0.1]]),
        "piece": np.array([0, 1, 2], np.int32),
        "colors": (1, 1, 0),
    }
    return PoreSet(**values | changes)


def test_pores_are_checked():
    pores().check()
    assert pores().summary()["pores_per_cell"] == 3
    for wrong, said in [
        (pores(piece=np.array([0, 1], np.int32)), "piece numbers"),
        (pores(piece=np.array([0, 1, 3], np.int32)), "does not exist"),
        (pores(piece=np.array([0, 1, -1], np.int32)), "does not exist"),
        (pores(piece=np.array([0, 2, 1], np.int32)), "coordinate 0"),
        (pores(centers=np.full((3, 3), np.nan)), "finite"),
        (pores(centers=np.array([[0.5, 0.5, 1.5], [0, 0.2, 0.3], [0.4, 0, 0.1]])), "lie in the cell.* 0 to 1.5"),
        (pores(centers=np.full((3, 3), 0.5), piece=np.zeros(3, np.int32)), "pores 0 and 1 of piece 0 are one"),
        (pores(interiors=0), "a cell has an interior"),
    ]:
        with pytest.raises(ValueError, match=said):
            wrong.check()


def test_pieces():
    many = pores(centers=np.zeros((6, 3)), piece=np.array([4, 0, 2, 0, 4, 1], np.int32), interiors=2, colors=(1, 0, 2))
    assert many.axis_of_piece().tolist() == [-1, -1, 0, 2, 2]
    assert [many.indices(p).tolist() for p in range(5)] == [[1, 3], [5], [2], [], [0, 4]]
    assert many.face_piece(2, 1) == 4


def test_tunnels_are_checked():
    def graph(edges, shift=None):
        return TunnelGraph(pores(), np.array(edges), np.zeros((len(edges), 3)) if shift is None else shift)

    graph([[0, 1], [0, 2]]).check()
    for wrong, said in [
        (graph([[1, 0]]), "interior pore to a face"),
        (graph([[1, 2]]), "interior pore to a face"),
        (graph([[0, 3]]), "does not exist"),
        (graph([[0, 1]], np.zeros((2, 3))), "shifts"),
    ]:
        with pytest.raises(ValueError, match=said):
            wrong.check()
    assert graph(np.zeros((0, 2))).summary()["mean_tunnel_length"] is None


def test_meshes_are_checked(wedge):
    wedge.check()
    assert wedge.bounds_solid
    assert wedge.summary()["volume_mm3"] > 0
    assert not SurfaceMesh(wedge.vertices, wedge.faces[1:]).bounds_solid
    for wrong in (SurfaceMesh(wedge.vertices * np.nan, wedge.faces), SurfaceMesh(wedge.vertices, wedge.faces + 1)):
        with pytest.raises(ValueError, match=r"finite|does not exist"):
            wrong.check()
    SurfaceMesh(np.zeros((0, 3)), np.zeros((0, 3), int)).check()


def test_tables():
    table = Table({"a": [1, 2], "b": ("x", None)})
    table.check()
    assert table.rows == 2
    with pytest.raises(ValueError, match="lengths"):
        Table({"a": [1], "b": []}).check()


def test_every_noun_has_a_digest_that_follows_its_content(cell, wang, wang_tiling, wedge):
    part = Part(wang_tiling, wedge, 0.2)
    context = PlainContext()
    artifacts = [
        cell, cell.with_level(0.26), cell.graph, cell.graph.pores, cell.cell, wang, wang_tiling, wedge, part,
        dataclasses.replace(part, skin_mm=0.3), Table({"a": (1, None, "x")}),
        CheckConnectivity(resolution=12).run(context, cell.with_level(0.9)),
        SliceField(resolution=8).run(context, wang_tiling), cell.alone(0, (0, 0, 0)),
    ]  # fmt: skip
    digests = [artifact.digest() for artifact in artifacts]
    assert len(set(digests)) == len(artifacts)
    before = part.digest()
    wang_tiling.sample(SliceField(resolution=8).run(context, wang_tiling).grid)  # fills caches
    assert part.digest() == before
    assert dataclasses.replace(cell, level=cell.level).digest() == cell.digest()


def test_equal_rows_are_found_and_rows_that_differ_in_one_place_are_not():
    rng = np.random.default_rng(1)
    many = rng.random((2000, 3))
    assert twin_rows(*many.T) is None
    assert twin_rows(*np.array([[0.1, 0.2], [0.2, 0.1], [0.1, 0.1]]).T) is None
    many[1700] = many[40]
    assert twin_rows(*many.T) == (40, 1700)
    assert twin_rows(*many[:, :1].T, np.arange(2000)) is None


def test_arrays_that_would_be_taken_apart_in_the_wrong_places_or_cut_off_are_refused():
    for centers in (np.zeros((3, 5)), np.zeros(6), np.zeros((2, 3, 1))):
        with pytest.raises(ValueError, match=r"expected \(n, 3\)"):
            PoreSet(Cell(), centers, np.zeros(len(centers), np.int32))
    assert PoreSet(Cell(), [], []).centers.shape == (0, 3)
    with pytest.raises(ValueError, match=r"whole numbers, got 0\.5"):
        SurfaceMesh(np.zeros((3, 3)), np.full((1, 3), 0.5))
    with pytest.raises(ValueError, match="got 0 to 4294967296"):
        pores(piece=np.array([0, 1, 2**32]))


def test_a_tunnel_is_listed_once():
    three = pores(centers=np.array([[0.1, 0.5, 0.5], [0.5, 0.5, 0.5], [0.9, 0.5, 0.5]]), piece=[0] * 3, colors=(0,) * 3)
    around = [[0, 0, 0], [0, 0, 0], [1, 0, 0], [1, -2, 0], [0, 0, 1]]
    TunnelGraph(three, [[0, 1], [1, 2], [2, 0], [1, 1], [1, 1]], around).check()
    for edges, shift, said in [
        ([[0, 1], [0, 1]], np.zeros((2, 3)), "tunnels 0 and 1 are one: both join the pores 0 and 1"),
        ([[0, 1], [1, 0]], [[1, 0, 0], [-1, 0, 0]], "are one"),
        ([[1, 1], [1, 1]], [[1, -2, 0], [-1, 2, 0]], "are one"),
        ([[0, 1], [2, 2]], np.zeros((2, 3)), "tunnel 1 leads from pore 2 to itself"),
    ]:
        with pytest.raises(ValueError, match=said):
            TunnelGraph(three, edges, shift).check()


def test_many_tunnels_are_kept_in_few_bytes_and_say_the_same(monkeypatch):
    edges, shift = np.array([[0, 1], [0, 1], [1, 2]]), np.array([[-128, 0, 0], [0, 0, 0], [0, 127, 0]])
    three = PoreSet(Cell(), np.random.default_rng(0).random((3, 3)), np.zeros(3, np.int32))
    wide = TunnelGraph(three, edges, shift)
    assert (wide.edges.dtype, wide.shift.dtype) == (np.int64, np.int64)
    monkeypatch.setattr("sppm_pipeline.method.nouns.tunnels.NARROW", 3)
    narrow = TunnelGraph(three, edges, shift)
    assert (narrow.edges.dtype, narrow.shift.dtype) == (np.int32, np.int8)
    narrow.check()
    assert narrow.summary() == wide.summary()
    assert np.array_equal(narrow.segments(), wide.segments())
    assert TunnelGraph(three, edges[1:], shift[1:]).edges.dtype == np.int64
    assert TunnelGraph(three, edges, shift - 1).shift.dtype == np.int64
    # found by the sorted rows, and where these do not tell
    for same in ([[0, 1], [0, 1], [1, 2]], [[0, 1], [1, 2], [1, 0]]):
        with pytest.raises(ValueError, match="are one"):
            TunnelGraph(three, same, np.zeros((3, 3), int)).check()
