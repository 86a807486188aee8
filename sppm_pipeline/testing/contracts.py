"""What every stage promises, as suites to inherit from::

class TestMySampler(SamplerContract):
    def stages(self):
        return [MySampler(count=20), MySampler(count=1)]
"""

from __future__ import annotations

import dataclasses
import os
import time
from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.data.artifact import Artifact
from sppm_pipeline.data.length import Cell
from sppm_pipeline.data.palette import Palette
from sppm_pipeline.data.pores import PoreSet
from sppm_pipeline.data.stiffness import StiffnessReport
from sppm_pipeline.data.tunnels import TunnelGraph
from sppm_pipeline.data.voxels import Voxels
from sppm_pipeline.engine.config.options import options_of, parse_typed, plain_option
from sppm_pipeline.engine.files import digest_of
from sppm_pipeline.engine.plan.ports import signature_of
from sppm_pipeline.engine.strict_json import json_text, jsonable
from sppm_pipeline.errors import NativeCrash
from sppm_pipeline.families.tiler import Tiler, checked_lay
from sppm_pipeline.fields.scalar_field import ScalarField
from sppm_pipeline.fields.slice_stack import SliceStack
from sppm_pipeline.fields.tileset import TileSet
from sppm_pipeline.fields.tiling import Tiling
from sppm_pipeline.numerics.grid import Grid
from sppm_pipeline.stage import Stage
from sppm_pipeline.testing.plain_context import PlainContext


class StageContract:
    """What the engine expects of any stage."""

    @abstractmethod
    def stages(self) -> Sequence[Stage]:
        """Instances to be tested, with options that differ."""

    def inputs(self) -> Mapping[str, Any]:
        """An artifact for each port that the stage needs."""
        return {}

    def palette(self) -> Palette:
        """How many interiors and colors are asked for."""
        return Palette()

    def _run(self, stage: Stage, *, seed: int = 5, threads: int = 1, workers: int = 0) -> tuple[Any, PlainContext]:
        context = PlainContext(seed, threads=threads, palette=self.palette(), workers=workers)
        open_ports = {port.name: None for port in signature_of(type(stage)).ports if port.optional}
        return stage.run(context, **{**open_ports, **self.inputs()}), context

    def _digest(self, stage: Stage, **how: Any) -> tuple[str | None, str, str]:
        return self._digest_and_context(stage, **how)[0]

    def _digest_and_context(self, stage: Stage, **how: Any) -> tuple[tuple[str | None, str, str], PlainContext]:
        made, context = self._run(stage, **how)
        own = made.digest() if isinstance(made, Artifact) else None
        return (own, digest_of(context.directory), json_text(jsonable(context.reported))), context

    def test_has_a_name_of_family_and_word(self) -> None:
        """``family.name``, both in lower case."""
        for stage in self.stages():
            family, dot, word = stage.name.partition(".")
            assert dot, f"{stage.name!r} must be family.name"
            assert family.isidentifier()
            assert f"_{word}".isidentifier()  # it may begin with a digit
            assert stage.name == stage.name.lower()

    def test_says_what_it_does(self) -> None:
        """A docstring and a sentence for each option."""
        for stage in self.stages():
            assert (type(stage).__doc__ or "").strip()
            assert not (type(stage).__doc__ or "").startswith(f"{type(stage).__name__}("), "the docstring is missing"
            assert all(option.spec.help for option in options_of(type(stage)).values())

    def test_is_frozen(self) -> None:
        """Options can't be changed after they were checked."""
        for stage in self.stages():
            parameters = stage.__dataclass_params__  # type: ignore[attr-defined]
            assert parameters.frozen
            assert all(field.kw_only for field in dataclasses.fields(stage))

    def test_options_survive_a_run_record(self) -> None:
        """Written as JSON and read again, options are the same."""
        for stage in self.stages():
            for name, option in options_of(type(stage)).items():
                value = getattr(stage, name)
                assert parse_typed(option, plain_option(value), Path()) == value, name

    def test_declares_its_ports(self) -> None:
        """The signature of `run` can be read."""
        for stage in self.stages():
            names = {port.name for port in signature_of(type(stage)).ports}
            assert set(self.inputs()) <= names

    def test_makes_what_it_announces(self) -> None:
        """The type of the result, and its parts agree with each other."""
        for stage in self.stages():
            made, _ = self._run(stage)
            signature = signature_of(type(stage))
            if not signature.as_recipe:
                assert isinstance(made, signature.makes or type(None))
            if isinstance(made, Artifact):
                made.check()
                json_text(jsonable(made.summary()))

    def test_same_seed_same_result(self) -> None:
        """Whatever the number of threads, and whether workers do what it maps (`Context.map`)."""
        for stage in self.stages():
            first, context = self._digest_and_context(stage)
            assert self._digest(stage) == first
            assert self._digest(stage, threads=3) == first
            if context.asked_for_workers:
                assert self._digest(stage, workers=2) == first

    def test_leaves_its_inputs_alone(self) -> None:
        """Artifacts are shared between stages."""
        for stage in self.stages():
            inputs = {name: value for name, value in self.inputs().items() if isinstance(value, Artifact)}
            before = {name: value.digest() for name, value in inputs.items()}
            open_ports = {port.name: None for port in signature_of(type(stage)).ports if port.optional}
            context = PlainContext(5, palette=self.palette())
            stage.run(context, **{**open_ports, **self.inputs(), **inputs})
            assert {name: value.digest() for name, value in inputs.items()} == before

    def test_leaves_global_random_numbers_alone(self) -> None:
        """Random numbers come from the context."""
        for stage in self.stages():
            before = np.random.get_state(legacy=False)["state"]  # noqa: NPY002 - the point of the test
            self._run(stage)
            after = np.random.get_state(legacy=False)["state"]  # noqa: NPY002
            assert np.array_equal(before["key"], after["key"])
            assert before["pos"] == after["pos"]


