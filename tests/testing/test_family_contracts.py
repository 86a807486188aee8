"""The contracts of families: built-in stages keep them, and each refuses a stage that does not."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from typing import ClassVar

import numpy as np
import pytest

from sppm_pipeline.engine.plan.plugins import load_plugins
from sppm_pipeline.engine.run.executors import SerialExecutor, make_executor
from sppm_pipeline.features.files.stages.write_mesh import WriteMesh
from sppm_pipeline.features.stiffness.stages.homogenize_voxel import HomogenizeVoxel
from sppm_pipeline.method.families.field_maker import FieldMaker
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.nouns.pores import PoreSet
from sppm_pipeline.method.nouns.stiffness import StiffnessReport
from sppm_pipeline.method.nouns.tunnels import TunnelGraph
from sppm_pipeline.method.nouns.voxels import Voxels
from sppm_pipeline.method.stages.connect_mst import MinimumSpanningTree
from sppm_pipeline.method.stages.field_gaussian import GaussianField
from sppm_pipeline.method.stages.sample_elimination import Elimination
from sppm_pipeline.method.stages.sample_mirrored_faces import MirroredFaces
from sppm_pipeline.method.stages.tile_wang_3color import WangTiling
from sppm_pipeline.method.stages.tileset_wang_3color import WangTileSet
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.stage import Context, Stage
from sppm_pipeline.testing.contracts import (
    ConnectorContract,
    ExecutorContract,
    FieldContract,
    HomogenizerContract,
    TilerContract,
    WriterContract,
)
from sppm_pipeline.testing.plain_context import PlainContext, recipe_of


@dataclass(frozen=True, kw_only=True)
class Layers(FieldMaker):
    """Layers across z."""

    name: ClassVar[str] = "field.layers"

    def evaluate(self, x, y, z):
        return np.cos(2 * np.pi * z)


@cache
def small_set():
    recipe = recipe_of(
        MirroredFaces(count=6, spacing=Length(0.2)),
        Elimination(count=6),
        MinimumSpanningTree(),
        GaussianField(omega=60.0, mu=60.0),
    )
    return WangTileSet(colors=2).run(PlainContext(2), recipe)


class TestConnector(ConnectorContract):
    def stages(self):
        return [MinimumSpanningTree()]


class TestField(FieldContract):
    def stages(self):
        return [Layers()]


class TestTiler(TilerContract):
    def stages(self):
        return [WangTiling(cells=(3, 2, 2)), WangTiling(cells=(2, 2, 2), periodic=True)]

    def tileset(self):
        return small_set()


class TestWriter(WriterContract):
    def stages(self):
        return [WriteMesh(path="a.ply"), WriteMesh(path="b/c.stl")]

    def inputs(self):
        corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
        return {"mesh": SurfaceMesh(corners, np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]))}


class TestHomogenizer(HomogenizerContract):
    def stages(self):
        return [HomogenizeVoxel(solver_tolerance=1e-4)]


@pytest.mark.parametrize("name", ["serial", "threads", "processes"])
class TestExecutor:
    @pytest.mark.parametrize("test", [name for name in dir(ExecutorContract) if name.startswith("test_")])
    def test_the_built_in_ones_keep_it(self, name, test):
        plugins = load_plugins(["sppm_pipeline.engine.run.executors"], distributions=False)
        getattr(executor_suite(lambda workers: make_executor(name, workers, plugins), name == "processes"), test)()


def executor_suite(make, apart=False):
    return type("Suite", (ExecutorContract,), {"executor": lambda self, workers: make(workers), "apart": apart})()


class Forgetful(MinimumSpanningTree):
    """Leaves the last tunnel out."""

    def run(self, context: Context, pores: PoreSet) -> TunnelGraph:
        graph = super().run(context, pores)
        return TunnelGraph(pores, graph.edges[:-1], graph.shift[:-1])


class Restless(Layers):
    """Depends on how much is asked for."""

    def evaluate(self, x, y, z):
        return np.cos(2 * np.pi * z) + 0.01 * len(x)


class Drifting(Layers):
    """Has another value at every place of the slab."""

    def evaluate(self, x, y, z):
        return np.cos(2 * np.pi * z) + np.arange(len(z)) * 0.01


class Stubborn(WangTiling):
    """Lays the same, whatever the seed."""

    def lay(self, rng, mask, tileset):
        return super().lay(np.random.default_rng(1), mask, tileset)


class Confused(HomogenizeVoxel):
    """Takes y for x."""

    def run(self, context: Context, source: Voxels) -> StiffnessReport:
        report = super().run(context, source)
        order = [1, 0, 2, 3, 4, 5]
        return StiffnessReport(report.stiffness[np.ix_(order, order)], report.phases, report.method)


@dataclass(frozen=True, kw_only=True)
class Elsewhere(Stage):
    """Writes to another place."""

    name: ClassVar[str] = "write.elsewhere"
    path: str = "a"

    def run(self, context: Context) -> None:
        context.output("b").write_bytes(b"b")


@pytest.mark.parametrize(
    ("contract", "stage", "test"),
    [
        (TestConnector, Forgetful(), "test_joins_them_into_one"),
        (TestField, Restless(), "test_a_sample_depends_on_its_place_alone"),
        (TestField, Drifting(), "test_a_sample_depends_on_its_place_alone"),
        (TestTiler, Stubborn(cells=(3, 2, 2)), "test_other_seeds_lay_other_cells"),
        (TestHomogenizer, Confused(solver_tolerance=1e-4), "test_axes_may_be_renamed"),
    ],
)
def test_a_stage_that_breaks_a_promise_is_found(contract, stage, test):
    class Suite(contract):
        def stages(self):
            return [stage]

    with pytest.raises(AssertionError):
        getattr(Suite(), test)()


@dataclass(frozen=True, kw_only=True)
class Littering(Elsewhere):
    """Writes what it should, and a file of another name beside it."""

    name: ClassVar[str] = "write.littering"

    def run(self, context: Context) -> None:
        context.output("a").write_bytes(b"a")
        context.output("a-overview").write_bytes(b"is allowed")
        super().run(context)


@pytest.mark.parametrize("stage", [Elsewhere(), Littering()])
def test_a_writer_that_writes_elsewhere_is_found(stage):
    class Suite(WriterContract):
        def stages(self):
            return [stage]

    with pytest.raises(AssertionError):
        Suite().test_writes_where_it_is_told()


class Mixed(SerialExecutor):
    """Hands results to the tasks before."""

    def __init__(self):
        self.last = None

    def submit(self, fn, /, *args, **kwargs):
        own, self.last = super().submit(fn, *args, **kwargs), self.last
        future = Future()
        future.set_result(own.result() if self.last is None else self.last)
        self.last = own.result()
        return future


class Silent(SerialExecutor):
    """Keeps errors to itself."""

    def submit(self, fn, /, *args, **kwargs):
        future = super().submit(fn, *args, **kwargs)
        return super().submit(int) if future.exception() else future


class Restive(ThreadPoolExecutor):
    """Does not wait for its tasks."""

    def shutdown(self, wait=True, *, cancel_futures=False):
        super().shutdown(wait=False)


class Quiet(SerialExecutor):
    """Says of a dead worker that its task is done."""

    def submit(self, fn, /, *args, **kwargs):
        return super().submit(int)


@pytest.mark.parametrize(
    ("make", "test"),
    [
        (lambda workers: Mixed(), "test_results_belong_to_their_tasks"),
        (lambda workers: Silent(), "test_an_error_is_that_of_its_task"),
        (Restive, "test_nothing_goes_on_after_the_end"),
        (lambda workers: Quiet(), "test_a_worker_that_dies_is_heard_of"),
    ],
)
def test_an_executor_that_breaks_a_promise_is_found(make, test):
    with pytest.raises(AssertionError):
        getattr(executor_suite(make, apart=True), test)()
