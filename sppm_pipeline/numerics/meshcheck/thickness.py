"""How thick the walls of a solid are: how far it is, straight inwards from its surface, to where the solid ends."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.meshcheck.box_tree import BoxTree
from sppm_pipeline.numerics.meshcheck.crossing_rays import exits_along

SAMPLES = 100_000
"""Points of the surface from which the thickness is taken."""


class WallThickness(NamedTuple):
    """What `wall_thickness` finds.

    Attributes
    ----------
    thickness : (k,) float64
        At points that stand for equal areas; infinity where a ray leaves nowhere.
    points : (k, 3) float64
    """

    thickness: NDArray[np.float64]
    points: NDArray[np.float64]

    def quantile(self, share: float) -> float:
        """The thickness that this share of the area is below."""
        return float(np.quantile(self.thickness, share, method="lower"))

    def share_below(self, limit: float) -> float:
        """The share of the area where the wall is thinner than a limit."""
        return float(np.mean(self.thickness < limit))


def wall_thickness(tree: BoxTree, samples: int = SAMPLES) -> WallThickness:
    """Thickness of the walls of a mesh wound outwards.

    Rays run along the inward normal from points spread evenly over the area, the same for the same mesh. Each ends
    where it first leaves the solid through another triangle. Where surfaces meet in a sharp edge the thickness goes to
    0, as it does in the solid; only the share of such area says how much of the solid that concerns.

    Parameters
    ----------
    tree : BoxTree
    samples : int
        Number of points.
    """
    t = tree.triangles
    normals = np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0])
    twice = np.linalg.norm(normals, axis=1)
    share = np.cumsum(twice)
    if not share[-1] > 0:
        return WallThickness(np.empty(0), np.empty((0, 3)))
    i = np.arange(samples)
    # inside of a triangle, points follow a sequence of low discrepancy (Roberts 2018) that no lattice can resonate with
    place = np.minimum(np.searchsorted(share, (i + 0.5) / samples * share[-1], side="right"), len(share) - 1)
    one, other = (0.5 + i * 0.7548776662466927) % 1, (0.5 + i * 0.5698402909980532) % 1
    over = one + other > 1
    one, other = np.where(over, 1 - one, one)[:, None], np.where(over, 1 - other, other)[:, None]
    a, b, c = t[place, 0], t[place, 1], t[place, 2]
    points = a + one * (b - a) + other * (c - a)
    inwards = -normals[place] / twice[place, None]
    return WallThickness(exits_along(tree, points, inwards, tree.order[place], False), points)
