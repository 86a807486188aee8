"""Points drawn by a hash of their place, without end; and points of one periodic cell."""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.nouns import CellIndex

MAX_SEEDS = 5000
"""Seeds of one cell."""

_STREAM = 64
"""First of our streams of the hash; the program's own are below."""


class HashedSeeds(NamedTuple):
    """Seeds of an endless grid of places, `along` of them along an edge of the cell.

    A seed lies in the middle of its place, off by up to half the share `jitter` of the place's width along each axis.
    The share `fine` of the places is cut into eight (Martinez et al. 2016 cut them where a denser foam is wanted).
    """

    seed: int
    along: int
    jitter: float
    fine: float

    @property
    def furthest(self) -> float:
        """No point is further than this from the nearest seed, cell sizes."""
        return float(np.sqrt(3.0) * (1 + self.jitter) / (2 * self.along))

    def near(self, cell: CellIndex, margin: float, periodic: bool) -> tuple[NDArray[np.float64], int]:
        """Seeds in a cell, and those of all places nearer to it than `margin`.

        Returns
        -------
        seeds : (n, 3) float64
            Relative to the low corner of the cell; its own come first.
        own : int
            How many are the cell's.
        """
        n = self.along
        beyond = int(np.ceil(margin * n))
        inside = np.ogrid[:n, :n, :n]
        own = self._at([axis.reshape(-1) for axis in np.broadcast_arrays(*inside)], cell, periodic)
        if not beyond:
            return own, len(own)
        around = [axis.reshape(-1) - beyond for axis in np.indices((n + 2 * beyond,) * 3)]
        out = np.logical_or.reduce([(axis < 0) | (axis >= n) for axis in around])
        others = self._at([axis[out] for axis in around], cell, periodic)
        return np.concatenate([own, others]), len(own)

    def _at(self, places: list[NDArray[np.int64]], cell: CellIndex, periodic: bool) -> NDArray[np.float64]:
        """Seeds of some places, counted from the low corner of the cell."""
        index = [axis + self.along * at for axis, at in zip(places, cell, strict=True)]
        if periodic:
            index = [axis % self.along for axis in index]
        low = np.stack(places, 1).astype(np.float64)
        if not self.fine:
            return (low + self._offsets(index, 0)) / self.along
        cut = self._uniform(index, 3) < self.fine
        parts = [(low[~cut] + self._offsets([axis[~cut] for axis in index], 0)) / self.along]
        corners = [axis[cut] for axis in index]
        for number, corner in enumerate(product((0.0, 0.5), repeat=3)):
            within = 0.5 * self._offsets(corners, 4 + 3 * number) + np.array(corner)
            parts.append((low[cut] + within) / self.along)
        return np.concatenate(parts)

    def _offsets(self, index: list[NDArray[np.int64]], stream: int) -> NDArray[np.float64]:
        drawn = np.stack([self._uniform(index, stream + axis) for axis in range(3)], 1)
        return 0.5 + self.jitter * (drawn - 0.5)

    def _uniform(self, index: list[NDArray[np.int64]], stream: int) -> NDArray[np.float64]:
        from sppm_pipeline.numerics import hash_places

        bits = hash_places(self.seed, _STREAM + stream, *index)
        return (bits >> np.uint64(11)).astype(np.float64) * 2.0**-53


def images_near(seeds: NDArray[np.float64], margin: float) -> tuple[NDArray[np.float64], int]:
    """Seeds of a periodic cell, then their images nearer to it than `margin` along each axis; and how many it has."""
    ring = range(-int(np.ceil(margin)), int(np.ceil(margin)) + 1)
    parts = [seeds]
    for shift in product(ring, repeat=3):
        if any(shift):
            moved = seeds + np.array(shift, float)
            parts.append(moved[((moved >= -margin) & (moved <= 1 + margin)).all(axis=1)])
    return np.concatenate(parts), len(seeds)


def blue_noise(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    """Points of the periodic unit cell by dart throwing, at three quarters of the packing limit, (count, 3)."""
    from sppm_pipeline.numerics import largest_spacing
    from sppm_pipeline.numerics import throw_darts as throw

    spacing = min(largest_spacing(max(round(count / 0.75), 1), (1.0, 1.0, 1.0), periodic=True), 1.0)
    return throw(rng, count, spacing, (0.0,) * 3, (1.0,) * 3, periodic=(True,) * 3)
