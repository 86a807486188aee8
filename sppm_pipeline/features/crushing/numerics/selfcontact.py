"""Which surfaces of a moving body may touch, and how they push."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.features.crushing.numerics import contact
from sppm_pipeline.features.crushing.numerics.body import Body

Share = Callable[[int, Callable[[int, int], None]], None]
"""Lets threads work on about equal shares of so many things."""

_NONE, _NO_SHARE = np.zeros(0, np.int64), np.zeros(0)


class SelfContact:
    """The balls of a body's surface, the pairs of them that are near each other, and their forces.

    `stiffness` of contacts and `mass` of voxels are those of each phase. `points` are nodes that carry a ball each, of
    which `points_share` (points,) is the share of a voxel's mass, up to 1, and `points_phase` the phase. `pushed`
    (carriers,) says which voxels at the surface, and then points, are in contact; `push` (carriers, 8, 3) has the
    forces on `corners` (carriers, 8), which of a point are all the same.
    """

    def __init__(
        self, body: Body, stiffness: NDArray[np.float64], mass: NDArray[np.float64], friction: float, dt: float,
        share: Share, points: NDArray[np.int64] = _NONE, points_share: NDArray[np.float64] = _NO_SHARE,
        points_phase: NDArray[np.int64] = _NONE,
    ) -> None:  # fmt: skip
        self._body, self._friction, self._dt, self._share = body, friction, dt, share
        count = len(body.surface) + len(points)
        shape = (count, 8, 3)
        phases = np.concatenate([body.phases[body.surface], points_phase]).astype(np.int64)
        self.corners = np.concatenate([body.corners[body.surface], np.repeat(points[:, None], 8, 1)]).astype(np.uint32)
        # in half voxels, so that nodes have places, too; those of neighbors are no more than two apart
        self._places = np.concatenate([2 * body.voxels[body.surface] + 1, 2 * body.nodes[points]]).astype(np.int32)
        self._carried = np.concatenate([body.carried, np.ones(len(points), np.uint8)])
        shares = np.concatenate([np.ones(len(body.surface)), points_share])
        self._stiffness, self._mass = shares * stiffness[phases], shares * mass[phases]
        self._balls = [np.zeros(shape) for _ in range(3)]
        self._lossy, self.push = np.zeros(shape), np.zeros(shape)
        self.pushed = np.zeros(count, np.uint8)
        self._starts = np.zeros(8 * count + 1, np.int32)
        self._all = np.arange(count, dtype=np.int32)
        self._room = 64
        self._was_lost = 0.0
        self._sums = np.zeros((0, contact.SUMS))

    @property
    def stored(self) -> float:
        """Energy of all contacts."""
        return float(self._sums[:, 0].sum())

    @property
    def lost(self) -> float:
        """Energy lost to damping and friction of contacts."""
        return self._was_lost + float(self._sums[:, 1].sum())

    @lost.setter
    def lost(self, value: float) -> None:
        self._was_lost = value
        self._sums[:, 1] = 0

    def search(self, x: NDArray[np.float64], v: NDArray[np.float64]) -> None:
        """Search the pairs that may come to touch, and what touches now, at positions and velocities (nodes, 3)."""
        self._was_lost = self.lost
        now, before, _ = self._balls
        self._place(x, v, now, self._all, 0.0)
        centers = now.mean(1)
        radii = np.sqrt(((now - centers[:, None]) ** 2).sum(2).max(1))
        width = contact.REACH + 2 * float(radii.max())
        # a piece that has flown off counts to the border of the grid
        origin = np.maximum(centers.min(0), [-n for n in self._body.shape])
        far = np.minimum(centers.max(0), [2 * n for n in self._body.shape])
        shape = np.maximum(np.floor((far - origin) / width).astype(np.int64), 0) + 1
        starts = np.zeros(int(np.prod(shape)) + 2, np.int32)
        names, points, homes = np.empty(len(now), np.int32), np.empty((len(now), 4)), np.empty((len(now), 3), np.int32)
        contact.sort_voxels(centers, radii, self._places, origin, width, shape, starts, names, points, homes)
        found: dict[int, NDArray[np.int32]] = {}

        def layers(first: int, last: int) -> None:
            room = 1 + self._room * (last - first)
            while True:
                pairs = np.empty((room, 2), np.int32)
                # how many pairs there are is known only afterwards: a second search has room for all
                count = contact.search(starts, names, points, homes, shape, first, last, now, self._carried, pairs)
                if count <= room:
                    found[first] = pairs[:count]
                    return
                room = count

        self._share(int(shape[2]), layers)
        pairs = np.concatenate([found[first] for first in sorted(found)])
        self._room = 1 + 2 * len(pairs) // int(shape[2])
        self._partners = np.empty(2 * len(pairs), np.int32)
        contact.list_partners(pairs, self._starts, self._partners)
        self._active = np.flatnonzero(np.diff(self._starts[::8])).astype(np.int32)
        self._sums = np.zeros((-(-len(self._active) // contact.CHUNK), contact.SUMS))
        self._place(x, v, before, self._active, self._dt)
        # losses need the balls two steps ago, which are not known of new pairs: the first step loses nothing
        self._lossy[:] = 0
        self.pushed[:] = 0
        self._repel()

    def follow(self, x: NDArray[np.float64], v: NDArray[np.float64]) -> None:
        """Forces a step later."""
        if len(self._active):
            self._balls = [self._balls[2], self._balls[0], self._balls[1]]
            self._place(x, v, self._balls[0], self._active, 0.0)
            self._repel()

    def _place(
        self, x: NDArray[np.float64], v: NDArray[np.float64], balls: NDArray[np.float64], active: NDArray[np.int32],
        ago: float,
    ) -> None:  # fmt: skip
        self._share(len(active), lambda a, b: contact.place(x, v, ago, self.corners, active, a, b, balls))

    def _repel(self) -> None:
        now, before, earlier = self._balls

        def chunks(a: int, b: int) -> None:
            contact.repel(
                now, before, earlier, self._active, a, b, self._starts, self._partners, self._stiffness, self._mass,
                self._friction, self._dt, self._lossy, self.pushed, self.push, self._sums,
            )  # fmt: skip

        self._share(len(self._sums), chunks)
