"""What a phase looks like: how many pieces, how much hangs together, and whether it runs through the cell."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.connectivity.components import find_components


class PhaseReport(NamedTuple):
    """Connectivity of one phase.

    Attributes
    ----------
    components : int
        Number of connected components; 0 for an empty phase.
    largest_share : float
        Share of the phase that is in its largest component; 0 for an empty phase.
    wraps : 3 bools
        Whether the largest component runs through along x, y, z: along a periodic axis, whether it is connected to its
        own periodic image; along another, whether it reaches from the first to the last layer.
    removed_share : float
        Share of the phase that goes when only the largest component is kept.
    """

    components: int
    largest_share: float
    wraps: tuple[bool, bool, bool]
    removed_share: float


def phase_report(
    mask: NDArray[np.bool_] | NDArray[np.uint8],
    periodic: tuple[bool, bool, bool] = (True, True, True),
    connectivity: int = 6,
    *,
    zeros: bool = False,
) -> PhaseReport:
    """Report the connectivity of one phase.

    Use 6 for both phases, though the topological dual of a 6-connected solid is a 26-connected void: two solid voxels
    that share only an edge carry no load and two void voxels that share only an edge let no resin out, so connection
    across faces is the strict measure, on the safe side, for either.

    Parameters
    ----------
    mask : (nz, ny, nx) bool or uint8
        The phase; anything but 0 belongs to it.
    periodic : 3 bools
        Whether opposite faces are merged, along x, y, z.
    connectivity : {6, 26}
        Neighbors across faces, or across faces, edges and corners.
    zeros : bool
        Report the other phase, the voxels that are 0, without a copy of the mask.

    Returns
    -------
    PhaseReport
    """
    found = find_components(mask, periodic, connectivity, zeros)
    if found.sizes.size == 0:
        return PhaseReport(0, 0.0, (False, False, False), 0.0)
    total = int(found.sizes.sum())
    largest = int(found.sizes[0])
    low, high = found.faces[0, ::2], found.faces[0, 1::2]
    x, y, z = (bool(v) for v in np.where(np.array(periodic), found.wraps[0], low & high))
    return PhaseReport(int(found.sizes.size), largest / total, (x, y, z), (total - largest) / total)
