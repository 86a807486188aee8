"""Layers that the workers of a run evaluate and encode slab by slab; finished bytes come back, pixels do not travel."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Collection, Iterator
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.method.slicing.sampled_slices import SampledSlices, add_counts
from sppm_pipeline.method.slicing.slab_passes import (
    IslandPass,
    SlabTask,
    cleared_slab,
    find_islands,
    label_slab,
    slab_tasks,
)
from sppm_pipeline.method.slicing.slice_stack import SliceStack
from sppm_pipeline.nouns.storage import NotStorable, stored_bytes
from sppm_pipeline.services.arrays import U8, U64
from sppm_pipeline.services.threads import ordered_map
from sppm_pipeline.stage import Context


class Encoder(Protocol):
    """A stage that encodes layers; see `LayerWriter`."""

    def takes_bits(self, stack: SliceStack) -> bool: ...

    def encode(self, image: U8, stack: SliceStack) -> bytes: ...

    def encode_bits(self, rows: U64, stack: SliceStack) -> bytes: ...


def encoded_bits(writer: Encoder, rows: U64, stack: SliceStack) -> bytes:
    """A layer of black and white that is there as bits, (ny, words), the side of largest y first."""
    return writer.encode_bits(rows, stack) if writer.takes_bits(stack) else writer.encode(image_of(rows, stack), stack)


def image_of(rows: U64, stack: SliceStack) -> U8:
    """Such a layer as `LayerWriter.encode` takes it."""
    from sppm_pipeline.services.bit_rows import unpack

    image: U8 = unpack(rows[None], stack.shape[0], 255)[0]
    return image


class EncodedSlab(NamedTuple):
    """Result of a worker."""

    layers: list[bytes]
    pictures: dict[int, bytes]  # compressed pixels of the layers that were asked for
    voxels: int  # solid samples
    counts: dict[str, int]  # see `SampledSlices.decided`


def encode_slab(common: tuple[SampledSlices, Encoder], task: SlabTask) -> EncodedSlab:
    """Second pass: evaluate a slab, or read its bits, take the islands out, and encode its layers."""
    stack, writer = common
    from sppm_pipeline.services.bit_rows import count

    made = EncodedSlab([], {}, 0, {})
    voxels, gray = 0, stack.gray

    def layers() -> Iterator[NDArray[Any]]:
        nonlocal voxels
        for start, solid in cleared_slab(stack, task, made.counts):
            voxels += count(solid)
            for number, layer in enumerate(stack.shaded(solid) if gray else solid, start // stack.sublayers):
                image = layer[::-1].copy()
                if number in task.shown:
                    # level 1: pictures only pass from process to process
                    made.pictures[number] = zlib.compress((image if gray else image_of(image, stack)).data, 1)
                yield image

    def encoded(layer: NDArray[Any]) -> bytes:
        return writer.encode(layer, stack) if gray else encoded_bits(writer, layer, stack)

    made.layers.extend(ordered_map(encoded, layers(), task.threads))
    return made._replace(voxels=voxels)


def divides(context: Context, stack: SliceStack, writer: Encoder) -> bool:
    """True if the layers of a stack are made by the workers of a run."""
    if not context.workers or not isinstance(stack, SampledSlices) or stack.is_kept:
        return False
    if not context.worth_workers(math.prod(stack.samples.shape)):
        return False
    try:
        # tried here, as an error in a worker would come too late to fall back
        stored_bytes((stack, writer))
    except NotStorable as error:
        context.warn(f"one process makes all layers, as workers can't be handed {error}")
        return False
    return True


class DividedLayers:
    """Encoded layers from the lowest, made by workers; `findings` are empty until the last layer was taken.

    `show` is given the pixels of the layers `shown`, the lowest first.
    """

    def __init__(
        self, context: Context, stack: SampledSlices, writer: Encoder, shown: Collection[int],
        show: Callable[[int, U8], None],
    ) -> None:  # fmt: skip
        self._context, self._stack, self._shown, self._show = context, stack, shown, show
        self._common = (stack, writer)
        self.findings: dict[str, Any] = {}

    def __iter__(self) -> Iterator[bytes]:
        context, stack = self._context, self._stack
        nx, ny, _ = stack.shape
        keep, known = stack.islands == "keep", stack.island_pass is not None
        island_pass = None if keep else stack.island_pass or self._find_islands()
        tasks = island_pass.tasks if island_pass is not None else slab_tasks(stack, *self._means)
        wanted = [task._replace(shown=tuple(self._of(task))) for task in tasks]
        voxels, counts = 0, dict[str, int]()
        # the search for islands is the first half of the work
        before, total = (0, len(tasks)) if keep or known else (len(tasks), 2 * len(tasks))
        for number, made in enumerate(context.map(encode_slab, wanted, self._common), 1):
            voxels += made.voxels
            add_counts(counts, made.counts)
            for layer, data in made.pictures.items():
                self._show(layer, np.frombuffer(zlib.decompress(data), np.uint8).reshape(ny, nx))
            yield from made.layers
            context.progress(before + number, total, "slabs, encoded")
        if island_pass is None:
            self.findings = stack.findings({}, voxels, stack.summary_of_counts(counts))
        else:
            self.findings = stack.findings(island_pass.islands, voxels, island_pass.summary)

    @property
    def _means(self) -> tuple[int, int, int]:
        return self._context.workers, self._context.worker_threads, self._context.memory

    def _of(self, task: SlabTask) -> list[int]:
        m = self._stack.sublayers
        return [number for number in range(task.start // m, task.stop // m) if number in self._shown]

    def _find_islands(self) -> IslandPass:
        context = self._context
        tasks = slab_tasks(self._stack, *self._means, context.shared_folder())
        return find_islands(
            self._stack, tasks, lambda tasks: context.map(label_slab, tasks, self._common),
            lambda ready: context.progress(ready, 2 * len(tasks), "slabs, searched for islands"),
        )  # fmt: skip
