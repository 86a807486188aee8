"""Layers in slabs that workers go through apart from each other: once to find islands, once to deliver.

The bits of the first pass stay in a file for each slab, in a folder that all workers see, so that the second one need
not evaluate them again. If such a file is missing or incomplete, the slab is evaluated.
"""

from __future__ import annotations

import contextlib
import math
import os
import shutil
import socket
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from sppm_pipeline.method.slicing.sampled_slices import BitSlab, SampledSlices, add_counts
from sppm_pipeline.method.slicing.spool import MAX_DISK_SHARE
from sppm_pipeline.services.arrays import U64, Bools

if TYPE_CHECKING:
    from sppm_pipeline.method.connectivity.streaming import SlabLabels

MIN_SLABS = 6
"""Slabs for each worker at least: at the end workers wait for a sixth of their work at most. Half as many slabs double
that wait; twice as many halve it, for more and smaller results."""

MEMORY_PER_RESULT = 16
"""Bytes of memory for each byte of encoded slabs, all together: they are small beside the work of the workers, and
half as much room only makes slabs lower."""

RESULTS_PER_WORKER = 2
"""Encoded slabs of a worker that may wait at once: a worker is given as many tasks ahead."""


class SlabTask(NamedTuple):
    """A slab for a worker."""

    start: int  # first sheet of samples
    stop: int  # the one after the last
    threads: int
    file: str | None = None  # where the bits of the first pass lie or are to lie
    verdict: Bools | None = None  # (n_ids,), whether ids stay, in the second pass; None to keep everything
    shown: tuple[int, ...] = ()  # layers whose pixels are wanted, too


class LabeledSlab(NamedTuple):
    """Result of the first pass over a slab."""

    labels: SlabLabels
    counts: dict[str, int]


