"""Base class of tile set stages: draw a recipe for many interiors and colors, and set one level for all."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.assembly.contents import TilingArrays
from sppm_pipeline.method.families import options
from sppm_pipeline.method.fields.microstructure import Microstructure, made_of_kernels
from sppm_pipeline.method.fields.tileset import TileSet
from sppm_pipeline.method.fields.tiling import Tiling
from sppm_pipeline.nouns.palette import Palette
from sppm_pipeline.nouns.size import RecipeSize, Size
from sppm_pipeline.services.arrays import F32, F64, Bools
from sppm_pipeline.services.grid import cell_centers
from sppm_pipeline.stage import Context, Recipe, Stage

if TYPE_CHECKING:
    from sppm_pipeline.method.tiling.lattice import Laid


@dataclass(frozen=True, kw_only=True)
class TileSetMaker(Stage):
    """Base of tile set stages: say what has to be drawn and how it is laid out on trial.

    The field of a tiling is one sum cut at one level, or it would jump at the faces. So the tiles of a set share their
    level, their mean porosity is the target, and each single tile keeps its own porosity, which is reported. A box or
    part holds some tiles more often than others, so a tile rule cuts the level once more, for what it has laid.
    """

    version: ClassVar[int] = 2
    kind: ClassVar[str]

    porosity: float | None = options.porosity(None, note="the mean of the set; the recipe's own level if omitted")
    resolution: int = options.resolution(32, note="for measuring the porosity", minimum=8, maximum=256)
    tolerance: float = options.tolerance(0.001)

    @abstractmethod
    def palette(self) -> Palette:
        """Palette that the recipe has to supply."""

    @abstractmethod
    def trial(self) -> list[TilingArrays]:
        """Periodic layouts in which porosity is measured; together they show every interior."""

    @abstractmethod
    def palette_size(self) -> int:
        """The number of colors that `TileSet.palette_colors` states."""

    def estimate(self, palette: Palette, recipe: RecipeSize) -> Size:
        own, n = self.palette(), self.resolution
        made, finer = recipe(own), n + n // 2 + 1 if self.porosity is not None else 0
        samples = own.interiors * float(n**3 + finer**3)
        made = made.at_porosity(
            self.porosity, samples=samples, sums=made.body.kernels * samples, resident=samples, cells=own.interiors
        )
        return replace(made, geometry=replace(made.body, patches=own.interiors + 3 * max(own.colors)))

    def run(self, context: Context, recipe: Recipe) -> TileSet:
        """Draw the set and, if a porosity is requested, choose its level."""
        from sppm_pipeline.method.porosity.level import level_for_porosity

        micro = made_of_kernels(recipe.run(context, palette=self.palette()), recipe.name, "a tile set needs")
        check_faces(micro, self.palette(), recipe.name)
        n, trial = self.resolution, self.trial()
        sums = self._sums(context, micro, trial, n)
        if self.porosity is not None:
            fit = level_for_porosity(np.concatenate([g.ravel("K") for g in sums]), self.porosity)
            micro = micro.with_level(fit.level)
            # another grid than the level was fitted on, or the error would be zero by construction
            finer = n + n // 2 + 1
            fine = _porosities(self._sums(context, micro, trial, finer), micro.level, finer)
            error = abs(float(np.mean(np.concatenate(fine))) - self.porosity)
            context.report(porosity_error=error, checked_at=finer)
            if error > self.tolerance:
                raise DesignError(
                    f"the porosity on a grid of {finer} voxels along an edge of the cell differs by {error:.5f} from "
                    f"the target of {self.porosity:g}; allowed are {self.tolerance:g}",
                    hint=f"measure on a finer grid, for example `resolution: {2 * n}`",
                )
        shares = _porosities(sums, micro.level, n)
        interiors = np.concatenate([arrays.interior.ravel() for arrays in trial])
        count = np.bincount(interiors, minlength=micro.interiors)
        mean = np.bincount(interiors, np.concatenate(shares), micro.interiors) / np.maximum(count, 1)
        measured = tuple(float(v) for v in mean[count > 0])
        return TileSet(micro, self.kind, self.palette_size(), measured, self.porosity)

    def _sums(self, context: Context, micro: Microstructure, trial: list[TilingArrays], n: int) -> list[F32]:
        """The kernel sum G of each trial layout, (nx, ny, nz) each."""
        tileset = TileSet(micro, self.kind, self.palette_size())

        def sums(arrays: TilingArrays) -> F32:
            threads = context.threads if len(trial) == 1 else 1
            return Tiling(tileset, arrays, None).sums(cell_centers(n, arrays.shape), threads)

        if len(trial) == 1:
            return [sums(trial[0])]
        # many small layouts: one thread each keeps all busy
        with ThreadPoolExecutor(context.threads) as pool:
            return list(pool.map(sums, trial))


def in_turn(interiors: int, lay: Callable[[Bools], Laid]) -> list[TilingArrays]:
    """A periodic layout by a rule in which each interior has its turn, as a hash may leave one out."""
    side = max(2, math.ceil(interiors ** (1 / 3)))
    interior, faces = lay(np.ones((side,) * 3, bool))
    return [TilingArrays((np.arange(interior.size, dtype=np.int32) % interiors).reshape(interior.shape), faces, True)]


def check_faces(micro: Microstructure, palette: Palette, recipe: str) -> None:
    """Different interiors fit side by side only at the faces that they share.

    Raises DesignError if the recipe put no pores on the faces, or fewer patterns than there are colors.
    """
    if palette.interiors > 1 and any(made < asked for made, asked in zip(micro.colors, palette.colors, strict=True)):
        raise DesignError(
            f"the recipe {recipe!r} makes {list(micro.colors)} face patterns across x, y and z, and "
            f"{palette.interiors} different interiors need {list(palette.colors)} to fit side by side",
            hint="begin the recipe with `sample.mirrored_faces`, which puts pores on the faces",
        )


def _porosities(sums: list[F32], level: float, n: int) -> list[F64]:
    """Porosity of each cell of each trial layout, in the order of ``interior.ravel()``."""
    found = []
    for g in sums:
        # decided in float32, as slices are
        void = (g >= np.float32(level)).T
        nz, ny, nx = (size // n for size in void.shape)
        found.append(void.reshape(nz, n, ny, n, nx, n).mean((1, 3, 5)).T.ravel())
    return found
