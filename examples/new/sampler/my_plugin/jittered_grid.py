"""``sample.my_word``: pores on a regular grid, each moved by chance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import Sampler, option
from sppm_pipeline.nouns import InteriorBox


@dataclass(frozen=True, kw_only=True)
class JitteredGrid(Sampler):
    """Put one pore into each of n x n x n boxes, somewhere around its middle."""

    name: ClassVar[str] = "sample.my_word"

    n: int = option(3, help="boxes along an edge of the cell", minimum=1, maximum=100)
    jitter: float = option(
        0.5, help="how far a pore may stray; 0: the middle of its box, 1: anywhere in it", minimum=0, maximum=1
    )

    def throw(self, rng: np.random.Generator, box: InteriorBox) -> NDArray[np.float64]:
        """Pores of one interior, (n^3, 3), cell sizes."""
        corners = np.stack(np.meshgrid(*[np.arange(self.n)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        within = 0.5 + self.jitter * (rng.random(corners.shape) - 0.5)
        return box.lower + (corners + within) / self.n * (box.upper - box.lower)
