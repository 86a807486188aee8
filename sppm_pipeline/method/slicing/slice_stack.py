"""Stacks of layers that are computed while they are read."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from sppm_pipeline.errors import SppmError
from sppm_pipeline.method.nouns.printer import Printer, cards
from sppm_pipeline.method.slicing.spool import IN_MEMORY
from sppm_pipeline.nouns.artifact import Artifact, frozen
from sppm_pipeline.nouns.size import Geometry, Size
from sppm_pipeline.services.arrays import U8

Slab = tuple[int, U8]
"""Index of the first layer, and layers indexed [layer, y, x], rows in order of increasing y."""


class Slabs:
    """The slabs of a stack in one pass from the bottom, and the findings on the way.

    Attributes
    ----------
    findings : dict
        Empty until the last slab was read; then for instance the solid volume and the fraction of islands removed.
    """

    def __init__(self, source: Generator[Slab, None, dict[str, Any]]) -> None:
        self._source = source
        self.findings: dict[str, Any] = {}

    def __iter__(self) -> Iterator[Slab]:
        self.findings = yield from self._source


class SliceStack(Artifact, ABC):
    """Layers of a part, delivered slab by slab from the bottom, never all in memory.

    A stack of pictures, not a volume: its arrays are indexed [layer, y, x], as libraries for images have them
    (tifffile, ImageJ, scikit-image), and each layer is a C-contiguous picture.

    Layer k is the section at mid-height, ``origin z + (k + 1/2) * layer_mm``; pixel (i, j) is the rectangle around
    ``origin + ((i + 1/2) * pixel_mm[0], (j + 1/2) * pixel_mm[1])``.

    Attributes
    ----------
    pixel_mm : tuple of 2 floats
        Pixel pitch along x and y.
    layer_mm : float
        Layer height.
    shape : tuple of 3 ints
        Pixels along x and y, number of layers.
    origin_mm : tuple of 3 floats
        World position of the low corner of the stack.
    printer : Printer or None
        The printer that the layers were cut for.
    """

    _fault: Callable[[str], Exception] | None = None

    @property
    @abstractmethod
    def pixel_mm(self) -> tuple[float, float]: ...

    @property
    @abstractmethod
    def layer_mm(self) -> float: ...

    @property
    @abstractmethod
    def shape(self) -> tuple[int, int, int]: ...

    @property
    def origin_mm(self) -> tuple[float, float, float]:
        return (0.0, 0.0, 0.0)

    @property
    def printer(self) -> Printer | None:
        return None

    @abstractmethod
    def read(self, threads: int) -> Generator[Slab, None, dict[str, Any]]:
        """Yield the slabs, and return the findings; see `slabs`."""

    def slabs(self, threads: int = 1) -> Slabs:
        """The layers, bottom first: 0 (void) to 255 (solid), binary stacks hold nothing between.

        Each array may be changed or reused by the stack when the next one is asked for. Each is checked, and an error
        names the plugin whose stage has made the stack.
        """
        return Slabs(self._checked(threads))

    def attribute(self, fault: Callable[[str], Exception]) -> None:
        """See `Artifact.attribute`; the first stage that had the stack has made it."""
        if self._fault is None:
            object.__setattr__(self, "_fault", fault)

    def _checked(self, threads: int) -> Generator[Slab, None, dict[str, Any]]:
        """The slabs of `read`: layers one after the other, all of one size and type, as many as announced."""
        fault = self._fault or ValueError
        nx, ny, nz = self.shape
        below = 0
        read: Any = self.read(threads)  # whatever a subclass returns
        if not isinstance(read, Generator):
            raise fault(f"whose `read` gives {type(read).__name__}, expected a generator")
        slabs: Any = self._watched(read)
        try:
            while True:
                try:
                    slab = next(slabs)
                except StopIteration as end:
                    findings = end.value
                    break
                if not (isinstance(slab, tuple) and len(slab) == 2 and isinstance(slab[1], np.ndarray)):
                    raise fault(f"that delivers {type(slab).__name__}, expected (index of the first layer, array)")
                start, layers = slab
                if layers.dtype != np.uint8 or layers.ndim != 3 or layers.shape[1:] != (ny, nx) or not len(layers):
                    raise fault(
                        f"that delivers layers as {layers.dtype} of shape {layers.shape}, expected uint8 of shape "
                        f"(layers, {ny}, {nx}), as its `shape` is {(nx, ny, nz)}"
                    )
                if start != below or start + len(layers) > nz:
                    raise fault(f"that delivers layers {start} to {start + len(layers) - 1} after {below} of {nz}")
                # checked slab by slab, so that a faulty plugin is named before much is written
                below += len(layers)
                yield start, layers
        finally:
            # a reader may stop early; generators of sources then free their files
            slabs.close()
        if below != nz:
            raise fault(f"that delivers {below} layers and announces {nz}")
        if not isinstance(findings, dict):
            raise fault(f"whose `read` returns {type(findings).__name__}, expected a dict of findings")
        return findings

    def _watched(self, slabs: Generator[Any, None, Any]) -> Generator[Any, None, Any]:
        """The same slabs; an error names the plugin whose stage has made the stack."""
        try:
            return (yield from slabs)
        except (SppmError, MemoryError, OSError):
            raise
        except Exception as error:
            if self._fault is None:
                raise
            raise self._fault(f"that raised {type(error).__name__} when it was read: {error}") from error

    def to_numpy(self, threads: int = 1) -> U8:
        """All layers at once, uint8 [layer, y, x]; its transpose is the volume [x, y, z]. For what fits into memory."""
        return np.concatenate([slab.copy() for _, slab in self.slabs(threads)])

    def __len__(self) -> int:
        """The number of layers."""
        return self.shape[2]

    def __iter__(self) -> Iterator[U8]:
        """The layers one by one, bottom first, each [y, x]."""
        for _, layers in self.slabs():
            yield from layers.copy()

    def __getitem__(self, which: int | slice) -> U8:
        """A layer [y, x], or a slice of them [layer, y, x]; those below are computed on the way."""
        nx, ny, nz = self.shape
        try:
            wanted = range(nz)[which]
        except IndexError:
            raise IndexError(f"the stack has {nz} layers, got {which}") from None
        numbers = wanted if isinstance(wanted, range) else (wanted,)
        found: dict[int, U8] = {}
        for start, layers in self.slabs() if numbers else ():
            found |= {k: layers[k - start].copy() for k in numbers if start <= k < start + len(layers)}
            if len(found) == len(numbers):
                break
        chosen = np.array([found[k] for k in numbers], np.uint8).reshape(-1, ny, nx)
        return chosen if isinstance(wanted, range) else chosen[0]

    @staticmethod
    def from_array(
        layers: ArrayLike,
        *,
        pixel_mm: float | tuple[float, float],
        layer_mm: float | None = None,
        printer: Printer | None = None,
    ) -> SliceStack:
        """Layers that are there already.

        Parameters
        ----------
        layers : (layers, ny, nx) array_like
            Truth values (True is solid), or integers from 0 (void) to 255 (solid); rows in order of increasing y.
        pixel_mm : float or (float, float)
            Pitch along x and y; one number for square pixels.
        layer_mm : float, optional
            `pixel_mm` if omitted; only square pixels do without.
        printer : Printer, optional
            The printer that they were cut for.

        Raises
        ------
        ValueError
            If a value is out of range or the array has not three axes.
        """
        px, py = pixel_mm if isinstance(pixel_mm, tuple) else (pixel_mm, pixel_mm)
        if layer_mm is None and px != py:
            raise ValueError(f"pixels of {px:g} x {py:g} mm don't tell how high a layer is; give `layer_mm`")
        pitch = (float(px), float(py), float(px if layer_mm is None else layer_mm))
        values = np.asarray(layers)
        if values.ndim != 3 or not values.size or values.dtype.kind not in "biu":
            raise ValueError(f"layers need three axes of integers, got shape {values.shape} of {values.dtype}")
        if values.dtype.kind == "b":
            values = values * np.uint8(255)
        if not 0 <= values.min() <= values.max() <= 255:
            raise ValueError("layers hold integers from 0 (void) to 255 (solid)")
        # a copy: the caller may go on to change the array
        stack = ArraySlices(frozen(values.astype(np.uint8)), pitch, printer)
        stack.check()
        return stack

    @property
    def gray(self) -> bool:
        """True if values between 0 and 255 occur."""
        return False

    def check(self) -> None:
        """Pixel pitch along x and y, and layer height, are positive lengths."""
        pitch: Any = self.pixel_mm  # whatever a subclass returns
        if not isinstance(pitch, tuple) or len(pitch) != 2:
            raise ValueError(f"`pixel_mm` of a stack is its pitch along x and y, not {pitch!r}")
        if not all(0 < length < math.inf for length in (*pitch, self.layer_mm)):
            raise ValueError(f"pixels of {pitch[0]} x {pitch[1]} mm and layers of {self.layer_mm} mm can't be printed")

    def require_room(self, own: Path | None = None) -> Self:
        """The stack, unless it was cut for a printer that is smaller than the part.

        Parameters
        ----------
        own : Path, optional
            File of further printers, among which one that holds the part is looked for.

        Raises
        ------
        DesignError
            With the smallest printer that holds the part.
        """
        if self.printer is not None:
            (nx, ny, nz), (hx, hy) = self.shape, self.pixel_mm
            self.printer.require_room((nx * hx, ny * hy, nz * self.layer_mm), cards(own).printers.values())
        return self

    def summary(self) -> dict[str, Any]:
        """Size and pitch."""
        nx, ny, nz = self.shape
        made = {"pixels": [nx, ny], "layers": nz, "pixel_mm": list(self.pixel_mm), "layer_mm": self.layer_mm}
        return made if self.printer is None else {**made, "printer": self.printer.name}


class Pitched(SliceStack):
    """Base of layers that keep their pitch and the printer they are cut for themselves."""

    pitch: tuple[float, float, float]
    machine: Printer | None

    @property
    def printer(self) -> Printer | None:
        return self.machine

    @property
    def pixel_mm(self) -> tuple[float, float]:
        return self.pitch[:2]

    @property
    def layer_mm(self) -> float:
        return self.pitch[2]


@dataclass(frozen=True, eq=False)
class ArraySlices(Pitched):
    """Layers that are there already, uint8 [layer, y, x], with the low corner of the stack at the origin."""

    layers: U8
    pitch: tuple[float, float, float]
    machine: Printer | None = None

    @property
    def shape(self) -> tuple[int, int, int]:
        nz, ny, nx = self.layers.shape
        return nx, ny, nz

    @property
    def gray(self) -> bool:
        return bool(((self.layers > 0) & (self.layers < 255)).any())

    def read(self, threads: int) -> Generator[Slab, None, dict[str, Any]]:
        for start, layer in enumerate(self.layers):
            yield start, layer[None].copy()
        (nx, ny, nz), (hx, hy, hz) = self.shape, self.pitch
        solid = float(self.layers.sum(dtype=np.float64)) / 255
        return {
            "solid_voxels": int(np.count_nonzero(self.layers)),
            "solid_share_of_box": solid / (nx * ny * nz),
            "solid_volume_mm3": solid * (hx * hy) * hz,
        }


def stack_size(
    body: Geometry, pitch: tuple[float, float, float], gray: int, gray_layers: int = 1, kept: bool = False
) -> Size:
    """The size of a stack of a body sliced at a pixel pitch (x, y) and a layer height (mm), and of the work for it.

    Finding islands takes a pass of its own: the layers are `kept` for the second one, see `Spool`.
    """
    per_edge = [body.scale / p for p in pitch]
    nx, ny, nz = (max(1, round(side * n)) for side, n in zip(body.box, per_edge, strict=True))
    each = gray**2 * gray_layers
    samples = float(nx) * ny * nz * each
    held = min(samples / 8, IN_MEMORY) if kept else 0.0
    along = per_edge[0] * gray
    others = (per_edge[1] * gray, per_edge[2] * gray_layers)
    # commensurate pitches repeat from cell to cell, so patches serve
    even = abs(along - round(along)) < 1e-6 and max(abs(n / along - 1) for n in others) < 1e-9
    inside = body.volume * math.prod(per_edge) * each
    # the height of slabs as `SampledSlices` chooses it
    slab = min(samples, max(2.0**22, nx * ny * each))
    pixel, layer = math.sqrt(pitch[0] * pitch[1]), pitch[2]
    outline = body.outline(pixel / body.scale, layer / body.scale)
    return Size(
        samples=samples, sums=body.sums(inside, along, commensurate=even), resident=slab + held / 8,
        pixels=nx * ny, layers=nz, outline=outline * (6 if each > 1 else 1), geometry=body,
    )  # fmt: skip
