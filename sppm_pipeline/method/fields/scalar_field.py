"""The scalar field whose negative part is solid, and fields that are made from another one."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Self, cast

import numpy as np

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.nouns.artifact import Artifact, frozen, optional_module
from sppm_pipeline.services.arrays import F32, I32, U8, U64, Bools
from sppm_pipeline.services.grid import Grid, cell_centers

if TYPE_CHECKING:
    from sppm_pipeline.method.nouns.mesh import SurfaceMesh
    from sppm_pipeline.method.nouns.voxels import Voxels


RESOLVED = 1.2
"""Voxels up to this many tunnel radii keep the void in one piece, as measured on cells of the paper."""

RESOLVED_WALL = 1 / math.sqrt(3)
"""Voxels up to this share of its thickness keep a wall of any direction in one piece across their faces."""


class ScalarField(Artifact, ABC):
    """A field ``G - C`` over a lattice of unit cells: negative inside the solid, positive in pores and tunnels.

    It is no distance. Positions are in cell sizes, measured from the lattice origin; `edge_mm` and `origin_mm` say
    where that is in the world. Nothing is computed before it is sampled.

    Samples are indexed x, y, z. The program's own kernels go along rows of x, with z outermost; they get the same
    memory by `sample_zyx` and `solid_zyx`, at no cost if x is contiguous.

    Attributes
    ----------
    cells : tuple of 3 ints
        Extent of the described region.
    periodic : bool
        Whether the region repeats for ever; otherwise the field is defined in ``[0, cells]``.
    """

    @property
    @abstractmethod
    def cells(self) -> tuple[int, int, int]: ...

    @property
    @abstractmethod
    def periodic(self) -> bool: ...

    def check(self) -> None:
        """Cells there are, and a few samples are numbers of the right shape.

        Classes that are known to sample rightly check what they are made of instead.
        """
        cells = tuple(self.cells)
        if len(cells) != 3 or not all(isinstance(n, (int, np.integer)) and n > 0 for n in cells):
            raise ValueError(f"`cells` of a field are 3 whole numbers above 0, got {cells}")
        edge: Any = self.edge_mm  # whatever a subclass returns
        if edge is not None and not 0 < edge < math.inf:
            raise ValueError(f"`edge_mm` of a field is a length above 0, or None, got {edge}")
        # no two sides are equal, so that axes in another order show
        probe = Grid((0.17, 0.23, 0.31), (0.21, 0.13, 0.27), (2, 4, 3))
        values: Any = self.sample_layers(probe, 0, 3)
        if not isinstance(values, np.ndarray) or values.shape != probe.shape or values.dtype != np.float32:
            got = f"{values.dtype} {values.shape}" if isinstance(values, np.ndarray) else type(values).__name__
            raise ValueError(f"samples of 2 x 4 x 3 points (x, y, z) are float32 of the shape (2, 4, 3), got {got}")
        if not np.isfinite(values).all():
            raise ValueError(f"samples of a field are finite numbers, got {values[~np.isfinite(values)][0]}")

    @property
    def edge_mm(self) -> float | None:
        """Edge of a cell in millimeters; None if it has no physical size."""
        return None

    @property
    def origin_mm(self) -> tuple[float, float, float]:
        """Position of the lattice origin in the world."""
        return (0.0, 0.0, 0.0)

    @abstractmethod
    def sample_layers(self, grid: Grid, start: int, stop: int, threads: int = 1) -> F32:
        """Values in the layers start <= k < stop of a grid (cell sizes), (nx, ny, stop - start) float32.

        A sample depends on its position alone: not on the number of threads, nor on the layers that are asked for. Any
        order in memory will do; where x is contiguous nothing has to be copied. The result is not modified,
        so it may be an array that the field keeps.
        """

    def sample(self, grid: Grid | int, threads: int = 1) -> F32:
        """Values at the points of a grid (cell sizes), (nx, ny, nz) float32, x contiguous in memory.

        Parameters
        ----------
        grid : Grid or int
            An integer means the voxel centers of all `cells`, so many along a cell edge.
        threads : int
        """
        grid = self._grid(grid)
        return self.sample_zyx(grid, 0, grid.shape[2], threads).T

    def solid(self, grid: Grid | int, threads: int = 1) -> U8:
        """1 where the field is negative, else 0, (nx, ny, nz) uint8; faster than `sample` where a class can."""
        grid = self._grid(grid)
        return self.solid_zyx(grid, 0, grid.shape[2], threads).T

    def to_numpy(self, resolution: int = 64) -> Bools:
        """True in the solid, False in pores and tunnels, at voxel centers of all cells, (nx, ny, nz) bool.

        Parameters
        ----------
        resolution : int
            Voxels along the edge of a cell.

        Examples
        --------
        >>> import sppm_pipeline as sppm
        >>> cell = sppm.cell("paper", porosity=0.6, seed=1, resolution=24)
        >>> cell.to_numpy(24).shape, round(float(1 - cell.to_numpy(24).mean()), 2)
        ((24, 24, 24), 0.6)
        """
        return self.solid(resolution).astype(bool)

    def voxels(self, resolution: int = 64) -> Voxels:
        """The image of voxels that ``extract.voxels`` makes; `Voxels.to_numpy` and writers take it from there."""
        return cast("Voxels", self._made("extract.voxels", resolution=resolution))

    def mesh(self, resolution: int = 64) -> SurfaceMesh:
        """The surface that ``extract.marching_cubes`` makes, in mm, or in cell sizes if there is no physical size."""
        return cast("SurfaceMesh", self._made("extract.marching_cubes", resolution=resolution))

    def to_pyvista(self, resolution: int = 64) -> Any:
        """A `pyvista.ImageData` whose cells are voxels, ``phase`` 1 where solid; `ResourceError` without pyvista."""
        return self.voxels(resolution).to_pyvista()

    def plot(self, axis: str = "z", at: float = 0.5, *, resolution: int = 256, ax: Any = None) -> Any:
        """Draw a section with matplotlib: solid dark, void light.

        Parameters
        ----------
        axis : {"x", "y", "z"}
            What the section is perpendicular to.
        at : float
            Where it lies, a share of the whole extent.
        resolution : int
            Points along the edge of a cell.
        ax : matplotlib.axes.Axes, optional
            Where to draw; a new figure if omitted.

        Returns
        -------
        matplotlib.axes.Axes

        Raises
        ------
        ResourceError
            If matplotlib is not installed.
        ConfigError
            If there is no such axis or place.
        """
        if axis not in tuple("xyz") or not 0 <= at <= 1:
            raise ConfigError(f"a section is perpendicular to x, y or z at 0 to 1, got {axis!r} at {at!r}")
        normal, size = "xyz".index(axis), tuple(resolution * n for n in self.cells)
        across = [k for k in range(3) if k != normal]
        # one layer of points, half a step away from both ends at most
        origin, shape = [0.5 / resolution] * 3, list(size)
        origin[normal], shape[normal] = at * self.cells[normal], 1
        grid = Grid(tuple(origin), (1 / resolution,) * 3, tuple(shape))  # type: ignore[arg-type]
        section = self.solid(grid).take(0, normal)
        axes = optional_module("matplotlib.pyplot").subplots()[1] if ax is None else ax
        scale, unit = (self.edge_mm, "mm") if self.edge_mm else (1.0, "cell sizes")
        start = [self.origin_mm[k] if self.edge_mm else 0.0 for k in across]
        stop = [first + self.cells[k] * scale for first, k in zip(start, across, strict=True)]
        extent = (start[0], stop[0], start[1], stop[1])
        axes.imshow(section.T, origin="lower", extent=extent, cmap="gray_r", vmin=0, vmax=1, interpolation="nearest")
        axes.set_xlabel(f"{'xyz'[across[0]]} ({unit})")
        axes.set_ylabel(f"{'xyz'[across[1]]} ({unit})")
        return axes

    def _made(self, stage: str, **options: Any) -> Any:
        # late, as the program of plans and runs is needed by no one who only samples
        from sppm_pipeline.engine.api.functions import make_function

        return make_function(stage)(self, **options)

    def _grid(self, grid: Grid | int) -> Grid:
        if isinstance(grid, Grid):
            return grid
        if not isinstance(grid, (int, np.integer)) or isinstance(grid, bool) or grid < 1:
            raise ValueError(f"the resolution is an integer, voxels along the edge of a cell, at least 1, got {grid!r}")
        return cell_centers(int(grid), self.cells)

    def solid_layers(self, grid: Grid, start: int, stop: int, threads: int = 1, wanted: I32 | None = None) -> U8:
        """`solid` for the layers start <= k < stop of a larger grid; classes may keep what the whole grid needs.

        `wanted` (stop - start, ny, 2) names, by layer and row, the first sample of the row that matters and the one
        after the last; a class may leave the others undecided.
        """
        return (self.sample_layers(grid, start, stop, threads) < 0).view(np.uint8)

    def sample_zyx(self, grid: Grid, start: int, stop: int, threads: int = 1) -> F32:
        """`sample_layers` for kernels: (stop - start, ny, nx), C-contiguous."""
        return np.ascontiguousarray(self.sample_layers(grid, start, stop, threads).T)

    def sample_wanted(self, grid: Grid, start: int, stop: int, threads: int, wanted: I32) -> F32:
        """`sample_zyx` where only some samples of each row matter, `wanted` as for `solid_layers`."""
        return self.sample_zyx(grid, start, stop, threads)

    def solid_zyx(self, grid: Grid, start: int, stop: int, threads: int = 1, wanted: I32 | None = None) -> U8:
        """`solid_layers` for kernels: (stop - start, ny, nx), C-contiguous."""
        return np.ascontiguousarray(self.solid_layers(grid, start, stop, threads, wanted).T)

    def samples_by_rows(self, grid: Grid) -> bool:
        """True if `solid_bits` goes through a grid some rows at a time, so that more layers at once cost less each."""
        return False

    def solid_bits(self, grid: Grid, start: int, stop: int, threads: int = 1, wanted: I32 | None = None) -> U64:
        """`solid_layers` as bits, (stop - start, ny, words), see `services.bit_rows`; a class may make them at once."""
        from sppm_pipeline.services.bit_rows import pack

        return pack(self.solid_zyx(grid, start, stop, threads, wanted))

    def exactly(self) -> ScalarField:
        """The same field without the short cuts of fine grids; itself if its class takes none."""
        return self

    def cut_at(self, value: float) -> ScalarField:
        """The structure whose solid is where this field is smaller than `value`; what tuning the porosity asks for.

        A class that has a name for it (a level, a radius, a thickness) makes one of its own with that changed.
        """
        return CutField(self, value)

    @property
    def sum_level(self) -> float | None:
        """The level C if the field is ``G - C`` with a sum G of kernels that are not negative; else None."""
        return None

    @property
    def finest_radius(self) -> float | None:
        """Radius of the thinnest tunnel, cell sizes; None if it is unknown."""
        return None

    @property
    def thinnest_wall(self) -> float | None:
        """Thickness of the thinnest wall of the design, cell sizes; None if there are no walls of a known thickness."""
        return None

    def coarseness(self, spacing: float) -> str | None:
        """Warning for samples too far apart to resolve the thinnest tunnels or walls; None if they are not.

        Parameters
        ----------
        spacing : float
            Distance of samples, cell sizes.
        """
        radius, wall = self.finest_radius, self.thinnest_wall
        needed = []
        if radius is not None and spacing > RESOLVED * radius:
            needed.append((RESOLVED * radius, f"tunnels, of radius {radius:.3g} cell sizes: some void may look closed"))
        if wall is not None and spacing > RESOLVED_WALL * wall:
            needed.append((RESOLVED_WALL * wall, f"walls, {wall:.3g} cell sizes thick: they may look broken"))
        if not needed:
            return None
        finest, what = min(needed)
        wanted = math.ceil(1 / finest)
        edge = f" ({self.edge_mm / wanted:.3g} mm)" if self.edge_mm else ""
        return (
            f"{1 / spacing:.4g} voxels along an edge of the cell are too few for the thinnest {what}; "
            f"{wanted} or more{edge} show them"
        )

    def physical_edge(self) -> float:
        """`edge_mm`, or an error for those who need a size.

        Raises
        ------
        DesignError
            If the cell has no physical size.
        """
        if self.edge_mm is None:
            raise DesignError(
                "the cell has no physical size, so that millimeters mean nothing to it",
                hint="give the first sampling stage `edge: 7.5 mm`, or lay the cell with a `tile` stage and its `cell`",
            )
        return self.edge_mm


class Placed:
    """Size and place of a field that keeps them itself, in `edge` and `origin`."""

    edge: float | None
    origin: tuple[float, float, float]

    @property
    def edge_mm(self) -> float | None:
        return self.edge

    @property
    def origin_mm(self) -> tuple[float, float, float]:
        return self.origin


@dataclass(frozen=True, eq=False)
class WrappedField(ScalarField):
    """Base of fields made from another field; size, place and finest detail are those of the other one.

    Attributes
    ----------
    base : ScalarField
    """

    base: ScalarField

    def check(self) -> None:
        """The field it was made from is in order; values that are evaluated again are not sampled for this."""
        self.base.check()

    @property
    def cells(self) -> tuple[int, int, int]:
        return self.base.cells

    @property
    def periodic(self) -> bool:
        return self.base.periodic

    @property
    def sum_level(self) -> float | None:
        return self.base.sum_level

    @property
    def finest_radius(self) -> float | None:
        return self.base.finest_radius

    @property
    def thinnest_wall(self) -> float | None:
        return self.base.thinnest_wall

    @property
    def edge_mm(self) -> float | None:
        return self.base.edge_mm

    @property
    def origin_mm(self) -> tuple[float, float, float]:
        return self.base.origin_mm

    def exactly(self) -> Self:
        return replace(self, base=self.base.exactly())

    def summary(self) -> dict[str, Any]:
        """The summary of the field it was made from."""
        return self.base.summary()


@dataclass(frozen=True, eq=False)
class CutField(WrappedField):
    """A field less a constant `value`, in the unit of the field: solid where the field is smaller.

    Made by `ScalarField.cut_at` of a field that has no parameter for it, such as a radius or a level.
    """

    value: float

    @property
    def sum_level(self) -> float | None:
        level = self.base.sum_level
        return level + self.value if level is not None and level + self.value > 0 else None

    @property
    def finest_radius(self) -> float | None:
        return None

    @property
    def thinnest_wall(self) -> float | None:
        return None

    def check(self) -> None:
        """The value is a number."""
        super().check()
        if not np.isfinite(self.value):
            raise ValueError(f"a field is cut at a finite value, got {self.value}")

    def cut_at(self, value: float) -> Self:
        return replace(self, value=self.value + value)

    def sample_layers(self, grid: Grid, start: int, stop: int, threads: int = 1) -> F32:
        # a new array: what a field hands out may be its own
        return self.base.sample_layers(grid, start, stop, threads) - np.float32(self.value)

    def summary(self) -> dict[str, Any]:
        """The summary of the field, and the value it is cut at."""
        return {**self.base.summary(), "cut": self.value}


@dataclass(frozen=True, eq=False)
class CleanedField(WrappedField):
    """A field whose floating islands are void: the sign is inverted there.

    Islands were found on a voxel grid; a sample belongs to an island if its voxel, or one beside it that is not solid
    which stays, does. Inverting the sign keeps the field continuous, as it is zero where the island ends.
    """

    floating: U8  # (nz, ny, nx), 1 in voxels of islands and beside them
    per_cell: int  # voxels along a cell edge

    def __post_init__(self) -> None:
        object.__setattr__(self, "floating", frozen(np.asarray(self.floating, np.uint8)))

    def sample_layers(self, grid: Grid, start: int, stop: int, threads: int = 1) -> F32:
        values = self.base.sample_zyx(grid, start, stop, threads)
        nz, ny, nx = self.floating.shape
        place = []
        for axis, n in ((2, nz), (1, ny), (0, nx)):
            # samples on the border of two voxels belong to the upper one, whatever their rounding
            voxel = np.floor(grid.axis(axis) * self.per_cell + 1e-9).astype(np.int64)
            place.append(voxel % n if self.periodic else np.clip(voxel, 0, n - 1))
        place[0] = place[0][start:stop]
        inverted = self.floating[np.ix_(*place)].view(bool)
        # only the solid is inverted: void beside an island stays void
        inverted &= values < 0
        return np.where(inverted, -values, values).T


@dataclass(frozen=True, eq=False)
class RepeatedField(Placed, WrappedField):
    """Any field that is periodic with one cell, taken as the content of a whole lattice."""

    extent: tuple[int, int, int]  # cells of the lattice
    edge: float | None  # of a cell, mm
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)  # world position of the low corner of cell (0, 0, 0), mm

    @property
    def cells(self) -> tuple[int, int, int]:
        return self.extent

    def sample_layers(self, grid: Grid, start: int, stop: int, threads: int = 1) -> F32:
        return self.base.sample_layers(grid, start, stop, threads)

    def solid_layers(self, grid: Grid, start: int, stop: int, threads: int = 1, wanted: I32 | None = None) -> U8:
        return self.base.solid_layers(grid, start, stop, threads, wanted)

    def summary(self) -> dict[str, Any]:
        """Size of the lattice."""
        return {"lattice": list(self.extent), "cell_mm": self.edge}
