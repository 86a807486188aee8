"""Promises of samplers, connectors and tile rules beyond any stage; see `sppm_pipeline.testing.contracts`."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np

from sppm_pipeline.method.families.tiler import Tiler, checked_lay
from sppm_pipeline.method.fields.tileset import TileSet
from sppm_pipeline.method.fields.tiling import Tiling
from sppm_pipeline.method.nouns.pores import PoreSet
from sppm_pipeline.method.nouns.tunnels import TunnelGraph
from sppm_pipeline.nouns.length import Cell
from sppm_pipeline.nouns.palette import Palette
from sppm_pipeline.stage import Stage
from sppm_pipeline.testing.plain_context import PlainContext
from sppm_pipeline.testing.stage_contract import StageContract


class SamplerContract(StageContract):
    """Expectations of connectors and tile sets on a sampler that throws interior pores."""

    random = True
    """Different seeds must give different pores."""

    def _thrown(self, stage: Stage, seed: int, palette: Palette, start: PoreSet | None) -> PoreSet:
        pores = stage.run(PlainContext(seed, palette=palette), start)
        assert isinstance(pores, PoreSet)
        pores.check()
        return pores

    def test_pores_lie_in_the_cell(self) -> None:
        """Inside the unit cube, as the sampler's own cell."""
        for stage in self.stages():
            pores = self._thrown(stage, 1, Palette(), None)
            assert len(pores.centers)
            assert pores.centers.min() >= 0
            assert pores.centers.max() <= 1

    def test_other_seeds_throw_other_pores(self) -> None:
        """Unless the sampler declares that it is not random."""
        for stage in self.stages() if self.random else ():
            a, b = (self._thrown(stage, seed, Palette(), None) for seed in (1, 2))
            assert a.digest() != b.digest()

    def test_fills_every_interior_that_is_asked_for(self) -> None:
        """Each interior has pores, and not those of another."""
        for stage in self.stages():
            pores = self._thrown(stage, 1, Palette(interiors=3), None)
            assert pores.interiors == 3
            interiors = [pores.of_piece(t) for t in range(3)]
            assert all(len(centers) for centers in interiors)
            if self.random:
                assert not np.array_equal(interiors[0], interiors[1])

    def test_keeps_the_pores_that_are_there(self) -> None:
        """Pores on the faces stay as they are, in front."""
        start = PoreSet(
            cell=Cell(), centers=np.array([[0.0, 0.5, 0.5]]), piece=np.array([1], np.int32), colors=(1, 0, 0)
        )
        for stage in self.stages():
            pores = self._thrown(stage, 1, Palette(), start)
            assert pores.colors == (1, 0, 0)
            assert np.array_equal(pores.centers[:1], start.centers)
            assert len(pores.centers) > 1
            assert (pores.piece[1:] == 0).all()


class ConnectorContract(StageContract):
    """Expectations of fields on a connector: tunnels between the pores it was given, within pieces and to the faces."""

    connected = True
    """The pores of a periodic cell must be joined into one."""

    def inputs(self) -> Mapping[str, Any]:
        """Pores of a periodic cell without any on its faces; replace it for others."""
        return {"pores": PoreSet(Cell(), np.random.default_rng(3).random((12, 3)), np.zeros(12, np.int32))}

    def test_joins_the_pores_it_was_given(self) -> None:
        """All of them, unchanged; none stays alone."""
        for stage in self.stages():
            graph, _ = self._run(stage)
            assert isinstance(graph, TunnelGraph)
            assert graph.pores.digest() == self.inputs()["pores"].digest()
            assert len(np.unique(graph.edges)) == len(graph.pores.centers), "a pore has no tunnel"

    def test_joins_them_into_one(self) -> None:
        """Unless the connector declares that it does not."""
        for stage in self.stages() if self.connected else ():
            graph, _ = self._run(stage)
            found = np.arange(len(graph.pores.centers))
            # labels go from pore to pore; as many rounds as pores reach the end of the longest chain
            for _ in found:
                for a, b in graph.edges:
                    found[[a, b]] = found[[a, b]].min()
            assert not found.any(), "the pores fall apart"

    def test_tunnels_to_faces(self) -> None:
        """From an interior to the face patterns it may meet, on the side where they lie."""
        rng = np.random.default_rng(4)
        # interior pores near the middle, and three of a face across x, at x = 0
        centers = np.concatenate([0.25 + rng.random((8, 3)) / 2, rng.random((3, 3)) * [0, 1, 1]])
        pores = PoreSet(Cell(), centers, np.repeat(np.array([0, 1], np.int32), [8, 3]), colors=(1, 0, 0))
        for stage in self.stages():
            graph = stage.run(PlainContext(5, palette=Palette(colors=(1, 0, 0))), pores)
            graph.check()
            ends = pores.piece[graph.edges]
            across = ends[:, 0] != ends[:, 1]
            assert across.any(), "no tunnel leads to the face"
            # a pattern of a face stands at x = 0 and, shifted by a cell, at x = 1
            assert np.isin(graph.shift[across, 0], (0, 1)).all()
            assert not graph.shift[across, 1:].any()


class TilerContract(StageContract):
    """Expectations of fields on a tile rule."""

    random = True
    """Different seeds must lay different cells."""

    @abstractmethod
    def tileset(self) -> TileSet:
        """A tile set of a kind that the rule lays; make it once."""

    def inputs(self) -> Mapping[str, Any]:
        """The tile set; stages say by `cells` what is laid."""
        return {"tileset": self.tileset()}

    def test_fills_the_box(self) -> None:
        """Every cell, with interiors and colors of the set that fit together."""
        for stage in self.stages():
            tiling, _ = self._run(stage)
            assert isinstance(tiling, Tiling)
            tiling.check()
            assert tiling.cells == getattr(stage, "cells", tiling.cells)
            assert (tiling.arrays.interior >= 0).all()

    def test_other_seeds_lay_other_cells(self) -> None:
        """Unless the rule declares that it is not random."""
        for stage in self.stages() if self.random else ():
            a, b = (self._run(stage, seed=seed)[0] for seed in (1, 2))
            assert a.digest() != b.digest()

    def test_fills_a_part_and_nothing_else(self) -> None:
        """Of any shape: `lay` gets a mask, and keeps to it."""
        mask = np.zeros((3, 4, 5), bool)
        # a block, and two cells that touch no other by a face
        mask[1:, 1:3, 1] = mask[0, 0, 0] = mask[2, 3, 4] = True
        for stage in self.stages():
            assert isinstance(stage, Tiler)
            if not stage.periodic:
                laid = stage.lay(PlainContext(3).rng(), mask, self.tileset())
                interior, _ = checked_lay(stage.name, laid, mask, self.tileset())
                assert np.array_equal(interior >= 0, mask)
