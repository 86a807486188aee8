"""Throats of the void and thin features of either phase, by streamed distances.

A voxel has room for a ball of diameter d if 2 D >= d + h, where D is the distance of its center from the nearest center
of the other phase and h the mean pitch: a passage of w voxels has 2 D = w + h in its middle. Right to within a voxel.

Cure-through: light of later layers that reaches into void below them and cures resin there.

An exposure decays as exp(-depth / D_p), and one alone cures to the depth C_d = D_p ln(E / E_c) (Jacobs, "Rapid
Prototyping and Manufacturing", 1992: the working curve). Void at layer k has seen the layers above through the film:
sum over j of s(k + j) q^j, q = exp(-h / D_p), in units of the exposure; it is cured where exp(C_d / D_p) times that
reaches 1. Below a thick ceiling that is the depth C_d + D_p ln(1 / (1 - q)).

Distances in a stack of layers that come one by one, as far as a reach; and the same layers with larger voxels.

Squared distances add up along the axes, so a pass along each axis gives exact Euclidean distances; each looks only as
far as the reach. The pass along z needs a ring of twice the reach in layers, and nothing else is kept.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from sppm_pipeline.features.printing.numerics.routes import Depth
from sppm_pipeline.features.printing.numerics.tracker import NEVER, Tracker
from sppm_pipeline.method.connectivity.runs import find_runs
from sppm_pipeline.services.arrays import F32, I32, I64, U8
from sppm_pipeline.services.jit.compiled import inline_jit, jit

UNREACHED = np.float32(np.inf)

_ROUNDED = 1.0 + 1e-5  # float32 squares that equal a bound up to rounding count as within


class StreamedDistance:
    """Squared distance of each voxel to the nearest marked one; exact up to `reach`, infinite beyond.

    `shape` is (nx, ny), `pitch` that of the voxels along x, y, z in the unit of `reach`.
    """

    def __init__(self, shape: tuple[int, int], pitch: tuple[float, float, float], reach: float) -> None:
        self._shape = shape[::-1]
        self._pitch, self._cap = pitch, np.float32((reach * _ROUNDED) ** 2)
        self._reach = tuple(math.floor(reach / h * _ROUNDED) for h in pitch)
        self._ring: deque[F32] = deque()
        self._before = 0  # layers of the ring below the one that is finished next

    def add(self, marked: U8) -> Iterator[F32]:
        """Take in the next layer, (ny, nx), marked where it is not 0; yields the layers that are finished by it."""
        hx, hy, _ = self._pitch
        rows = np.empty(self._shape, np.float32)
        _along_rows(marked, self._reach[0], np.float32(hx * hx), rows)
        plane = np.empty_like(rows)
        _across_rows(rows, self._reach[1], np.float32(hy * hy), plane)
        self._ring.append(plane)
        if len(self._ring) - 1 - self._before >= self._reach[2]:
            yield self._finished()

    def finish(self) -> Iterator[F32]:
        """The layers that waited for more above them."""
        while self._before < len(self._ring):
            yield self._finished()

    def _finished(self) -> F32:
        h2 = np.float32(self._pitch[2] ** 2)
        out = self._ring[self._before].copy()
        for i, plane in enumerate(self._ring):
            if 0 < abs(i - self._before) <= self._reach[2]:
                _lower(out.ravel(), plane.ravel(), h2 * np.float32((i - self._before) ** 2))
        out[out > self._cap] = UNREACHED
        # the lowest layer of a full ring is too far from the next one to be finished
        if self._before == self._reach[2]:
            self._ring.popleft()
        else:
            self._before += 1
        return out


class Coarsened:
    """Layers with voxels larger by whole factors along x, y, z: solid where at least half of the voxels inside are.

    `shape` is (nx, ny). Incomplete blocks at the far ends are filled up with void.
    """

    def __init__(self, shape: tuple[int, int], factors: tuple[int, int, int]) -> None:
        self._factors = factors
        self.shape = (-(-shape[0] // factors[0]), -(-shape[1] // factors[1]))
        self._sum = np.zeros(self.shape[::-1], np.int32)
        self._taken = 0

    def add(self, layer: U8) -> Iterator[U8]:
        """Take in the next layer of zeros and ones; yields a coarse one whenever there are enough."""
        _add_blocks(layer, self._factors[0], self._factors[1], self._sum)
        self._taken += 1
        if self._taken == self._factors[2]:
            yield from self.finish()

    def finish(self) -> Iterator[U8]:
        """The last coarse layer, if it is incomplete."""
        if self._taken:
            yield (2 * self._sum >= math.prod(self._factors)).view(np.uint8)
            self._sum[:] = 0
            self._taken = 0


def coarse_factors(pitch: tuple[float, float, float], voxel: float) -> tuple[int, int, int]:
    """Voxels along x, y, z that together measure at most `voxel`, at least one."""
    x, y, z = (max(1, math.floor(voxel / h * _ROUNDED)) for h in pitch)
    return x, y, z


@jit
def _along_rows(marked: U8, reach: int, h2: np.float32, out: F32) -> None:
    ny, nx = marked.shape
    for y in range(ny):
        far = reach + 1
        for x in range(nx):
            far = 0 if marked[y, x] else far + 1
            out[y, x] = h2 * np.float32(far * far) if far <= reach else UNREACHED
        far = reach + 1
        for x in range(nx - 1, -1, -1):
            far = 0 if marked[y, x] else far + 1
            if far <= reach:
                out[y, x] = min(out[y, x], h2 * np.float32(far * far))


@inline_jit
def _lower(target: F32, other: F32, plus: np.float32) -> None:
    for i in range(target.size):
        target[i] = min(target[i], other[i] + plus)


@jit
def _across_rows(rows: F32, reach: int, h2: np.float32, out: F32) -> None:
    ny = rows.shape[0]
    for y in range(ny):
        out[y] = rows[y]
        for other in range(max(0, y - reach), min(ny, y + reach + 1)):
            if other != y:
                _lower(out[y], rows[other], h2 * np.float32((other - y) * (other - y)))


@jit
def _add_blocks(layer: U8, fx: int, fy: int, total: I32) -> None:
    ny, nx = layer.shape
    for y in range(ny):
        row = total[y // fy]
        for x in range(nx):
            row[x // fx] += layer[y, x]


IGNORED_DOSE = 1e-3
"""Doses of layers farther up than this share of the critical one, all together, are left out."""


class CureThrough:
    """Layers as they cure; `add` those that are exposed, then `finish`.

    `shape` is (nx, ny); layer height, penetration D_p and cure depth C_d are in one unit.
    """

    def __init__(self, shape: tuple[int, int], layer: float, penetration: float, cure_depth: float) -> None:
        self._q = np.float32(math.exp(-layer / penetration))
        # a dose that reaches the critical one up to rounding of float32 cures
        self._critical = np.float32(math.exp(-cure_depth / penetration) * (1 - 1e-6))
        # layers from which on the geometric series of doses is below IGNORED_DOSE of the critical one
        ahead = (cure_depth + penetration * math.log(1 / (IGNORED_DOSE * (1 - float(self._q))))) / layer
        self._ahead = max(1, math.ceil(ahead))
        self._ring: deque[U8] = deque()
        self._shape = shape[::-1]

    def add(self, solid: U8) -> Iterator[U8]:
        """Take in the next layer of zeros and ones; yields layers as printed, once all that reaches them is known."""
        self._ring.append(solid.copy())
        if len(self._ring) > self._ahead:
            yield self._cured()

    def finish(self) -> Iterator[U8]:
        """The last layers."""
        while self._ring:
            yield self._cured()

    def _cured(self) -> U8:
        first = self._ring.popleft()
        dose = np.zeros(self._shape, np.float32)
        for later in reversed(self._ring):
            _decay(dose.ravel(), later.ravel(), self._q)
        return (first.view(np.bool_) | (dose >= self._critical)).view(np.uint8)


@inline_jit
def _decay(dose: F32, exposed: U8, q: np.float32) -> None:
    for i in range(dose.size):
        dose[i] = q * (dose[i] + np.float32(exposed[i]))


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

    def add(self, solid: U8) -> None:
        """Take in the next layer."""
        self._follow(self._distance.add(solid))

    def _follow(self, finished: Iterable[F32]) -> None:
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
        self._waiting: deque[U8] = deque()
        self.thin: list[int] = []
        self.phase: list[int] = []
        self._beyond = np.full(padded[::-1], self._outside, np.uint8)
        self._take(self._beyond)

    def add(self, phase: U8) -> None:
        """Take in the next layer of zeros and ones."""
        self._take(np.pad(phase, 1, constant_values=self._outside))

    def _take(self, layer: U8) -> None:
        self._waiting.append(layer)
        self._erode(self._to_rest.add(1 - layer))

    def _erode(self, finished: Iterable[F32]) -> None:
        for squares in finished:
            self._open(self._to_core.add((squares >= self._bound).view(np.uint8)))

    def _open(self, finished: Iterable[F32]) -> None:
        for squares in finished:
            layer = self._waiting.popleft()[1:-1, 1:-1]
            self.phase.append(int(layer.sum()))
            self.thin.append(int(np.count_nonzero(layer.view(np.bool_) & (squares[1:-1, 1:-1] >= self._bound))))

    def finish(self) -> tuple[I64, I64]:
        """Thin voxels and voxels of the phase in each layer."""
        self._take(self._beyond)
        self._erode(self._to_rest.finish())
        self._open(self._to_core.finish())
        return np.array(self.thin[1:-1]), np.array(self.phase[1:-1])


class Coarse:
    """Hands layers with larger voxels to several of the above; `add` fine ones, then `finish`."""

    def __init__(self, coarsened: Coarsened, *users: tuple[Throats | ThinFeatures, bool]) -> None:
        self._coarsened, self._users = coarsened, users

    def add(self, solid: U8) -> None:
        """Take in the next fine layer of zeros and ones."""
        self._hand_on(self._coarsened.add(solid))

    def finish(self) -> None:
        """Hand on what is left."""
        self._hand_on(self._coarsened.finish())

    def _hand_on(self, layers: Iterable[U8]) -> None:
        for layer in layers:
            for user, void in self._users:
                user.add(1 - layer if void else layer)