class SamplerContract(StageContract):
    """What connectors and tile sets expect of a sampler that throws interior pores."""

    random = True
    """Whether different seeds must give different pores."""

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


class SlicerContract(StageContract):
    """What writers of layers expect of a stage that makes a stack of them."""

    def test_layers_come_from_the_bottom_without_a_gap(self) -> None:
        """As many and as large as the stack says; bytes that don't depend on threads, in between only if it is gray."""
        for stage in self.stages():
            stack, _ = self._run(stage)
            assert isinstance(stack, SliceStack)
            nx, ny, nz = stack.shape
            found: list[NDArray[np.uint8]] = []
            for start, slab in stack.slabs():
                assert start == sum(len(one) for one in found), f"a slab starts at layer {start}"
                assert slab.shape[1:] == (ny, nx), "layers are (ny, nx), rows along x"
                assert slab.dtype == np.uint8
                found.append(slab.copy())
            layers = np.concatenate(found)
            assert len(layers) == nz
            assert np.array_equal(stack.to_array(threads=3), layers)
            assert stack.gray or np.isin(layers, (0, 255)).all()

    def test_pixels_have_a_pitch_along_x_and_one_along_y(self) -> None:
        """A pair, also where both are equal, and a layer height."""
        for stage in self.stages():
            stack, _ = self._run(stage)
            assert isinstance(stack.pixel_mm, tuple), "the pitch of square pixels is a pair, too"
            assert len(stack.pixel_mm) == 2
            assert min(*stack.pixel_mm, stack.layer_mm) > 0


