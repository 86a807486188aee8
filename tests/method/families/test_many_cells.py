"""Many interiors and pieces at once: the fast ways of the built-in stages, and the loops that others keep."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

import sppm_pipeline.method.families.connector
import sppm_pipeline.method.sampling.many
import sppm_pipeline.method.stages.connect_mbdst
import sppm_pipeline.method.stages.sample_dart_throwing
from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.stages.connect_mbdst import BoundedDegreeSubgraph
from sppm_pipeline.method.stages.connect_mst import MinimumSpanningTree
from sppm_pipeline.method.stages.sample_dart_throwing import DartThrowing
from sppm_pipeline.method.stages.sample_mirrored_faces import MirroredFaces
from sppm_pipeline.method.tiling.lattice import meetings, tile_fresh
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.nouns.palette import Palette
from sppm_pipeline.testing.plain_context import PlainContext

FACES = {"total": 30, "share": 0.4}
GREEDY = {"mode": "greedy", "degree": (3, 5)}


def fresh_palette(*shape):
    interior, faces = tile_fresh(np.ones(shape, bool))
    colors = tuple(int(face.max()) + 1 for face in faces)
    return Palette(int(interior.max()) + 1, colors, meetings(interior, faces))


@pytest.fixture
def slowly(monkeypatch):
    """Turns the fast ways off, or on for however few cells."""

    def turn(off):
        for module in (sppm_pipeline.method.stages.connect_mbdst, sppm_pipeline.method.stages.sample_dart_throwing,
                       sppm_pipeline.method.families.connector):  # fmt: skip
            monkeypatch.setattr(module, "MANY", 10**9 if off else 0)
        monkeypatch.setattr(sppm_pipeline.method.sampling.many, "FEW", 10**9 if off else 0)

    return turn


def drawn(palette, sampler, connector, faces=FACES, threads=2):
    def context():
        return PlainContext(7, palette=palette, threads=threads)

    pores = sampler.run(context(), MirroredFaces(**faces).run(context(), None))
    pores.check()
    graph = connector.run(context(), pores)
    graph.check()
    return graph


@pytest.mark.parametrize("palette", [fresh_palette(3, 2, 2), Palette(5, (2, 2, 2)), Palette(3, (20, 17, 18))])
@pytest.mark.parametrize(
    ("faces", "sampler", "connector"),
    [
        (FACES, DartThrowing(total=30), BoundedDegreeSubgraph(**GREEDY)),
        (FACES | {"faces_margin": "paper"}, DartThrowing(count=20, clear_faces=False), BoundedDegreeSubgraph(**GREEDY)),
        (FACES, DartThrowing(share=0.4), BoundedDegreeSubgraph(mode="greedy", degree=(1, 4), neighbors=3)),
        (FACES, DartThrowing(share=1.0), BoundedDegreeSubgraph(**GREEDY, connector_clearance=Length(0.02))),
        (FACES, DartThrowing(total=30), MinimumSpanningTree()),
    ],
)
def test_fast_and_slow_draw_the_same_cells(palette, faces, sampler, connector, slowly):
    graphs = []
    for off in (False, True):
        slowly(off)
        graphs.append(drawn(palette, sampler, connector, faces))
    fast, slow = graphs
    assert len(slow.edges) > 20 * palette.interiors
    assert fast.digest() == slow.digest()


def test_threads_change_nothing(slowly):
    slowly(False)
    parts = fresh_palette(3, 2, 2), DartThrowing(total=30), BoundedDegreeSubgraph(**GREEDY)
    assert drawn(*parts, threads=1).digest() == drawn(*parts, threads=3).digest()


def test_an_interior_that_is_too_full_says_so_either_way(slowly):
    messages = []
    for off in (False, True):
        slowly(off)
        with pytest.raises(DesignError, match=r"only \d+ of 62 pores fit") as error:
            drawn(fresh_palette(2, 2, 1), DartThrowing(count=62), BoundedDegreeSubgraph(**GREEDY))
        messages.append(str(error.value))
    assert messages[0] == messages[1]


@dataclass(frozen=True, kw_only=True)
class Shaken(DartThrowing):
    """Dart throwing whose pores are moved."""

    name: ClassVar[str] = "sample.shaken"

    def throw(self, rng, box):
        return super().throw(rng, box) + 1e-4 * rng.random((1, 3))


@dataclass(frozen=True, kw_only=True)
class Chain(BoundedDegreeSubgraph):
    """One pore after the other, faces to the first pore."""

    name: ClassVar[str] = "connect.chain"

    def join(self, rng, piece):
        n = len(piece.points)
        return np.stack([np.arange(n - 1), np.arange(1, n)], 1), np.zeros((n - 1, 3), np.int64)

    def connect(self, face_points, interior_points, cell):
        return np.zeros(len(face_points), np.int64)


def test_stages_that_replace_a_method_are_asked_cell_by_cell(slowly):
    slowly(False)
    palette = fresh_palette(2, 2, 1)
    plain = drawn(palette, DartThrowing(total=30), Chain(**GREEDY))
    shaken = drawn(palette, Shaken(total=30), Chain(**GREEDY))
    inside = plain.pores.piece < palette.interiors
    step = shaken.pores.centers[inside] - plain.pores.centers[inside]
    assert (step > 0).all()
    assert np.unique(step.round(12), axis=0).shape == (palette.interiors, 3)
    own = plain.pores.piece[plain.edges]
    within = own[:, 0] == own[:, 1]
    assert (np.diff(plain.edges[within], axis=1) == 1).all()
    firsts = [plain.pores.indices(t)[0] for t in range(palette.interiors)]
    assert np.isin(plain.edges[~within, 0], firsts).all()
