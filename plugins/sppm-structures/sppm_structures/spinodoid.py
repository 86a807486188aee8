"""``field.spinodoid``: random fields like those of spinodal decomposition, with directions left out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import ConfigError, Context, DesignError, FieldMaker, Palette, ScalarField, Size, option
from sppm_pipeline.nouns import FormulaField
from sppm_structures.sizes import field_size
from sppm_structures.waves import Waves, half_space, sum_of_waves, waves_of

SMALLEST_CONE = 15.0
"""Below this angle, degrees, the solid falls into separate layers (Kumar et al. 2020)."""


@dataclass(frozen=True, eq=False, kw_only=True)
class SpinodoidField(FormulaField):
    """The solid where a sum of waves, scaled to variance 1, lies below a level in standard deviations."""

    waves: Waves
    level: float
    repeat: int = 1

    def evaluate(self, x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64]) -> NDArray[np.floating]:
        values = sum_of_waves(self.waves, *((self.repeat * axis) % 1.0 for axis in (x, y, z)))
        values -= self.level
        return values

    def cut_at(self, value: float) -> SpinodoidField:
        return replace(self, level=self.level + value)

    def summary(self) -> dict[str, Any]:
        """Number of waves and the level."""
        return {"waves": len(self.waves.vectors), "level": self.level}


@dataclass(frozen=True, kw_only=True)
class Spinodoid(FieldMaker):
    """A Gaussian random field ``sqrt(2/n) sum cos(2 pi k.x + phase)`` cut at a level: a spinodoid.

    After Kumar, Tan, Zheng and Kochmann 2020, "Inverse-designed spinodoid metamaterials". Wave vectors lie near a
    sphere and within cones around the axes; a cone of 90 degrees takes every direction (isotropic), one small cone
    makes layers (lamellar), two make columns, three a cubic structure. Theirs is drawn from a continuous sphere and
    does not repeat; this one takes integers of waves along an edge of the cell, from a shell about the sphere, so that
    the field is periodic. A field of few waves is less random: raise `wavenumber`, or make the shell thicker.

    Solid is where the field lies below the level; ``tune.porosity`` changes it. Without tuning, the level is that at
    which a Gaussian field has the target density.
    """

    name: ClassVar[str] = "field.spinodoid"
    sources: ClassVar[tuple[str, ...]] = (
        "S. Kumar, S. Tan, L. Zheng, D. M. Kochmann: Inverse-designed spinodoid metamaterials. npj "
        "Computational Materials 6, 2020. https://doi.org/10.1038/s41524-020-0341-6",
    )
    is_random: ClassVar[bool] = True

    wavenumber: float = option(
        5.0, help="periods along an edge of the cell of the waves, about the number of pores", minimum=1, maximum=64
    )
    shell: float = option(
        0.5, help="wave vectors may be longer or shorter by this", unit="periods per cell size", above=0, maximum=8
    )
    cones: tuple[float, float, float] = option(
        (90.0, 0.0, 0.0),
        help="half angles of the cones about x, y, z that wave vectors are taken from; 0 for none",
        unit="degrees",
        minimum=0,
        maximum=90,
    )
    waves: int | None = option(None, help="number of waves, drawn from those there are; all if omitted", minimum=1)
    density: float = option(0.5, help="expected share of solid, which sets the level", above=0, below=1)
    repeat: int = option(1, help="periods along an edge of the cell", minimum=1, maximum=64)

    def check_options(self) -> None:
        if not any(self.cones):
            raise ConfigError("all cones are empty", hint="give at least one angle, such as `cones: [30, 0, 0]`")
        low = [angle for angle in self.cones if 0 < angle < SMALLEST_CONE]
        if low:
            raise ConfigError(
                f"a cone of {low[0]:g} degrees leaves separate layers; allowed are 0 and {SMALLEST_CONE:g} to 90"
            )

    def estimate(self, palette: Palette) -> Size:
        # Rice's formula for the level of a Gaussian field whose waves are of one length
        level = NormalDist().inv_cdf(self.density)
        surface = 4 / np.sqrt(3) * self.wavenumber * self.repeat * np.exp(-(level**2) / 2)
        return field_size(self.edge_mm, self.density, float(surface), 1 + 1.5 * self.wavenumber)

    def run(self, context: Context) -> ScalarField:
        """Draw wave vectors and phases."""
        vectors = wave_vectors(self.wavenumber, self.shell, self.cones)
        rng = context.rng()
        if self.waves is not None:
            if self.waves > len(vectors):
                raise DesignError(
                    f"there are {len(vectors)} different waves in the cones, {self.waves} are asked for",
                    hint="raise `wavenumber` or `shell`, widen the cones, or leave out `waves` to take all",
                )
            vectors = vectors[np.sort(rng.choice(len(vectors), self.waves, replace=False))]
        phases = 2 * np.pi * rng.random(len(vectors))
        context.report(waves=len(vectors))
        return SpinodoidField(
            waves=waves_of(vectors, phases, np.sqrt(2 / len(vectors))),
            level=NormalDist().inv_cdf(self.density),
            repeat=self.repeat,
            edge=self.edge_mm,
        )


def wave_vectors(wavenumber: float, shell: float, cones: tuple[float, float, float]) -> NDArray[np.int64]:
    """Integer vectors of nearly the length `wavenumber` within cones about the axes, one of each opposite pair.

    `DesignError` if there is none.
    """
    most = int(np.floor(wavenumber + shell))
    axis = np.arange(-most, most + 1)
    every = half_space(np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3))
    lengths = np.sqrt((every * every).sum(axis=1))
    near = np.abs(lengths - wavenumber) <= shell + 1e-9
    every, lengths = every[near], lengths[near]
    cosines = np.cos(np.radians(cones)) - 1e-9
    inside = ((np.abs(every) >= lengths[:, None] * cosines) & (np.array(cones) > 0)).any(axis=1)
    if not inside.any():
        raise DesignError(
            f"no wave of {wavenumber - shell:g} to {wavenumber + shell:g} periods per cell size lies in the cones",
            hint="make `shell` thicker, or `wavenumber` an integer",
        )
    chosen: NDArray[np.int64] = every[inside]
    return chosen
