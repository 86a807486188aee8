"""What stages of parts share: the material, the law of a recipe, and homogenized models."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import (
    ConfigError,
    Context,
    DesignError,
    Length,
    Palette,
    Recipe,
    RecipeSize,
    Size,
    Stage,
    SurfaceMesh,
    option,
    options,
)
from sppm_pipeline.built_in import stage_class
from sppm_pipeline.features.parts.bodies import SharedBody, mesh_body
from sppm_pipeline.features.parts.numerics.density_law import DensityLaw, density_law, solid_constants
from sppm_pipeline.features.parts.solving import Model
from sppm_pipeline.services.mesh.box_tree import box_tree
from sppm_pipeline.services.nearest import surface_distances

MAX_ELEMENTS = 128
"""Elements along the longest side of a homogenized part, unless a size is given."""

RELIABLE = 0.3
"""Error bar, over the stiffness, of a trial cell, above which there is a warning (heuristic): those of single cells are
partly averaged."""

TRIED = 8
"""Numbers of pores that usually cover a range of densities."""


@dataclass(frozen=True, kw_only=True)
class LoadedPart(Stage):
    """Base of stages that load a part: its material, and the law of a recipe that fills it."""

    reported: ClassVar[tuple[str, ...]] = ("law_cells", "law_density_min", "law_error")

    young: float = options.young(note="MPa", above=None, minimum=1e-3, maximum=1e9)
    poisson: float = options.poisson(0.35, above=None, below=None, minimum=-0.9, maximum=0.49)
    solid_density: float | None = option(None, help="density of the solid", unit="g/cm3", above=0, maximum=100)
    cell: Length | None = options.cell(None, note="of the recipe in the part; the recipe's `edge` if omitted")
    element: Length | None = option(
        None, help="edge of the elements of a homogenized part; half a cell if omitted, or a 128th of the longest side",
        unit="mm", minimum=1e-4, maximum=1e4,
    )  # fmt: skip
    skin: Length = options.skin(Length(0.0), note="of a homogenized part; a part made by `fill` has its own", minimum=0,
                                maximum=1e6)  # fmt: skip
    density: tuple[float, float] = option(
        (0.2, 0.7), help="relative densities over which the law of the recipe is measured", above=0, below=1
    )
    trials: int = options.trials(3)
    law_resolution: int = option(
        32, help="voxels along an edge of the trial cells", unit="voxels", minimum=8, maximum=128
    )
    law_symmetry: str = option(
        "cubic", help="cubic: the law is averaged over the symmetries of a cube, which stochastic cells have in the "
        "mean; none: as the trial cells are", choices=("cubic", "none"),
    )  # fmt: skip
    solver_tolerance: float = option(
        1e-5,
        help="relative error of the result left by the solver, estimated; of the compliance",
        minimum=1e-10,
        maximum=0.01,
    )
    iterations: int = options.iterations(2000)

    def check_options(self) -> None:
        """Densities that rise."""
        if not self.density[0] < self.density[1]:
            raise ConfigError(f"`density` should rise, from {self.density[0]:g} to {self.density[1]:g}")

    def law_size(self, recipe: RecipeSize) -> Size:
        """Cells of the law, homogenized."""
        cells = TRIED * self.trials
        size: Size = stage_class("homogenize.voxel")(resolution=self.law_resolution).solving(
            recipe(Palette(), cells), cells
        )
        return size

    def law_of(self, context: Context, recipe: Recipe) -> tuple[DensityLaw, float]:
        """The law of a recipe, MPa, and the edge of its cell in the part, mm."""
        low, high = self.density
        cells = stage_class("grade.stiffness")(
            porosities=(1 - high, 1 - low), trials=self.trials, resolution=self.law_resolution, poisson=self.poisson
        ).cells_of(context, recipe, quiet=True)
        shape = (-1, self.trials)
        densities = np.array([1 - report.summary()["porosity"] for _, report in cells]).reshape(shape)
        matrices = np.array([report.stiffness for _, report in cells]).reshape(*shape, 6, 6)
        law = density_law(
            densities, self.young * matrices, self.young, self.poisson, cubic=self.law_symmetry == "cubic"
        )
        if self.cell is None and cells[0][0].edge_mm is None:
            raise ConfigError(
                "the cell of the recipe has no size in mm", hint="give the option `cell`, or `edge: 5 mm`"
            )
        error = max(float(report.summary().get("error_relative") or 0) for _, report in cells)
        if error > RELIABLE:
            context.warn(
                f"a trial cell has a stiffness with an error bar of {error:.0%}: raise `law_resolution`, or narrow "
                "`density`"
            )
        context.report(law_cells=len(cells), law_density_min=float(law.density[0]), law_error=error)
        return law, self.cell.mm() if self.cell is not None else float(cells[0][0].physical_edge())

    def elements_of(self, part: SurfaceMesh, cell: float) -> SharedBody:
        """The elements of a homogenized part."""
        longest = float((part.upper - part.lower).max())
        edge = max(cell / 2, longest / MAX_ELEMENTS) if self.element is None else self.element.mm()
        shared = mesh_body(part, edge)
        if not shared.body.solid.any():
            raise DesignError(
                f"the mesh {part.name!r} has no inside, or elements of {edge:.3g} mm are too large for it"
            )
        return shared

    def skin_share(self, part: SurfaceMesh, shared: SharedBody) -> NDArray[np.float64]:
        """Share of each element of the body (m,) that is skin."""
        thick = self.skin.mm()
        count = int(np.count_nonzero(shared.body.solid))
        if not thick:
            return np.zeros(count)
        return np.clip((thick - depths_of(part, shared)) / float(np.mean(shared.body.edges)) + 0.5, 0, 1)

    def model_of(
        self, shared: SharedBody, law: DensityLaw, density: NDArray[np.float64], skin: NDArray[np.float64],
        bearing: NDArray[np.float64], dtype: Any = np.float32,
    ) -> Model:  # fmt: skip
        """A homogenized part of densities (m,), of which a share is skin, and a share bears at all."""
        body, share = shared.body, shared.share[shared.body.solid].astype(np.float64)
        solid = solid_constants(self.young, self.poisson)[:, None]
        constants = np.zeros((21, *body.solid.shape), dtype)
        constants[:, body.solid] = share * ((1 - skin) * bearing * law.at(density) + skin * solid)
        walls, mass = (np.zeros(body.solid.shape, dtype) for _ in range(2))
        walls[body.solid] = (1 - skin) * density + skin
        mass[body.solid] = share * walls[body.solid] * self.voxel_mass(body.edges)
        return Model(body, constants, 1.0, mass, walls)

    def voxel_mass(self, edges: tuple[float, float, float]) -> float:
        """Mass of a solid voxel, g; its volume in cm3 if the density is not known."""
        return float(np.prod(edges)) * 1e-3 * (self.solid_density or 1.0)


def depths_of(part: SurfaceMesh, shared: SharedBody) -> NDArray[np.float64]:
    """Distance of the middles of solid elements (m,) from the surface of the part, mm."""
    return surface_distances(box_tree(part.vertices[part.faces]), middles_of(shared))


def middles_of(shared: SharedBody) -> NDArray[np.float64]:
    """Middles of the solid elements (m, 3), mm, in C order of (z, y, x)."""
    z, y, x = np.nonzero(shared.body.solid)
    middles: Any = (np.stack([x, y, z], axis=1) + 0.5) * np.array(shared.body.edges) + np.array(shared.body.origin)
    return np.ascontiguousarray(middles, np.float64)