def slab_tasks(
    stack: SampledSlices, workers: int, threads: int, memory: int, folder: Path | None = None
) -> list[SlabTask]:
    """Slabs of a stack for workers of some threads each, from the bottom.

    They begin where the stack itself would begin one. Their height bounds the encoded layers that a worker hands back.
    `memory` is in bytes; the bits of the first pass are kept in the folder, if the disk has room for them.
    """
    nx, ny, layers = stack.shape
    each = nx * ny if stack.gray else nx * ny / 8  # bytes of a layer that can't be compressed
    highest = int(memory / (MEMORY_PER_RESULT * RESULTS_PER_WORKER * workers) / each)
    height = max(1, min(-(-layers // (MIN_SLABS * workers)), highest)) * stack.sublayers
    # where the stack begins its own slabs, so that fields that depend on the slab agree to the bit
    height = max(1, height // stack.height) * stack.height
    *across, sheets = stack.samples.shape
    if folder is not None and math.prod(across) * sheets / 8 > MAX_DISK_SHARE * shutil.disk_usage(folder).free:
        folder = None
    return [
        SlabTask(start, min(start + height, sheets), threads, None if folder is None else str(folder / f"{start}.bits"))
        for start in range(0, sheets, height)
    ]


def label_slab(common: tuple[SampledSlices, Any], task: SlabTask) -> LabeledSlab:
    """First pass: evaluate a slab, keep its bits, and label its components."""
    from sppm_pipeline.method.connectivity.streaming import IslandFilter

    stack = common[0]
    nx, ny, _ = stack.samples.shape
    islands, counts = IslandFilter(ny, nx), dict[str, int]()
    with _Bits(task.file) as bits:  # the second pass reads them, maybe in another process
        for _, solid in _evaluated(stack, task, counts):
            islands.observe(solid)
            bits.add(solid)
    return LabeledSlab(islands.labels(), counts)


def cleared_slab(stack: SampledSlices, task: SlabTask, counts: dict[str, int]) -> Iterator[BitSlab]:
    """Second pass: the sheets of a slab without islands, from its bits or evaluated again."""
    nx, ny, _ = stack.samples.shape
    sheets = _read(stack, task)
    if sheets is None:
        sheets = _evaluated(stack, task, counts)
    # most slabs of a dense part have no islands
    if task.verdict is None or task.verdict.all():
        yield from sheets
        return
    from sppm_pipeline.method.connectivity.streaming import IslandFilter

    islands = IslandFilter.decided(ny, nx, task.stop - task.start, task.verdict)
    for start, solid in sheets:
        islands.clear(solid)
        yield start, solid


@dataclass(frozen=True)
class IslandPass:
    """Result of the first pass over all slabs; `islands` and `summary` as in `SampledSlices.findings`."""

    tasks: tuple[SlabTask, ...]  # for the second pass
    islands: dict[str, Any]
    summary: dict[str, Any]

    def cleared(self, stack: SampledSlices, threads: int) -> Iterator[BitSlab]:
        """All sheets without islands, in this process."""
        for task in self.tasks:
            yield from cleared_slab(stack, task._replace(threads=threads), {})


def find_islands(
    stack: SampledSlices,
    tasks: Sequence[SlabTask],
    run: Callable[[Iterable[SlabTask]], Iterator[LabeledSlab]],
    progress: Callable[[int], None],
) -> IslandPass:
    """Make the first pass by workers; the stack keeps the result for its next reader.

    `run` has workers call `label_slab` for each task, in order; `progress` is called with the number of slabs ready.
    """
    from sppm_pipeline.method.connectivity.slab_union import SlabUnion

    union, counts = SlabUnion(), dict[str, int]()
    for number, found in enumerate(run(tasks), 1):
        union.add(found.labels)
        add_counts(counts, found.counts)
        progress(number)
    statistics, verdicts = union.finish()
    # each slab gets the verdict on its own ids alone
    second = tuple(task._replace(verdict=verdict) for task, verdict in zip(tasks, verdicts, strict=True))
    summary = stack.summary_of_counts(counts)
    island_pass = IslandPass(second, stack.removal(statistics, summary), summary)
    stack.keep(island_pass)
    return island_pass


def _evaluated(stack: SampledSlices, task: SlabTask, counts: dict[str, int]) -> Iterator[BitSlab]:
    if stack not in _PREPARED:
        _PREPARED[stack] = stack.prepared()
    return stack.decided(task.threads, counts, task.start, task.stop, _PREPARED[stack])


_PREPARED: WeakKeyDictionary[SampledSlices, Any] = WeakKeyDictionary()
"""Data that a worker needs for every slab of a stack."""


class _Bits:
    """Writer of the bits of a slab, whole or not at all; on a full disk the slab is evaluated again instead."""

    def __init__(self, file: str | None) -> None:
        self._final = None if file is None else Path(file)
        # two workers may be given the same slab if one is taken for dead
        self._part = Path(f"{file}.{socket.gethostname()}-{os.getpid()}")
        self._open: IO[bytes] | None = None

    def __enter__(self) -> _Bits:
        if self._final is not None:
            with contextlib.suppress(OSError):
                self._open = self._part.open("wb")
        return self

    def add(self, solid: U64) -> None:
        """Append sheets."""
        if self._open is not None:
            try:
                self._open.write(solid.data)
            except OSError:
                self._drop()

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        if self._open is None:
            return
        try:
            self._open.close()
            if kind is None and self._final is not None:
                # atomic: a reader finds all of the slab or nothing
                os.replace(self._part, self._final)
                return
        except OSError:
            pass
        self._drop()

    def _drop(self) -> None:
        if self._open is not None:
            with contextlib.suppress(OSError):
                self._open.close()
            self._open = None
        with contextlib.suppress(OSError):
            self._part.unlink()


def _read(stack: SampledSlices, task: SlabTask) -> Iterator[BitSlab] | None:
    """The sheets of a slab from its bits; None if they are not all there."""
    from sppm_pipeline.services.bit_rows import words_of

    nx, ny, _ = stack.samples.shape
    spans = list(stack.spans(task.start, task.stop))
    words = words_of(nx)
    try:
        if task.file is None or os.stat(task.file).st_size != 8 * (task.stop - task.start) * ny * words:
            return None
        opened = open(task.file, "rb")  # noqa: SIM115  # closed by its reader, below
    except OSError:
        return None

    def sheets() -> Iterator[BitSlab]:
        with opened:
            for start, stop in spans:
                shape = (stop - start, ny, words)
                yield start, np.fromfile(opened, np.uint64, math.prod(shape)).reshape(shape)

    return sheets()
