"""Layers made by workers, slab by slab, are those of one process, to the byte and to the last digit."""

from __future__ import annotations

import os
import shutil
from collections import namedtuple
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from sppm_pipeline.engine.plan.session import RunRequest, open_session
from sppm_pipeline.engine.run import crew
from sppm_pipeline.engine.run.crew import WorkerPool
from sppm_pipeline.engine.run.executors import WorkerOptions
from sppm_pipeline.engine.run.runner import run_plan
from sppm_pipeline.method.families.layer_writer import LayerWriter
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.method.slicing import sampled_slices, slab_passes
from sppm_pipeline.method.slicing.slab_passes import cleared_slab, label_slab, slab_tasks
from sppm_pipeline.method.slicing.slice_stack import ArraySlices
from sppm_pipeline.method.stages.slice_field import SliceField
from sppm_pipeline.method.stages.slice_mesh import SliceMesh
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.bit_rows import unpack
from sppm_pipeline.stage import option
from sppm_pipeline.testing.plain_context import PlainContext

PITCH = {"pixel": Length(0.4, "mm"), "layer": Length(0.25, "mm")}


class Sum:
    """Looks at some layers."""

    wanted = range(3, 30, 4)

    def __init__(self):
        self.seen = []

    def add(self, number, image):
        if number in self.wanted:
            self.seen.append((number, int(image.sum())))


@dataclass(frozen=True, kw_only=True)
class WriteRaw(LayerWriter):
    """Raw layers, and what an observer saw."""

    name: ClassVar[str] = "write.raw"
    suffix: ClassVar[str] = ".raw"

    path: str = option("layers", help="folder to write", output=True)
    table: Path | None = option(None, help="a file that a writer may need")

    def encode(self, image, stack):
        return image.tobytes()

    def observer(self, stack):
        return Sum()

    def store(self, target, stack, layers):
        super().store(target, stack, layers)
        (target / "seen").write_text(repr(layers.observer.seen))


def written(stack, workers=0, **options):
    """Files, numbers and context of a run of the writer."""
    context = PlainContext(threads=2, workers=workers)
    WriteRaw(sheet=2, **options).run(context, stack)
    files = {file.name: file.read_bytes() for file in context.directory.rglob("*") if file.is_file()}
    return files, dict(context.reported), context


def field_slices(part, **options):
    return SliceField(**{**PITCH, **options}).run(PlainContext(), part)


def mesh_slices(mesh, **options):
    return SliceMesh(**{**PITCH, **options}).run(PlainContext(), mesh)


@pytest.fixture
def small_slabs(monkeypatch):
    monkeypatch.setattr(sampled_slices, "SLAB_PIXELS", 1500)
    monkeypatch.setattr(sampled_slices, "VOTED_PIXELS", 3000)


@pytest.mark.parametrize(
    "made",
    [
        pytest.param(lambda part, ball: field_slices(part), id="islands"),
        pytest.param(lambda part, ball: field_slices(part, gray=3, gray_layers=2), id="gray"),
        pytest.param(lambda part, ball: field_slices(part.base, islands="keep"), id="kept"),
        pytest.param(lambda part, ball: mesh_slices(ball, inside="vote"), id="vote"),
    ],
)
def test_files_and_numbers_are_those_of_one_process(wang_tiling, ball, small_slabs, made):
    part = Part(wang_tiling, ball, 0.5)
    files, numbers, context = written(made(part, ball))
    assert context.progress_calls[-1][2] == "layers"
    for workers in (1, 3):
        found, told, context = written(made(part, ball), workers, table=Path("some.csv"))
        assert found == files
        assert told == numbers
        assert not context.warnings
        done, total, what = context.progress_calls[-1]
        assert (done, what) == (total, "slabs, encoded")
        assert [call[0] for call in context.progress_calls] == [*range(1, total + 1)]


def test_the_next_reader_needs_no_first_pass(wang_tiling, ball, small_slabs, monkeypatch):
    stack = field_slices(Part(wang_tiling, ball, 0.0))
    files, numbers, _ = written(field_slices(Part(wang_tiling, ball, 0.0)))
    context = PlainContext(workers=2)
    WriteRaw(sheet=2).run(context, stack)
    evaluated = []
    decided = sampled_slices.FieldSlices.decided
    monkeypatch.setattr(sampled_slices.FieldSlices, "decided", lambda *args: evaluated.append(1) or decided(*args))
    again, told, _ = written(stack, 2)  # by workers, from their bits
    assert (again, told) == (files, numbers)
    here, told, _ = written(stack)  # by this process, from theirs
    assert (here, told) == (files, numbers)
    assert not evaluated
    for task in stack.island_pass.tasks:
        os.unlink(task.file)
    here, told, _ = written(stack)  # the folder is gone: evaluated again
    assert (here, told) == (files, numbers)
    assert len(evaluated) == len(stack.island_pass.tasks)


def test_what_one_process_has_kept_is_not_evaluated_by_workers(wang_tiling, ball):
    stack = field_slices(Part(wang_tiling, ball, 0.0))
    files, numbers, _ = written(stack)
    found, told, context = written(stack, 2)
    assert (found, told) == (files, numbers)
    assert {what for *_, what in context.progress_calls} == {"layers"}


def test_stacks_that_are_no_evaluation_stay_here():
    stack = ArraySlices(np.full((5, 4, 3), 255, np.uint8), (1.0, 1.0, 1.0))
    assert written(stack, 2)[0] == written(stack)[0]


