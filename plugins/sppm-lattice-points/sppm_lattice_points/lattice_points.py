"""``sample.lattice_points``: pores on a cubic lattice, each moved by chance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_lattice_points.measured import MeasuredSampler
from sppm_pipeline import option
from sppm_pipeline.nouns import InteriorBox

# points of one cube of each lattice, in quarters of the cube's edge
_FACES = [[0, 0, 0], [0, 2, 2], [2, 0, 2], [2, 2, 0]]
BASES = {
    "simple": [[0, 0, 0]],
    "body_centered": [[0, 0, 0], [2, 2, 2]],
    "face_centered": _FACES,
    "diamond": _FACES + [[x + 1, y + 1, z + 1] for x, y, z in _FACES],
}
# distance of nearest neighbors, in edges of the cube
NEAREST = {"simple": 1.0, "body_centered": 3**0.5 / 2, "face_centered": 2**0.5 / 2, "diamond": 3**0.5 / 4}


@dataclass(frozen=True, kw_only=True)
class LatticePoints(MeasuredSampler):
    """Put pores on a simple, body-centered, face-centered or diamond lattice and move each by a random vector.

    No pore moves further than the fraction `jitter` of the distance of nearest neighbors, so that none come closer than
    ``1 - 2 jitter`` of it. Without jitter this is a crystal, and every interior of a tile set is the same.
    """

    name: ClassVar[str] = "sample.lattice_points"

    lattice: str = option("face_centered", help="which lattice; pores lie at its points", choices=tuple(BASES))
    repeat: int = option(2, help="periods along an edge of the cell; cubes of the lattice", minimum=1, maximum=32)
    jitter: float = option(
        0.2,
        help="random displacement of the points; at most this fraction of the distance of nearest neighbors",
        minimum=0,
        maximum=0.5,
    )

    def throw(self, rng: np.random.Generator, box: InteriorBox) -> NDArray[np.float64]:
        """Pores of one interior, cell sizes."""
        basis = np.array(BASES[self.lattice]) / 4
        basis += (1 - basis.max()) / 2  # as far from the low sides of the box as from the high ones
        cubes = np.stack(np.meshgrid(*[np.arange(self.repeat)] * 3, indexing="ij"), -1).reshape(-1, 1, 3)
        sides = box.upper - box.lower
        points = box.lower + (cubes + basis).reshape(-1, 3) / self.repeat * sides
        reach = self.jitter * NEAREST[self.lattice] * float(sides.min()) / self.repeat
        direction = rng.standard_normal(points.shape)
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        points += reach * np.cbrt(rng.random((len(points), 1))) * direction  # uniform in a ball
        # a pore that left the cell is its own image on the other side; in a box it is stopped by the wall
        return points % 1.0 if box.periodic else np.clip(points, box.lower, box.upper)
