"""``connect.my_word``: tunnels between all pores that lie within reach of each other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import Connector, Piece, option


@dataclass(frozen=True, kw_only=True)
class WithinReach(Connector):
    """Join pores that are closer than a length, which is chosen so that none is left alone.

    The shortest length that joins all pores into one is the longest edge of their minimum spanning tree.
    """

    name: ClassVar[str] = "connect.my_word"

    reach: float = option(
        1.1, help="longest tunnel, in multiples of the shortest length that joins all pores", minimum=1, maximum=3
    )

    def join(self, rng: np.random.Generator, piece: Piece) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Tunnels of one piece: pairs of pores, and by how many cells the second of each pair is moved."""
        from scipy.sparse.csgraph import minimum_spanning_tree

        step = piece.points[None] - piece.points[:, None]
        shift = -np.round(step) if piece.periodic else np.zeros_like(step)  # to the nearest image
        length = np.linalg.norm(step + shift, axis=-1)
        longest = self.reach * minimum_spanning_tree(length).max()
        first, second = np.nonzero(np.triu(length <= longest, 1))
        return np.stack([first, second], 1), shift[first, second].astype(np.int64)