class ConnectorContract(StageContract):
    """What fields expect of a connector: tunnels between the pores it was given, within pieces and to the faces."""

    connected = True
    """Whether the pores of a periodic cell must be joined into one."""

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
            for _ in found:
                for a, b in graph.edges:
                    found[[a, b]] = found[[a, b]].min()
            assert not found.any(), "the pores fall apart"

    def test_tunnels_to_faces(self) -> None:
        """From an interior to the face patterns it may meet, on the side where they lie."""
        rng = np.random.default_rng(4)
        centers = np.concatenate([0.25 + rng.random((8, 3)) / 2, rng.random((3, 3)) * [0, 1, 1]])
        pores = PoreSet(Cell(), centers, np.repeat(np.array([0, 1], np.int32), [8, 3]), colors=(1, 0, 0))
        for stage in self.stages():
            graph = stage.run(PlainContext(5, palette=Palette(colors=(1, 0, 0))), pores)
            graph.check()
            ends = pores.piece[graph.edges]
            across = ends[:, 0] != ends[:, 1]
            assert across.any(), "no tunnel leads to the face"
            assert np.isin(graph.shift[across, 0], (0, 1)).all()
            assert not graph.shift[across, 1:].any()


class FieldContract(StageContract):
    """What meshing, slicing and homogenization expect of a field."""

    def _fields(self) -> Iterator[ScalarField]:
        for stage in self.stages():
            field, _ = self._run(stage)
            assert isinstance(field, ScalarField)
            yield field

    def test_has_solid_and_void(self) -> None:
        """Negative in the solid, positive in the void, with either of them."""
        for field in self._fields():
            values = field.sample(12)
            assert values.min() < 0 < values.max()
            assert np.array_equal(field.solid(12), values < 0)

    def test_a_sample_depends_on_its_place_alone(self) -> None:
        """Not on the layers that are asked for, nor on other points, nor on threads."""
        for field in self._fields():
            grid = Grid((0.05, 0.03, 0.07), (0.1, 0.15, 0.11), (9, 6, 7))
            whole = field.sample(grid)
            assert whole.shape == (9, 6, 7)
            assert whole.dtype == np.float32
            parts = [field.sample_layers(grid, start, stop, threads=3) for start, stop in ((0, 2), (2, 3), (3, 7))]
            assert np.array_equal(np.concatenate(parts, axis=2), whole)
            inner = Grid((0.25, 0.33, 0.18), (0.1, 0.15, 0.11), (4, 3, 2))
            assert np.allclose(field.sample(inner), whole[2:6, 2:5, 1:3], atol=1e-6 * np.abs(whole).max())

    def test_repeats_if_it_says_so(self) -> None:
        """The next cell of a periodic field is the same."""
        for field in self._fields():
            if field.periodic:
                grid = Grid((0.1, 0.2, 0.3), (0.17, 0.13, 0.11), (4, 5, 6))
                nx, ny, nz = field.cells
                moved = Grid((0.1 + nx, 0.2 - ny, 0.3 + 2 * nz), grid.spacing, grid.shape)
                values = field.sample(grid)
                assert np.allclose(field.sample(moved), values, atol=1e-5 * np.abs(values).max())


class TilerContract(StageContract):
    """What fields expect of a tile rule."""

    random = True
    """Whether different seeds must lay different cells."""

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
        mask[1:, 1:3, 1] = mask[0, 0, 0] = mask[2, 3, 4] = True
        for stage in self.stages():
            assert isinstance(stage, Tiler)
            if not stage.periodic:
                laid = stage.lay(PlainContext(3).rng(), mask, self.tileset())
                interior, _ = checked_lay(stage.name, laid, mask, self.tileset())
                assert np.array_equal(interior >= 0, mask)


class WriterContract(StageContract):
    """What users expect of a stage that writes."""

    def test_writes_where_it_is_told(self) -> None:
        """The file or folder of the option `path`, with something in it; others beside it begin with its name."""
        for stage in self.stages():
            made, context = self._run(stage)
            assert made is None, "a writer makes nothing"
            target = context.directory / str(getattr(stage, "path")).rstrip("/")  # noqa: B009 - no stage has to have it
            assert target.exists()
            files = [target] if target.is_file() else [file for file in target.rglob("*") if file.is_file()]
            assert files
            assert all(file.stat().st_size for file in files)
            others = {file for file in context.directory.rglob("*") if file.is_file()} - set(files)
            assert all(file.parent == target.parent and file.name.startswith(target.stem) for file in others)


