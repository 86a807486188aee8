"""A periodic field whose level varies smoothly from place to place, by a sum of long waves."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from sppm_pipeline.method.fields.scalar_field import CutField
from sppm_pipeline.nouns.artifact import frozen
from sppm_pipeline.services.arrays import F32, F64, I64
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.jit.compiled import jit


@jit
def _subtract_waves(x: F64, y: F64, z: F64, parts: F64, cut: float, out: F32) -> None:
    """Subtract ``cut + Re sum parts[k] exp(2 pi i k x)`` at the points of a grid; the last k is not negative.

    `x`, `y`, `z` (n, 2 m + 1, 2) and `parts` (2 m + 1, 2 m + 1, 2 m + 1, 2), indexed z, y, x, are real and imaginary
    parts of the waves -m to m. Sums go in the order of waves, so that a value depends on its position alone.
    """
    width = parts.shape[0]
    plane, row = np.empty((width, width, 2)), np.empty((width, 2))
    for k in range(out.shape[0]):
        for b in range(width):
            for a in range(width):
                real = imaginary = 0.0
                for c in range(width):
                    p, q = parts[c, b, a, 0], parts[c, b, a, 1]
                    real += p * z[k, c, 0] - q * z[k, c, 1]
                    imaginary += p * z[k, c, 1] + q * z[k, c, 0]
                plane[b, a, 0], plane[b, a, 1] = real, imaginary
        for j in range(out.shape[1]):
            for a in range(width):
                real = imaginary = 0.0
                for b in range(width):
                    p, q = plane[b, a, 0], plane[b, a, 1]
                    real += p * y[j, b, 0] - q * y[j, b, 1]
                    imaginary += p * y[j, b, 1] + q * y[j, b, 0]
                row[a, 0], row[a, 1] = real, imaginary
            for i in range(out.shape[2]):
                value = cut
                for a in range(width):
                    value += row[a, 0] * x[i, a, 0] - row[a, 1] * x[i, a, 1]
                out[k, j, i] -= np.float32(value)


def waves_up_to(order: int) -> I64:
    """Wave vectors, of each pair of opposite ones that which is positive in its first component not 0, (n, 3)."""
    axis = np.arange(-order, order + 1)
    found = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    return np.asarray(found[len(found) // 2 + 1 :], np.int64)


def wave_values(order: int, points: F64) -> F64:
    """Cosines and sines of `waves_up_to`, of a mean square of 1, at points (m, 3) in cells; (2 n, m)."""
    angle = 2 * math.pi * (waves_up_to(order) @ points.T)
    return math.sqrt(2) * np.concatenate([np.cos(angle), np.sin(angle)])


@dataclass(frozen=True, eq=False)
class WavedField(CutField):
    """A field less a constant and a sum of waves that fit into the cell: walls and struts are thicker here, thinner
    there.

    Attributes
    ----------
    order : int
        Waves have at most so many periods along each axis.
    amplitudes : (2 n,) float64
        Of the cosines and sines of `waves_up_to`, each of a mean square of 1; the unit of the field.
    """

    order: int
    amplitudes: F64

    def __post_init__(self) -> None:
        object.__setattr__(self, "amplitudes", frozen(np.asarray(self.amplitudes, np.float64)))

    def check(self) -> None:
        """Amplitudes are numbers, as many as there are waves."""
        super().check()
        if self.amplitudes.shape != (2 * len(waves_up_to(self.order)),) or not np.isfinite(self.amplitudes).all():
            raise ValueError(f"amplitudes of the order {self.order} are finite, got {self.amplitudes.shape}")

    @property
    def sum_level(self) -> float | None:
        return None

    def sample_layers(self, grid: Grid, start: int, stop: int, threads: int = 1) -> F32:
        values = np.array(self.base.sample_zyx(grid, start, stop, threads), np.float32, order="C")
        x, y, z = self._factors(grid, start, stop)
        _subtract_waves(x, y, z, self._parts(), self.value, values)
        return values.T

    def _factors(self, grid: Grid, start: int, stop: int) -> list[F64]:
        """Waves along x, y and z at the places of the samples, (n, 2 m + 1, 2)."""
        found = []
        for axis, (first, last) in enumerate(((0, grid.shape[0]), (0, grid.shape[1]), (start, stop))):
            places = grid.origin[axis] + grid.spacing[axis] * np.arange(first, last)
            angle = 2 * math.pi * places[:, None] * np.arange(-self.order, self.order + 1)
            found.append(np.stack([np.cos(angle), np.sin(angle)], -1))
        return found

    def _parts(self) -> F64:
        """Real and imaginary parts of the coefficients of the waves, by kz, ky, kx."""
        n, width = len(self.amplitudes) // 2, 2 * self.order + 1
        parts = np.zeros((width, width, width, 2))
        kx, ky, kz = waves_up_to(self.order).T + self.order
        # a cos t + b sin t is the real part of (a - i b) exp(i t)
        parts[kz, ky, kx, 0] = math.sqrt(2) * self.amplitudes[:n]
        parts[kz, ky, kx, 1] = -math.sqrt(2) * self.amplitudes[n:]
        return parts

    def summary(self) -> dict[str, Any]:
        """The summary of the field that is cut, and the waves."""
        return {**super().summary(), "waves": len(self.amplitudes) // 2}
