"""Base class of tile rules: one method chooses the content of all cells."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass, replace
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, TypeVar

import numpy as np

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.method.families import options
from sppm_pipeline.method.fields.microstructure import Microstructure, made_of_kernels
from sppm_pipeline.method.fields.tileset import TileSet
from sppm_pipeline.method.fields.tiling import Tiling
from sppm_pipeline.method.nouns.cell_sizes import CellSizes
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.nouns.artifact import whole_numbers
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.nouns.palette import Blocks, Maps, Palette
from sppm_pipeline.nouns.size import Geometry, Size
from sppm_pipeline.services.arrays import F32, I64, Bools
from sppm_pipeline.stage import Context, Recipe, Stage

if TYPE_CHECKING:
    from sppm_pipeline.method.tiling.lattice import Laid

MEASURED_CLOSELY, COARSEST = 127, 6
"""Cells up to which the porosity is measured at the full resolution, and voxels along an edge that many are given."""

MANY_BOXES = 64
"""Boxes into which many cells are divided at least, each measured at places of its own in its cells. Tiles repeat: on a
grid of seven voxels, the same in all cells, 10 648 cells of 27 tiles were off by 0.017."""

SHIFTS = np.array([0.8191725134, 0.6710436067, 0.5497004779])
"""Steps of the additive recurrence that spreads these places evenly (Roberts 2018)."""

SPARE_SAMPLES = 2**20
"""Samples of a box of cells that is measured at once though most of them are not there (heuristic: only speed depends
on it)."""


class Lattice(NamedTuple):
    """The cells a tiler has to fill."""

    mask: Bools  # (nx, ny, nz), which cells are needed
    edge: float | None  # of a cell, mm
    origin: tuple[float, float, float]  # world position of the low corner of cell (0, 0, 0), mm


def lattice_for(
    cell: Length | None, cells: tuple[int, int, int] | None, cover: SurfaceMesh | None, own_edge: float | None
) -> Lattice:
    """The lattice that covers a part, or a box of cells; `ConfigError` if neither is given, or no size of a cell."""
    edge = cell.mm() if cell is not None else own_edge
    if cells is not None:
        return Lattice(np.ones(cells, bool), edge, (0.0, 0.0, 0.0))
    if cover is None:
        raise ConfigError(
            "there is no part to cover and no number of cells",
            hint="read a mesh before this stage, or give `cells: [4, 4, 4]`",
        )
    if edge is None:
        raise ConfigError("the size of a cell is missing", hint="give `cell: 7.5 mm`, or `edge` on the sampling stage")
    from sppm_pipeline.method.part.inside import cells_touched

    lower, upper = cover.lower, cover.upper
    # centered, so that opposite sides of a symmetric part are cut alike
    count = np.maximum(np.ceil((upper - lower) / edge - 1e-9), 1).astype(int)
    origin = (lower + upper - count * edge) / 2
    shape = (int(count[0]), int(count[1]), int(count[2]))
    mask = cells_touched(cover.vertices, cover.faces, origin, edge, shape, cover.bounds_solid)
    return Lattice(mask, edge, (float(origin[0]), float(origin[1]), float(origin[2])))


T = TypeVar("T", bound=Stage)


def designed(stage: T, design: CellSizes | Geometry | None) -> T:
    """The stage with the cell size and the porosity of a design where its options `cell` and `porosity` are omitted;
    `ConfigError` if something is omitted, and the design is one for other rules.
    """
    options: Any = stage
    if design is None or (options.cell is not None and options.porosity is not None):
        return stage
    lay = "scattered" if stage.name == "tile.scattered" else "cells"
    if isinstance(design, CellSizes) and design.lay != lay:
        raise ConfigError(
            f"the design before {stage.name} is one for `lay: {design.lay}`, whose struts and pores differ from those "
            "that are laid here",
            hint=f"give `design.sizes` the option `lay: {lay}`, or give `cell` and `porosity` here",
        )
    edge = None if design.edge_mm is None else Length(design.edge_mm, "mm")
    porosity = design.porosity if options.porosity is None else options.porosity
    return replace(options, cell=options.cell or edge, porosity=porosity)  # type: ignore[no-any-return]


def tiling_size(
    cell: Length | None, cells: tuple[int, int, int] | None, cover: Size | None, content: Size, **patches: float
) -> Size:
    """The size of a tiling: of a box of cells, or of those that cover a part.

    Cells that the surface of a part passes through are filled, too: half a cell on either side of it, and some corners.
    """
    edge = cell.mm() if cell is not None else content.body.edge_mm
    if cells is not None:
        # a box of cells is full: only the box limits it
        box, filled = tuple(map(float, cells)), math.inf
    elif cover is None or edge is None:
        raise LookupError("the lattice is unknown")
    else:
        part = cover.body.in_unit(edge)
        box = tuple(float(max(1, math.ceil(size - 1e-9))) for size in part.box)
        filled = part.volume + 0.7 * part.envelope + 8
    return content.in_box(box, filled, edge_mm=edge, **patches)


HALO = 1
"""Cells that are laid around a part or box: their kernels reach into it, and faces own the pores of their low edges
alone, so that none would lie on the far edges."""


def laid_cells(made: Size, periodic: bool) -> float:
    """Number of cells that are laid for a tiling of this size, its halo included."""
    if periodic:
        return made.cells
    x, y, z = (n + 2.0 * HALO for n in made.body.box)
    # a layer of cells on the surface, but no more than the box with its halo
    return min(x * y * z, made.cells + HALO * made.body.envelope)


TRIAL_BLOCKS = 2
"""Blocks along an edge of boxes that repeat, by which the porosity of scattered pores is known before they are laid."""

REPORTED_CELLS = 64
"""Cells, spread over the part, on which the errors that the last round leaves are measured and reported."""


class Scattering(NamedTuple):
    """Request for scattered pores, as options and inputs of `tile.scattered` say."""

    recipe: Recipe
    lattice: Lattice  # blocks that are needed
    # those that are laid, which include `HALO` around the needed ones unless the lattice repeats
    mask: Bools
    cover: SurfaceMesh | None  # the part
    periodic: bool
    porosity: float | None
    resolution: int
    rounds: int
    trials: int


def scattered_by_maps(context: Context, maps: Maps | None, wanted: Scattering) -> Tiling | None:
    """Pores that follow maps; None if there are none, or no map changes what is scattered."""
    if maps is None:
        return None
    # called by name, as maps belong to a feature and imports lead inwards only
    module, _, function = maps.scattered_by.partition(":")
    made: Tiling | None = getattr(import_module(module), function)(context, maps, wanted)
    return made


def without_faces(
    micro: Microstructure, blocks: Blocks, halo: int, edge: float | None, origin: tuple[float, float, float]
) -> Tiling:
    """The tiling of scattered blocks."""
    from sppm_pipeline.method.assembly.contents import TilingArrays

    none = [np.full(tuple(n + (a == axis) for a, n in enumerate(blocks.shape)), -1, np.int32) for axis in range(3)]
    arrays = TilingArrays(blocks.numbers, (none[0], none[1], none[2]), blocks.periodic, halo)
    return Tiling(TileSet(micro, "scattered", 0), arrays, edge, origin)


@dataclass(frozen=True, kw_only=True)
class LaidCells(Stage):
    """Base of stages that lay cells in a box, or over a part."""

    cell: Length | None = options.cell(None, note="in the part; the recipe's `edge` if omitted")
    cells: tuple[int, int, int] | None = options.cells(None)
    periodic: bool = options.periodic(False, note="those of the box of `cells`, which repeats")
    porosity: float | None = options.porosity(None, note="that of the part or box; the recipe's own level if omitted")
    resolution: int = options.resolution(32, note="for measuring the porosity", minimum=8, maximum=256)

    def check_options(self) -> None:
        """A part, which is no box of cells, does not repeat."""
        if self.periodic and self.cells is None:
            raise ConfigError("only a box of cells repeats", hint="give `cells: [3, 3, 3]`, or leave out `periodic`")

    def drawn_size(self, made: Size, laid: float, measured: float | None = None) -> Size:
        """The size of a tiling whose cells are all drawn, with the samples by which its porosity is measured."""
        if measured is None:
            per_edge = 0 if self.porosity is None else measured_per_edge(made.cells, self.resolution)
            measured = made.cells * float(per_edge) ** 3
        counts = {"cells": laid, "samples": measured, "sums": measured * made.body.kernels, "resident": measured}
        return made.at_porosity(self.porosity, **counts)

    def drawn(self, context: Context, recipe: Recipe, palette: Palette, what: str) -> Microstructure:
        """What a recipe makes for all cells; `ConfigError` if that has no pores and tunnels."""
        return made_of_kernels(recipe.run(context, palette=palette), recipe.name, f"{what} cells need")


@dataclass(frozen=True, kw_only=True)
class Tiler(LaidCells):
    """Base of tile rules: implement `lay`; `run` finds the cells that are needed, and cuts the field.

    Unless the box repeats, one more cell is laid on all sides, as if the box or part were cut out of a larger whole.
    The level is that at which what was laid has the porosity asked for: tiles differ by some percent in porosity, and
    a box or part holds some of them more often than others.
    """

    porosity: float | None = options.porosity(None, note="that of the part or box; that of the tile set if omitted")
    version: ClassVar[int] = 3
    kinds: ClassVar[tuple[str, ...]] = ("wang",)
    advice: ClassVar[str] = "give larger cells or fewer of them"

    @abstractmethod
    def lay(self, rng: np.random.Generator, mask: Bools, tileset: TileSet) -> Laid:
        """Choose the content of all cells in `mask`; if `periodic`, so that opposite ends of the box fit together.

        Parameters
        ----------
        rng : numpy.random.Generator
        mask : (nx, ny, nz) bool
            The cells of the part and, unless `periodic`, those around them.
        tileset : TileSet

        Returns
        -------
        interior : (nx, ny, nz) int32
            Interior of each cell, -1 where `mask` is False.
        faces : tuple of 3 int32 arrays
            Face colors; the array of axis a has one more entry along a: plane i is the low side of cell i. -1
            where no cell touches.
        """

    def estimate(self, palette: Palette, tileset: Size, cover: Size | None, design: Size | None = None) -> Size:
        self = designed(self, None if design is None else design.body)
        return measured_tiling(tiling_size(self.cell, self.cells, cover, tileset), self.resolution)

    def run(
        self, context: Context, tileset: TileSet, cover: SurfaceMesh | None, design: CellSizes | None = None
    ) -> Tiling:
        """Lay the cells."""
        self = designed(self, design)
        from sppm_pipeline.method.assembly.contents import TilingArrays
        from sppm_pipeline.method.tiling.lattice import with_halo

        if tileset.kind not in self.kinds:
            raise ConfigError(
                f"{self.name} lays tile sets of kind {' or '.join(self.kinds)}, this one is of kind {tileset.kind!r}",
                hint=f"use `tile.{KIND_TO_RULE[tileset.kind]}`, or draw the set with another `tileset` stage",
            )
        lattice = lattice_for(self.cell, self.cells, cover, tileset.micro.edge_mm)
        halo = 0 if self.periodic else HALO
        mask = with_halo(lattice.mask, halo)
        interior, faces = checked_lay(self.name, self.lay(context.rng(), mask, tileset), mask, tileset)
        # faces at both ends of a box that repeats are one
        if self.periodic and any((np.take(f, 0, axis) != np.take(f, -1, axis)).any() for axis, f in enumerate(faces)):
            raise ConfigError(f"{self.name} does not lay boxes that repeat", hint="use `tile.wang_3color`")
        tiling = Tiling(tileset, TilingArrays(interior, faces, self.periodic, halo), lattice.edge, lattice.origin)
        porosity = tileset.target if self.porosity is None else self.porosity
        if porosity is None:
            return tiling
        part = cover if self.cells is None else None  # a box lies where it lies, whatever mesh was read before
        return at_porosity(context, tiling, part, porosity, self.resolution)


def checked_lay(name: str, laid: Any, mask: Bools, tileset: TileSet) -> Laid:
    """Checked result of `lay` of the stage `name`.

    Raises ValueError if shapes, types or numbers are not those that `Tiler.lay` names.
    """
    from sppm_pipeline.method.assembly.contents import TilingArrays, check_tiling

    if not (isinstance(laid, tuple) and len(laid) == 2 and isinstance(laid[1], (tuple, list)) and len(laid[1]) == 3):
        raise ValueError(f"{name}.lay must return (interior, (faces of x, of y, of z)), got {type(laid).__name__}")
    interior, *faces = (whole_numbers(part, np.int32, f"what {name}.lay returns") for part in (laid[0], *laid[1]))
    if interior.shape != mask.shape:
        raise ValueError(
            f"{name}.lay must return interiors of the shape of `mask`, {mask.shape}, in the order x, y, z; got "
            f"{interior.shape}"
        )
    try:
        # whether the ends of a box that repeats agree is asked by `run`, with a hint of its own
        check_tiling(TilingArrays(interior, (faces[0], faces[1], faces[2]), False), tileset.micro.pieces)
    except ValueError as error:
        raise ValueError(f"{name}.lay: {error}") from None
    if ((interior >= 0) != mask).any():
        cell = tuple(np.argwhere((interior >= 0) != mask)[0].tolist())
        raise ValueError(
            f"{name}.lay must fill the cells of `mask` and no others (-1); cell {cell} is {interior[cell]}, and "
            f"mask{list(cell)} is {mask[cell]}"
        )
    return interior, (faces[0], faces[1], faces[2])


def measured_per_edge(cells: float, resolution: int) -> int:
    """Voxels along the edge of a cell at which `at_porosity` measures so many cells.

    Cells that are drawn one by one differ by some percent in porosity, and those at the rim count by the share that
    lies in the part. So all of them are measured, and the more there are, the fewer samples each takes; fewer than
    `COARSEST` would see where in a cell they lie.
    """
    if cells <= MEASURED_CLOSELY:
        return resolution
    return max(min(COARSEST, resolution), int(resolution * (MEASURED_CLOSELY / cells) ** (1 / 3)))


def measured_tiling(made: Size, resolution: int) -> Size:
    """The size of a tiling with the work of `at_porosity`."""
    measured = made.grid(measured_per_edge(made.cells, resolution))
    return replace(made, samples=measured.samples, sums=measured.sums, resident=measured.samples)


def boxes_of(cells: I64, spare: float, most: float = np.inf) -> list[tuple[I64, tuple[int, int, int]]]:
    """Low corners and shapes of boxes that hold these cells, (n, 3), each once, and no more than `most` in a box.

    Half of a box are cells that it is to hold, or it has no more than `spare` altogether: a layer of a ring or frame
    would be hollow.
    """
    lower, size = cells.min(0), np.ptp(cells, 0) + 1
    if size.prod() <= max(2 * len(cells), spare) and len(cells) <= max(most, 1):
        return [(lower, (int(size[0]), int(size[1]), int(size[2])))]
    # halves along the longest axis, until no box is mostly empty
    axis = int(size.argmax())
    low = cells[:, axis] < lower[axis] + size[axis] // 2
    return [*boxes_of(cells[low], spare, most), *boxes_of(cells[~low], spare, most)]


def at_porosity(
    context: Context, tiling: Tiling, cover: SurfaceMesh | None, porosity: float, resolution: int
) -> Tiling:
    """The tiling cut at the level that gives this porosity, within the part if there is one.

    Few cells are measured one by one, at `resolution` voxels along an edge; many in layers, or pieces of these, at
    `measured_per_edge`. Where tiles repeat, each piece has a grid that is shifted by itself.
    """
    from sppm_pipeline.method.part.part import Part
    from sppm_pipeline.method.porosity.level import level_for_porosity
    from sppm_pipeline.services.grid import Grid

    micro, mask = tiling.tileset.micro, tiling.arrays.surrounded().interior >= 0
    filled = np.argwhere(mask)
    per_edge = measured_per_edge(len(filled), resolution)
    h = 1.0 / per_edge
    part = None if cover is None else Part(tiling, cover, 0.0, "keep")

    def samples_of(corner: I64, shape: tuple[int, int, int], number: int = 0) -> F32:
        (x, y, z), (nx, ny, nz) = corner + h * ((0.5 + number * SHIFTS) % 1), shape  # voxel centers in the first box
        grid = Grid((x, y, z), (h,) * 3, (nx * per_edge, ny * per_edge, nz * per_edge))
        sums = tiling.sums(grid, context.threads)
        if part is not None:
            within: F32 = sums.T[part.inside_zyx(grid, 0, grid.shape[2]) != 0]
            return within
        inside = mask[tuple(slice(low, low + n) for low, n in zip(corner, shape, strict=True))]
        for axis in range(3):
            inside = inside.repeat(per_edge, axis)
        return sums[inside]

    if len(filled) <= MEASURED_CLOSELY:
        found = [samples_of(cell, (1, 1, 1)) for cell in filled]
    else:
        # boxes within a layer bound the memory of the samples that are not needed
        layers = (filled[filled[:, 2] == z] for z in np.unique(filled[:, 2]))
        interiors = tiling.arrays.interior
        repeats = len(np.unique(interiors[interiors >= 0])) < len(filled)
        spare, most = SPARE_SAMPLES / per_edge**3, len(filled) / MANY_BOXES if repeats else np.inf
        boxes = [box for cells in layers for box in boxes_of(cells, spare, most)]
        found = [samples_of(*box, number if repeats else 0) for number, box in enumerate(boxes)]
    samples = np.concatenate(found)
    if not samples.size:
        raise DesignError(
            f"no voxel of {per_edge} along a cell edge lies in the part, so that its porosity can't be measured",
            hint="raise `resolution`, or give smaller cells",
        )
    # a quantile of G: the share of samples below the level is the solid
    micro = micro.with_level(level_for_porosity(samples, porosity).level)
    return replace(tiling, tileset=replace(tiling.tileset, micro=micro))


KIND_TO_RULE = {"wang": "wang_3color", "free": "free_faces", "corner": "corner_colors"}
"""The built-in rule for each kind of tile set."""
