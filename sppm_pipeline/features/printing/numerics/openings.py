"""Throats of the void and thin features of either phase, by streamed distances.

A voxel has room for a ball of diameter d if 2 D >= d + h, where D is the distance of its center from the nearest center
of the other phase and h the mean pitch: a passage of w voxels has 2 D = w + h in its middle. Right to within a voxel.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.features.printing.numerics.distance import Coarsened, StreamedDistance
from sppm_pipeline.features.printing.numerics.routes import Depth
from sppm_pipeline.features.printing.numerics.tracker import NEVER, Tracker
from sppm_pipeline.method.connectivity.runs import find_runs

_SLACK = 1e-5


def _squared_room(diameter: float, pitch: tuple[float, float, float]) -> float:
    """The squared distance from the other phase that a ball needs, rounding included."""
    return ((diameter + sum(pitch) / 3) / 2 * (1 - _SLACK)) ** 2


class ThroatLevel(NamedTuple):
    """Void with room for a ball of a diameter."""

    diameter: float
    room: int  # voxels in which the ball has its center, the space around the part included
    undrained: int  # those from which it cannot be moved out


class Throats:
    """Void that does not drain through throats of several diameters; take in layers by `add`, then `finish`.

    A ball that leaves reaches the border of the image, the top, or the plate side: it is what drains after the part was
    taken off the plate. `shape` is (nx, ny), `diameters` are in the unit of `pitch`; `depth`, a diameter and what takes
    in where its ball has room, is optional.
    """

    def __init__(
        self,
        shape: tuple[int, int],
        pitch: tuple[float, float, float],
        diameters: Sequence[float],
        depth: tuple[float, Depth] | None = None,
    ) -> None:
        self._depth = depth
        self._diameters = tuple(diameters)
        self._bounds = [np.float32(_squared_room(d, pitch)) for d in self._diameters]
        self._distance = StreamedDistance(shape, pitch, (max(self._diameters) + sum(pitch) / 3) / 2)
        self._trackers = [Tracker("void", "supports") for _ in self._diameters]
        self._room = [0] * len(self._diameters)
        self._layers = 0

    def add(self, solid: NDArray[np.uint8]) -> None:
        """Take in the next layer."""
        self._follow(self._distance.add(solid))

    def _follow(self, finished: Iterable[NDArray[np.float32]]) -> None:
        for squares in finished:
            for i, bound in enumerate(self._bounds):
                roomy = (squares >= bound).view(np.uint8)
                if self._depth is not None and self._depth[0] == self._diameters[i]:
                    self._depth[1].add(roomy)
                self._room[i] += self._trackers[i].add(find_runs(roomy[None]), self._layers).area
            self._layers += 1

    def finish(self) -> list[ThroatLevel]:
        """Results at each diameter."""
        self._follow(self._distance.finish())
        return [
            ThroatLevel(d, room, int(tracker.finish(self._layers).totals[NEVER]))
            for d, room, tracker in zip(self._diameters, self._room, self._trackers, strict=True)
        ]


class ThinFeatures:
    """Part of a phase that no ball of a diameter covers: features thinner than it, to within a voxel, and sharp edges.

    The phase minus its morphological opening. Take in the layers of the phase by `add`, then `finish`. `shape` is (nx,
    ny); `outside` says that the phase goes on beyond the image, as void does.
    """

    def __init__(
        self, shape: tuple[int, int], pitch: tuple[float, float, float], diameter: float, outside: bool
    ) -> None:
        self._bound = np.float32(_squared_room(diameter, pitch))
        reach = (diameter + sum(pitch) / 3) / 2
        self._outside = np.uint8(outside)
        # a border of one voxel stands for what lies beyond the image
        padded = (shape[0] + 2, shape[1] + 2)
        self._to_rest = StreamedDistance(padded, pitch, reach)
        self._to_core = StreamedDistance(padded, pitch, reach)
        self._waiting: deque[NDArray[np.uint8]] = deque()
        self.thin: list[int] = []
        self.phase: list[int] = []
        self._beyond = np.full(padded[::-1], self._outside, np.uint8)
        self._take(self._beyond)

    def add(self, phase: NDArray[np.uint8]) -> None:
        """Take in the next layer of zeros and ones."""
        self._take(np.pad(phase, 1, constant_values=self._outside))

    def _take(self, layer: NDArray[np.uint8]) -> None:
        self._waiting.append(layer)
        self._erode(self._to_rest.add(1 - layer))

    def _erode(self, finished: Iterable[NDArray[np.float32]]) -> None:
        for squares in finished:
            self._open(self._to_core.add((squares >= self._bound).view(np.uint8)))

    def _open(self, finished: Iterable[NDArray[np.float32]]) -> None:
        for squares in finished:
            layer = self._waiting.popleft()[1:-1, 1:-1]
            self.phase.append(int(layer.sum()))
            self.thin.append(int(np.count_nonzero(layer.view(np.bool_) & (squares[1:-1, 1:-1] >= self._bound))))

    def finish(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Thin voxels and voxels of the phase in each layer."""
        self._take(self._beyond)
        self._erode(self._to_rest.finish())
        self._open(self._to_core.finish())
        return np.array(self.thin[1:-1]), np.array(self.phase[1:-1])


class Coarse:
    """Hands layers with larger voxels to several of the above; `add` fine ones, then `finish`."""

    def __init__(self, coarsened: Coarsened, *users: tuple[Throats | ThinFeatures, bool]) -> None:
        self._coarsened, self._users = coarsened, users

    def add(self, solid: NDArray[np.uint8]) -> None:
        """Take in the next fine layer of zeros and ones."""
        self._hand_on(self._coarsened.add(solid))

    def finish(self) -> None:
        """Hand on what is left."""
        self._hand_on(self._coarsened.finish())

    def _hand_on(self, layers: Iterable[NDArray[np.uint8]]) -> None:
        for layer in layers:
            for user, void in self._users:
                user.add(1 - layer if void else layer)