def test_a_writer_that_can_not_travel_says_so(wang_tiling, small_slabs):
    @dataclass(frozen=True, kw_only=True)
    class Local(WriteRaw):
        """A class that nobody else finds."""

    context = PlainContext(workers=2)
    Local(sheet=0).run(context, field_slices(wang_tiling))
    assert len(context.warnings) == 1
    assert "Local, a class inside of a function" in context.warnings[0]


def test_slabs_cover_the_stack_and_begin_where_it_would_begin_one(wang_tiling, monkeypatch):
    monkeypatch.setattr(sampled_slices, "SLAB_PIXELS", 40 * 30 * 4)
    stack = field_slices(wang_tiling, gray_layers=2)
    assert stack.height == 4
    for workers, memory in ((1, 2**30), (3, 2**30), (50, 2**30), (2, 1)):
        tasks = slab_tasks(stack, workers, 1, memory)
        assert [task.start for task in tasks] == [0, *(task.stop for task in tasks[:-1])]
        assert tasks[-1].stop == stack.samples.shape[2]
        assert all(task.start % stack.height == 0 for task in tasks)
    assert len(slab_tasks(stack, 2, 1, 1)) == 2 * stack.shape[2] // 4  # as low as can be
    assert slab_passes.RESULTS_PER_WORKER == crew.AHEAD
    nx, ny, _ = stack.shape
    tasks = slab_tasks(stack, 1, 1, slab_passes.MEMORY_PER_RESULT * slab_passes.RESULTS_PER_WORKER * nx * ny * 5)
    assert max(task.stop - task.start for task in tasks) == 8  # 5 layers, in whole slabs of the stack


class FullDisk:
    """A file that can be opened and not written."""

    def write(self, data):
        raise OSError("no space")

    def close(self):
        pass


@pytest.mark.parametrize("how", ["damaged", "no room", "no folder", "disk full"])
def test_without_sound_bits_slabs_are_evaluated_again(wang_tiling, ball, small_slabs, monkeypatch, tmp_path, how):
    stack = field_slices(Part(wang_tiling, ball, 0.0))
    expected = stack.to_numpy() > 0
    if how == "no room":
        usage = namedtuple("usage", "free")
        monkeypatch.setattr(slab_passes.shutil, "disk_usage", lambda path: usage(100))
    if how == "disk full":
        monkeypatch.setattr(slab_passes.Path, "open", lambda path, mode: path.touch() or FullDisk())
    tasks = slab_tasks(stack, 2, 1, 2**30, tmp_path)
    assert all((task.file is None) == (how == "no room") for task in tasks)
    if how == "no folder":
        shutil.rmtree(tmp_path)
    survey = slab_passes.find_islands(stack, tasks, lambda tasks: (label_slab((stack, None), t) for t in tasks), print)
    there = sorted(tmp_path.glob("*")) if tmp_path.exists() else []
    assert len(there) == (len(tasks) if how == "damaged" else 0)  # nothing half written is left
    for file in there[::2]:
        file.write_bytes(file.read_bytes()[:-1])
    counts = {}
    found = np.concatenate([solid for task in survey.tasks for _, solid in cleared_slab(stack, task, counts)])
    assert np.array_equal(unpack(found, stack.shape[0]) > 0, expected)


KILLER = '''
import os, signal
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar
from sppm_pipeline import LayerWriter, option

SEEN = []

@dataclass(frozen=True, kw_only=True)
class WriteOnce(LayerWriter):
    """Raw layers; the first worker to have seen three dies of it."""
    name: ClassVar[str] = "write.once"
    suffix: ClassVar[str] = ".raw"
    path: str = option("layers", help="folder to write", output=True)
    mark: str = option(help="file that says that one has died, or nothing")

    def encode(self, image, stack):
        SEEN.append(1)
        if self.mark and len(SEEN) == 3 and not Path(self.mark).exists():
            Path(self.mark).touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return image.tobytes()
'''

PART = """sppm: 1
seed: 4
pipeline:
  - {{stage: sample.dart_throwing, total: 40}}
  - {{stage: connect.mst}}
  - {{stage: field.gaussian, pore_radius: 0.16, tunnel_radius: 0.04}}
  - {{stage: tile.periodic, cells: [2, 2, 2], cell: 2 mm}}
  - {{stage: slice.field, pixel: 0.1 mm, islands: remove}}
  - {{stage: write.once, mark: '{mark}'}}
"""


def test_real_workers_of_which_one_dies_in_the_middle_of_a_slab(tmp_path):
    (tmp_path / "once.py").write_text(KILLER)
    made = []
    for to, mark in (("serial", ""), ("workers", str(tmp_path / "dead"))):
        request = RunRequest(
            "part.yaml", plugins=(str(tmp_path / "once.py"),), text=PART.format(mark=mark), distributions=False
        )
        session, path, crew = open_session(request), tmp_path / to, None
        if mark:
            crew = WorkerPool(session.plugins, path, WorkerOptions(workers=2, threads=2))
        record = run_plan(session.plan(), path, threads=2, crew=crew)
        files = {
            file.name: file.read_bytes()
            for file in sorted(path.rglob("*"))
            if file.is_file() and file.name != "run.json"
        }
        made.append((files, record["stages"][-1]["summary"]))
    assert (tmp_path / "dead").exists()
    assert made[0] == made[1]
    assert len(made[0][0]) == 40 + 3  # manifest.json, the overview, SHA256SUMS
