"""``simulate.part``: a part under its load cases, as it will be printed or homogenized."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, ClassVar, cast

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import Palette, Part, RecipeSize, ScalarField, Size, SurfaceMesh, options
from sppm_pipeline.engine.process.budget import require_memory
from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.parts.bodies import field_body
from sppm_pipeline.features.parts.material import LoadedPart, Model, depths_of, middles_of, simulated
from sppm_pipeline.features.parts.part_result import PartResult
from sppm_pipeline.features.parts.pictures import SHOWN
from sppm_pipeline.method.families.homogenizer import Quiet
from sppm_pipeline.method.nouns.conditions import LoadCases
from sppm_pipeline.method.nouns.maps import Grading
from sppm_pipeline.method.porosity.fractions import stiff_share
from sppm_pipeline.services.arrays import F64
from sppm_pipeline.services.elastic.refinement import doubt, limit_of_compliance, mean_thickness
from sppm_pipeline.services.elastic.voigt import lame
from sppm_pipeline.stage import Context, Headline, Recipe, option

VOXEL_BYTES = 80
"""Of the solver in single precision: displacements, residual, direction and forces, moduli and weights, images."""

FACES = 0.9
"""Measured faces of voxels on a unit of expected surface: 1.5 on average over all directions, less where voxels merge
what is near."""

FACE_VOXELS, AFTER = 5.2, 0.7
"""Memory for a face of the surface that is shown, in that of a voxel of the solver, and how much of that is left beside
it: both measured."""

COARSEST = 8
"""Voxels along an edge of the cell from which on a grid half as fine makes sense (heuristic; error bars tell)."""


@dataclass(frozen=True, kw_only=True)
class SimulatePart(LoadedPart):
    """Load a part and compute how it deforms: the very voxels of the structure, or homogenized by a recipe's law.

    Without a `recipe` it is resolved: the field or part before it is cut into voxels, as `fill.implicit` hands it to
    the printer, skin and drains included; solid that nothing holds is left out and reported. Coarse voxels are too
    stiff: compliance and displacements are extrapolated from this grid and one half as fine to the limit of fine grids,
    with an error bar; stresses, files and pictures are those of this grid. With a `recipe` it is
    homogenized: elements of half a cell have the stiffness, all 21 constants, of trial cells of the recipe at the
    porosity that a map or the option says, measured in this run. Cells that the surface cuts bear less than whole ones:
    `surface_layer` says how deep that goes where there is no skin. Linear elasticity of small displacements; trilinear
    bricks, nothing in the void.

    Stresses are von Mises; 99.9 % of the solid bear less than what is reported. Those of a homogenized part are means
    over walls and struts, whose peaks are several times as high. With a `yield_stress` the trial cells are also loaded
    along their axes, as by `measure.onset`, and the safety factor is that at which 0.1 % of the solid of the part
    begins to yield: an estimate, which knows neither the direction of the stress nor cells that the surface cuts.
    """

    name: ClassVar[str] = "simulate.part"
    version: ClassVar[int] = 3
    advice: ClassVar[str] = "lower `resolution`, or give larger elements"
    headline: ClassVar[tuple[Headline, ...]] = (
        Headline("compliance", "compliance", "N mm"), Headline("deflection", "largest displacement", "mm"),
        Headline("safety", "safety factor"), Headline("mass", "mass", "g"),
    )  # fmt: skip

    resolution: int = options.resolution(16, note="of a resolved part", maximum=256)
    grids: int | None = option(
        None, help="grids solved, for an error bar; the limit of fine ones is extrapolated; 2 if omitted where "
        "voxels count by solid fractions, else 1; of a resolved part", minimum=1, maximum=2,
    )  # fmt: skip
    fractions: str = option(
        "auto", help="auto: voxels at the surface count by their solid fraction; binary: by their center",
        choices=("auto", "binary"),
    )  # fmt: skip
    porosity: float | None = options.porosity(None, note="of a homogenized part without a map of it")
    surface_layer: float = option(
        0.08, help="depth below a surface without skin that bears nothing in a homogenized part: cells are cut there",
        unit="cell size", minimum=0, maximum=0.5,
    )  # fmt: skip
    solver_tolerance: float = option(1e-3, help="relative error of the result left by the solver, estimated; of the "
                                     "compliance", minimum=1e-10, maximum=0.01)  # fmt: skip
    yield_stress: float | None = option(None, help="yield stress of the solid, MPa, for a safety factor", above=0,
                                        maximum=1e15)  # fmt: skip
    mesh: str | None = options.write_path(None, note="elements with displacement and stress of each case",
                                          suffixes=(".vtu",))  # fmt: skip
    deformed: str | None = options.write_path(None, note="the deformed part", suffixes=(".png",))
    image_size: tuple[int, int] = options.image_size((900, 700), minimum=64)

    def estimate(
        self, palette: Palette, cases: Size, field: Size | None, part: Size | None, grading: Size | None,
        recipe: RecipeSize | None = None,
    ) -> Size:  # fmt: skip
        if recipe is not None:
            return self.solving(recipe, part or field, cases.cells)
        if field is None:
            return Size()
        grid, body = field.grid(self.resolution), field.body
        # the surface is kept for pictures, of blocks where that would be too much
        block = math.ceil(max(1.0, grid.samples * (1 - body.porosity) / SHOWN) ** (1 / 3))
        faces = FACES * body.area * (self.resolution / block) ** 2
        return Size(
            samples=8 * grid.samples, voxels=cases.cells * grid.samples,
            resident=max(grid.samples, AFTER * grid.samples + FACE_VOXELS * faces),
        )  # fmt: skip

    def run(
        self, context: Context, cases: LoadCases, field: ScalarField | None, part: SurfaceMesh | None,
        grading: Grading | None, recipe: Recipe | None = None,
    ) -> PartResult:  # fmt: skip
        """Make the model, solve its cases, write files."""
        thickness = 0.0
        if recipe is None:
            model, thickness = self._resolved(context, field, self.resolution)
        else:
            whole = field.domain if isinstance(field, Part) else part
            if whole is None:
                raise ConfigError("there is no part to fill with the recipe", hint="read a mesh by a `read` stage")
            model = self._homogenized(context, whole, recipe, grading, cases)
        result, full = simulated(
            context, model, cases, drop=recipe is None, tolerance=self.solver_tolerance, iterations=self.iterations,
            yield_stress=self.yield_stress, has_mass=self.solid_density is not None,
            keep=self.mesh is not None,
        )  # fmt: skip
        if (
            recipe is None
            and (self.grids or (2 if self.fractions == "auto" and self.resolution >= COARSEST else 1)) > 1
        ):
            result = self._limit(context, field, cases, result, model, thickness)
        if self.mesh is not None:
            self._write_mesh(context, model, full)
        if self.deformed is not None:
            from PIL import Image

            from sppm_pipeline.features.parts.pictures import deformed_picture
            from sppm_pipeline.pictures import contact_sheet

            drawn = [deformed_picture(result, number, self.image_size) for number in range(len(cases.cases))]
            Image.fromarray(contact_sheet(drawn, columns=min(3, len(drawn)))).save(context.output(self.deformed))
        return result

    def _limit(
        self, context: Context, field: ScalarField | None, cases: LoadCases, fine: PartResult, model: Model,
        thickness: float,
    ) -> PartResult:  # fmt: skip
        """The result with compliance and displacements extrapolated from a grid half as fine, and an error bar."""
        quiet = cast(Context, Quiet(context))
        try:
            rough, _ = self._resolved(quiet, field, max(2, self.resolution // 2))
            coarse, _ = simulated(
                quiet, rough, cases, drop=True, tolerance=self.solver_tolerance, iterations=self.iterations,
                yield_stress=None, has_mass=False,
            )  # fmt: skip
        except DesignError as error:
            context.warn(f"there is no error bar, as a grid half as fine can't be solved: {error}; raise `resolution`")
            return fine
        spacings = [1.0, float(np.mean(rough.body.edges) / np.mean(model.body.edges))]
        bars, numbers = [0.0], {}
        for name, one in fine.cases.items():
            limits = {}
            for key in ("compliance", "deflection"):
                if one[key]:
                    limits[key], bar = limit_of_compliance(spacings, [one[key], coarse.cases[name][key]], thickness)
                    bars.append(bar)
            numbers[name] = {**one, **limits}
        if warning := doubt(max(bars), "compliance", thickness):
            context.warn(warning)
        return replace(
            fine, cases=numbers, error=max(bars), deflection=max(one["deflection"] for one in numbers.values()),
            compliance=sum(case.weight * numbers[case.name]["compliance"] for case in cases.cases),
        )  # fmt: skip

    def _resolved(self, context: Context, field: ScalarField | None, resolution: int) -> tuple[Model, float]:
        """The voxels, and the mean thickness of walls and struts in voxels."""
        if field is None:
            raise ConfigError(
                "there is neither a structure nor a `recipe`",
                hint="put the stage behind `fill.implicit`, or give a `recipe` to homogenize",
            )
        cells: Any = field.cells
        if isinstance(field, Part):
            cells = (field.domain.upper - field.domain.lower) / field.physical_edge()
        size = float(np.prod(np.array(cells) * resolution))
        require_memory(
            size * VOXEL_BYTES, f"solving {size:.3g} voxels", "lower `resolution`", limit=context.memory_limit
        )
        if (coarse := field.coarseness(1 / resolution)) is not None:
            context.warn(coarse)
        shared = field_body(field, resolution, context.threads, binary=self.fractions == "binary")
        edges = shared.body.edges
        bears = stiff_share(shared.share)
        body = shared.body._replace(solid=bears > 0)
        if not body.solid.any():
            raise DesignError("no voxel is solid", hint="raise `resolution`, or give a lower porosity")
        lam, mu = lame(self.young, self.poisson)
        mass = shared.share * np.float32(self.voxel_mass(edges))
        model = Model(body, np.asarray(bears * np.float32(mu), np.float32), lam / mu, mass)
        return model, mean_thickness(shared.share)

    def _homogenized(
        self, context: Context, part: SurfaceMesh, recipe: Recipe, grading: Grading | None, cases: LoadCases
    ) -> Model:
        mapped = grading is not None and "porosity" in grading
        if mapped == (self.porosity is not None):
            raise ConfigError(
                "the porosity comes from a map or from the option `porosity`; there "
                f"{'are both' if mapped else 'is neither'}",
                hint="give one of them",
            )
        law, cell = self.law_of(context, recipe, strength=self.yield_stress is not None)
        shared = self.elements_of(part, cell)
        density = np.full(np.count_nonzero(shared.body.solid), 1 - float(self.porosity or 0))
        if mapped and grading is not None:
            density = 1 - grading["porosity"].at(middles_of(shared))
        law.check_range(density, "the part")
        skin = self.skin_share(part, shared)
        return self.model_of(shared, law, density, skin, self._bearing(part, shared, cell))

    def _bearing(self, part: SurfaceMesh, shared: Any, cell: float) -> F64:
        """Share of each element (m,) that lies deeper than the layer that bears nothing; all of it under a skin."""
        layer = self.surface_layer * cell
        if not layer or self.skin.value:
            return np.ones(np.count_nonzero(shared.body.solid))
        depth = depths_of(part, shared)
        return np.clip((depth - layer) / float(np.mean(shared.body.edges)) + 0.5, 0.1, 1)

    def _write_mesh(self, context: Context, model: Model, full: Any) -> None:
        """Write a VTU file of the elements; displacements are those of their middles."""
        from sppm_pipeline.formats import encode_cells

        assert self.mesh is not None
        body = model.body
        z, y, x = np.nonzero(body.solid)
        _, ny, nx = body.nodes
        corners = np.stack([((z + (a >> 2)) * ny + y + (a >> 1 & 1)) * nx + x + (a & 1) for a in range(8)], axis=1)
        nodes, cells = np.unique(corners, return_inverse=True)
        data: dict[str, NDArray[Any]] = {}
        for name, fields in full.items():
            data[f"stress {name}"] = fields["stress"][body.solid]
            flat = fields["displacement"].reshape(3, -1)
            for axis, word in enumerate("xyz"):
                data[f"displacement {word} {name}"] = flat[axis][corners].mean(axis=1, dtype=np.float32)
        if model.walls is not None:
            data["density"] = model.walls[body.solid]
        with context.output(self.mesh).open("wb") as file:
            points, bricks = body.points(nodes).astype(np.float32), cells.reshape(corners.shape).astype(np.int32)
            file.writelines(encode_cells(points, bricks, data))
