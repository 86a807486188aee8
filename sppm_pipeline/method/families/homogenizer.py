"""Base of stages that homogenize voxels: options, the way from a field or an image to a cell, warnings."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, TypeVar, cast

import numpy as np
from numpy.typing import DTypeLike, NDArray

from sppm_pipeline.engine.process.budget import require_memory
from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.method.families import options
from sppm_pipeline.method.fields.scalar_field import ScalarField
from sppm_pipeline.method.nouns.voxels import Voxels
from sppm_pipeline.nouns.palette import Palette
from sppm_pipeline.nouns.size import Size
from sppm_pipeline.services.arrays import F32, F64, U8
from sppm_pipeline.services.grid import cell_centers
from sppm_pipeline.stage import Context, Stage, option

if TYPE_CHECKING:
    from sppm_pipeline.services.elastic.convergence import Limit
    from sppm_pipeline.services.multigrid.solver import Solved


LOCKING = 0.49
"""Poisson's ratio above which bricks and straight tetrahedra trigger a warning. On a gyroid C11 falls by 3 % from 12 to
24 voxels at 0.49, and by 15 % at 0.499."""


class VoxelCell(NamedTuple):
    """A periodic cell of voxels, indexed x, y, z; x is contiguous in memory, so that solvers take the transpose.

    Attributes
    ----------
    phase : (nx, ny, nz) uint8, or None
        The phase of each voxel, 0 for void.
    fraction : (nx, ny, nz) float32, or None
        Solid fraction of each voxel; exactly one of the two is set.
    edges : (hx, hy, hz)
        Of a voxel.
    """

    phase: U8 | None
    fraction: F32 | None
    edges: tuple[float, float, float]

    @property
    def _given(self) -> U8 | F32:
        given = self.phase if self.phase is not None else self.fraction
        assert given is not None
        return given

    @property
    def shape(self) -> tuple[int, int, int]:
        """Voxels along x, y, z."""
        nx, ny, nz = self._given.shape
        return nx, ny, nz

    @property
    def porosity(self) -> float:
        """Volume fraction of the void."""
        if self.phase is not None:
            return 1 - float(np.count_nonzero(self.phase)) / self.phase.size
        assert self.fraction is not None
        # float32 sums of millions of voxels would lose digits
        return 1 - float(self.fraction.mean(dtype=np.float64))

    def occupied(self) -> U8:
        """1 where there is any solid."""
        # both have one byte: a view saves a copy
        return (self._given > 0).view(np.uint8)

    def of_voxels(self, values: tuple[float, ...], dtype: DTypeLike) -> NDArray[Any]:
        """Voxels (nz, ny, nx) of values of the void and of each phase; by solid fraction, means weighted by volume."""
        table = np.array(values, dtype)
        if self.phase is not None:
            return np.asarray(table[self.phase.T])
        assert self.fraction is not None
        return np.asarray(table[0] + self.fraction.T.astype(dtype) * (table[1] - table[0]))

    def check_materials(self, context: Context, given: int, options: str) -> None:
        """Check that there are as many materials as phases, and warn if some are left over.

        Raises DesignError if a phase has none, or there are several for a field or an image of solid fractions.
        """
        if self.phase is None:
            if given > 1:
                raise DesignError(
                    f"materials are given for {given} phases, and a field or an image of solid fractions has one",
                    hint=f"give {options} one value, or label the field by `extract.phases`",
                )
            return
        phases = int(self.phase.max())
        if phases > given:
            raise DesignError(
                f"the image has phases up to {phases}, and materials are given for {given}",
                hint=f"give {options} a value for every phase from 1 on",
            )
        if phases < given > 1:
            context.warn(f"materials are given for {given} phases, and the image has {phases or 'none'}")


def per_phase(value: float | tuple[float, ...] | None) -> tuple[float, ...]:
    """Values of the phases from 1 on, of an option that takes one number or several, or nothing."""
    if value is None:
        return ()
    return value if isinstance(value, tuple) else (value,)


Report = TypeVar("Report")


def grids_below(resolution: int, grids: int) -> list[int]:
    """Voxels along an edge of the cell of each grid of a refinement, each two thirds of the next, the coarsest first;
    `ConfigError` if the resolution is too low for so many.
    """
    counts = [max(2, round(resolution * (2 / 3) ** step)) for step in reversed(range(grids))]
    if len(set(counts)) < grids:
        raise ConfigError(f"a resolution of {resolution} has no coarser grids")
    return counts


class Quiet:
    """A context for a step among many: its warnings and its own progress go nowhere."""

    def __init__(self, context: Context) -> None:
        self._context = context

    def __getattr__(self, name: str) -> Any:
        return getattr(self._context, name)

    def warn(self, message: str) -> None:
        """Drop a message."""

    def progress(self, done: float, total: float, what: str = "") -> None:
        """Drop a report, which would be that of one step."""


def refined(
    context: Context, source: ScalarField | Voxels, counts: list[int],
    solve: Callable[[Context, int, ScalarField | Voxels], Report], values: Callable[[Report], F64],
    assumed: float = 2.0,
) -> tuple[list[int], list[Report], Limit]:  # fmt: skip
    """Voxels along an edge and report of each grid of a refinement, and the limit of fine grids extrapolated.

    Grids of an image are made from blocks of its voxels, whatever the `counts`, and steps at surfaces make its errors
    of first order; `ConfigError` if they do not make blocks. Warnings about coarse grids are dropped.
    """
    from sppm_pipeline.services.elastic.convergence import richardson

    sources: list[ScalarField | Voxels] = [source] * len(counts)
    if isinstance(source, Voxels):
        images, assumed = [source], 1.0
        try:
            while len(images) < len(counts):
                # the coarsest first, as in `counts`
                images.insert(0, images[0].coarsened())
        except ValueError as error:
            raise ConfigError(str(error), hint="crop the image, or leave out `grids`") from None
        sources, counts = list(images), [max(image.shape) for image in images]
    reports = []
    for number, (count, given) in enumerate(zip(counts, sources, strict=True)):
        # only the finest grid is the result: the others may be coarse
        reports.append(solve(context if count == counts[-1] else cast(Context, Quiet(context)), count, given))
        context.progress(number + 1, len(counts), "grids")
    limit = richardson([1 / count for count in counts], [values(report) for report in reports], assumed)
    return counts, reports, limit


@dataclass(frozen=True, kw_only=True)
class Homogenizer(Stage):
    """Base of stages that solve cell problems on voxels."""

    resolution: int = options.resolution(64, note="of fields; images keep theirs")
    fractions: str = option(
        "auto",
        help="auto: voxels at the surface count by their solid fraction; binary: by their center",
        choices=("auto", "binary"),
    )
    solver_tolerance: float = option(
        1e-4, help="relative error of the result left by the solver, estimated", minimum=1e-12, maximum=0.1,
        formerly="tolerance",
    )  # fmt: skip
    residual: float | None = options.residual(None, note="in place of `solver_tolerance`")
    iterations: int = options.iterations(1000)
    precision: str = option("single", help="precision of the solver's vectors", choices=("single", "double"))

    advice: ClassVar[str] = "lower `resolution`, or take `precision: single`"

    @property
    def mirrored(self) -> bool:
        """Whether mirror images lie beyond the sides, and the cell alone is solved."""
        return False

    @property
    def wraps(self) -> tuple[bool, bool, bool]:
        """Whether opposite sides of what is solved are neighbors, along x, y, z."""
        return (not self.mirrored,) * 3

    @abstractmethod
    def bytes_of_a_voxel(self, threads: int) -> int:
        """Memory of the solver in single precision, with as many load cases at a time as there are threads."""

    @property
    def effort(self) -> float:
        """Work for a field over that of one solution on its grid."""
        return 1.0

    def estimate(self, palette: Palette, source: Any) -> Size:
        return self.solving(source)

    def solving(self, source: Size, repeats: float = 1.0) -> Size:
        """The size of solving the problem of a field or of an image."""
        grid = Size(voxels=source.voxels) if source.voxels else source.grid(self.resolution)
        repeats *= 1.0 if source.voxels else self.effort
        # double precision takes twice the memory
        voxels = (source.voxels or grid.samples) * (2 if self.precision == "double" else 1)
        return Size(
            samples=repeats * grid.samples, sums=repeats * grid.sums, voxels=repeats * voxels, resident=voxels,
            geometry=source.geometry,
        )  # fmt: skip

    def grid_of(
        self, context: Context, source: ScalarField | Voxels
    ) -> tuple[tuple[int, int, int], tuple[float, float, float]]:
        """Voxels of a periodic cell along x, y, z, and the edges of a voxel: 1 for fields.

        Raises DesignError if `source` is not periodic, ResourceError if the solver needs more memory than there is.
        """
        bytes_per_voxel = self.bytes_of_a_voxel(context.threads)
        if isinstance(source, Voxels):
            if not (self.mirrored or all(source.periodic)):
                raise DesignError(
                    f"homogenization needs an image that is periodic along x, y and z, not {source.periodic}",
                    hint="read a periodic cell with `periodic: true`, and homogenize a scan with `sides: mirror`",
                )
            self._check_memory(context, source.shape, bytes_per_voxel)
            return source.shape, source.spacing
        if not (self.mirrored or source.periodic):
            raise DesignError(
                "homogenization needs a periodic cell; this field ends at the border of its cells or part",
                hint="take the cell itself (`from: tune.porosity`, say), a tiling with `tile.periodic`, or, of a scan, "
                "`sides: mirror`",
            )
        if (coarse := source.coarseness(1 / self.resolution)) is not None:
            context.warn(coarse)
        x, y, z = (self.resolution * cells for cells in source.cells)
        self._check_memory(context, (x, y, z), bytes_per_voxel)
        return (x, y, z), (1.0, 1.0, 1.0)

    def check_image(self, context: Context, source: ScalarField | Voxels, *, void: bool = False) -> None:
        """Warn if an image is no periodic cell, or if voxels do not resolve what carries: its solid, or its void."""
        for doubt in source.doubts(void=void, repeats=not self.mirrored) if isinstance(source, Voxels) else ():
            context.warn(doubt)

    def cell_of(self, context: Context, source: ScalarField | Voxels) -> VoxelCell:
        """Voxels of a periodic cell; errors as of `grid_of`."""
        _, edges = self.grid_of(context, source)
        if isinstance(source, Voxels):
            values = source.values
            if not source.fractions:
                return VoxelCell(np.asfortranarray(values, np.uint8), None, edges)
            if self.fractions == "binary":
                return VoxelCell((values >= 0.5).astype(np.uint8), None, edges)
            return VoxelCell(None, np.asfortranarray(values, np.float32), edges)
        return self.sampled(source, context.threads)

    def sampled(self, field: ScalarField, threads: int) -> VoxelCell:
        """Voxels of a periodic field, without a look at whether they suit it."""
        if self.fractions == "binary":
            solid = field.solid(cell_centers(self.resolution, field.cells), threads)
            return VoxelCell(solid, None, (1.0, 1.0, 1.0))
        from sppm_pipeline.method.porosity.fractions import solid_fractions

        x, y, z = (self.resolution * cells for cells in field.cells)
        fraction = solid_fractions(
            lambda grid, start, stop: field.sample_zyx(grid, start, stop, threads), (x, y, z), self.resolution
        )
        return VoxelCell(None, fraction.T, (1.0, 1.0, 1.0))

    def solver_options(self, threads: int) -> dict[str, Any]:
        """Keyword arguments of `elasticity.stiffness` and `conduction.conductivity`."""
        return {
            "residual": self.residual or 0.0, "tolerance": self.solver_tolerance if self.residual is None else 0.0,
            "iterations": self.iterations, "precision": np.float32 if self.precision == "single" else np.float64,
            "threads": threads,
        }  # fmt: skip

    def solver_warnings(self, solved: tuple[Solved, ...], precision: str) -> list[str]:
        """Warn of load cases that did not converge, or not in the requested precision."""
        warnings = []
        if not all(case.converged for case in solved):
            warnings.append(
                f"after {self.iterations} iterations a load case has an estimated error of "
                f"{max(case.error for case in solved):.1g}; allow more `iterations`"
            )
        if precision == "float64" and self.precision == "single":
            warnings.append("single precision was not enough for this cell; it was solved in double precision")
        return warnings

    def _check_memory(self, context: Context, shape: tuple[int, int, int], bytes_per_voxel: int) -> None:
        needed = float(np.prod(shape, dtype=np.float64)) * bytes_per_voxel * (2 if self.precision == "double" else 1)
        require_memory(
            needed,
            f"homogenizing {' x '.join(map(str, shape))} voxels",
            "lower the `resolution`, take `precision: single`, or use fewer threads (--threads)",
            limit=context.memory_limit,
        )


@dataclass(frozen=True, kw_only=True)
class SidedHomogenizer(Homogenizer):
    """Base of homogenizers that take what does not repeat, such as scans."""

    sides: str = option(
        "periodic", help="what lies beyond the sides; periodic: the cell repeats; mirror: its mirror images, as if "
        "what does not repeat, such as a scan, were loaded between smooth plates; mixed: the same by the name that "
        "uniform displacements or gradients along the normal and none across have",
        choices=("periodic", "mirror", "mixed"),
    )  # fmt: skip

    @property
    def mirrored(self) -> bool:
        return self.sides != "periodic"

    def sided(self, context: Context, source: ScalarField | Voxels) -> ScalarField | Voxels:
        """The cell that is solved: `source`, a field with its mirror images beyond the sides; reports which."""
        context.report(sides=self.sides)
        if self.sides == "periodic":
            return source
        if isinstance(source, Voxels):
            return source if self.mirrored else source.mirrored()
        from sppm_pipeline.method.fields.mirrored import MirroredField

        return MirroredField(source, not self.mirrored)

    def solving(self, source: Size, repeats: float = 1.0) -> Size:
        if self.sides == "periodic" or self.mirrored:
            return super().solving(source, repeats)
        body = source.geometry
        if body is not None:
            x, y, z = body.box
            body = replace(body, box=(2 * x, 2 * y, 2 * z), volume=8 * body.volume)
        return super().solving(replace(source, voxels=8 * source.voxels, geometry=body), repeats)