class HomogenizerContract(StageContract):
    """What is true of an effective stiffness, whatever the method; the port of the stage takes images."""

    port = "source"

    def inputs(self) -> Mapping[str, Any]:
        """An image with different stiffness along its axes: a solid slab, and a bar through the rest."""
        solid = np.zeros((6, 6, 6), bool)
        solid[:, :, :3] = solid[2:4, :, :] = solid[:, 3:, 4:5] = True
        return {self.port: Voxels.from_array(solid)}

    def test_a_stiffness_between_the_bounds(self) -> None:
        """Symmetric, without negative energies, between Voigt and Reuss."""
        for stage in self.stages():
            report, _ = self._run(stage)
            assert isinstance(report, StiffnessReport)
            report.check()
            assert report.bounds.within

    def test_axes_may_be_renamed(self) -> None:
        """The stiffness of the turned image is the stiffness with its axes turned."""
        source = self.inputs()[self.port]
        turned = Voxels.from_array(np.array(source.values).transpose(1, 2, 0) > 0)
        normal = [1, 2, 0]
        order = [*normal, *(3 + i for i in normal)]  # yz, xz, xy are numbered by the axis that they lack
        for stage in self.stages():
            first = stage.run(PlainContext(5), **{self.port: source})
            second = stage.run(PlainContext(5), **{self.port: turned})
            scale = np.abs(first.stiffness).max()
            assert np.allclose(second.stiffness, first.stiffness[np.ix_(order, order)], atol=2e-3 * scale)


class ExecutorContract:
    """What sweeps expect of an executor."""

    apart = False
    """Whether tasks run in other processes than the one that submits them."""

    @abstractmethod
    def executor(self, workers: int) -> Executor:
        """A new one, as the hook `sppm_executors` makes it."""

    def test_results_belong_to_their_tasks(self) -> None:
        """Whatever the order in which they end."""
        with self.executor(2) as executor:
            futures = [executor.submit(pow, base, exp=2) for base in range(5)]
            assert [future.result(timeout=60) for future in futures] == [0, 1, 4, 9, 16]
            assert list(executor.map(divmod, (7, 9), (2, 5), timeout=60)) == [(3, 1), (1, 4)]

    def test_an_error_is_that_of_its_task(self) -> None:
        """Type and message arrive, and the next task is done."""
        with self.executor(1) as executor:
            bad, good = executor.submit(int, "no number"), executor.submit(int, "3")
            error = bad.exception(timeout=60)
            assert isinstance(error, ValueError)
            assert "no number" in str(error)
            assert good.result(timeout=60) == 3

    def test_nothing_goes_on_after_the_end(self) -> None:
        """Tasks that are canceled don't run, those that run have ended, and it may be shut down twice."""
        executor = self.executor(1)
        futures = [executor.submit(time.sleep, 0.02) for _ in range(9)]
        for future in futures:
            future.cancel()
        executor.shutdown(wait=True)
        assert all(future.done() for future in futures)
        executor.shutdown(wait=True)

    def test_a_worker_that_dies_is_heard_of(self) -> None:
        """By an error that says so, whether the executor goes on (`NativeCrash`) or breaks down (`BrokenExecutor`)."""
        if self.apart:
            with self.executor(1) as executor:
                error = executor.submit(os._exit, 3).exception(timeout=60)
                assert isinstance(error, (BrokenExecutor, NativeCrash))
                if isinstance(error, NativeCrash):
                    assert executor.submit(pow, 2, 3).result(timeout=60) == 8
