"""A march of a body whose voxels fail: they are released, and what is left of them touches."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from sppm_crushing.numerics import element
from sppm_crushing.numerics.body import DROPPED, Body, surface_of
from sppm_crushing.numerics.contact import SelfContact
from sppm_crushing.numerics.march import ENERGIES, Failed, Load, March
from sppm_crushing.numerics.material import ALPHA, LANES, RELEASED, Material, failing

VOLUMES = (0.05, 5.0)
"""Range of the volume of a voxel that has begun to fail, over that at rest, beyond which it is released."""

SOFT, FREE = 0.1, 1.0
"""Stiffness of contacts of rubble, a node each, over that of voxels of as much mass, as many may squeeze one node; and
distance from corners of the surface at which nodes become rubble, which must not begin with an overlap."""

_KEPT = ("cracks", "released", "last_alpha", "held", "points")


class FailingMarch(March):
    """A march on which voxels that have failed are released.

    Its balance has one energy more, `failed`: what voxels stored when they were released, and the motion of nodes that
    left.
    """

    energies = (*ENERGIES, "failed")
    fails = True

    def __init__(self, body: Body, materials: tuple[Material, ...], load: Load, threads: int = 1) -> None:
        self._failing = failing(materials)
        self._failure = np.array([m.failure_strain for m in materials])
        self._softening = np.array([m.yield_stress[-1][0] if m.fails else math.inf for m in materials])
        self._cracks = np.zeros((len(body.lanes) if any(m.cracks for m in materials) else 0, 4, LANES))
        self._released, self._last_alpha = np.zeros(len(body.corners), bool), np.zeros(len(body.corners))
        self._ghosts, self._points = np.zeros(0, np.int64), np.zeros(len(body.nodes), bool)
        self._bare, self._failed = False, 0.0
        super().__init__(body, materials, load, threads)

    def relist(self) -> None:
        """Search the surfaces that may come to touch, those that failure has laid bare among them."""
        if not self._bare:
            super().relist()
            return
        stored = self._contact.stored
        self._expose()
        super().relist()
        # what contacts of a new surface store was not in the balance
        self._failed += stored - self._contact.stored

    def _forces(self) -> None:
        super()._forces()
        if len(self._ghosts):
            # rubble, and surfaces of released voxels that nothing has replaced yet
            at = self._ghosts[self._contact.pushed[self._ghosts] > 0]
            np.add.at(self._f, self._contact.corners[at], self._contact.push[at])

    def _ratios(self) -> NDArray[np.float64]:
        ratios = super()._ratios()
        self._release(ratios)
        ratios[self._released] = 0.5
        return ratios

    def _balance(self) -> list[float]:
        return [*super()._balance(), self._failed]

    @property
    def plastic_strain(self) -> NDArray[np.float64]:
        """Equivalent plastic strain of each element; of a released one that at its end."""
        return np.where(self._released, self._last_alpha, self._of_elements(ALPHA))

    @property
    def released(self) -> NDArray[np.bool_]:
        """Which elements have failed."""
        return self._released.copy()

    def kept(self) -> dict[str, NDArray[np.float64]]:
        """As of `March`."""
        kept = super().kept()
        return kept | {name: np.array(getattr(self, "_" + name)) for name in _KEPT} | {"failed": np.array(self._failed)}

    def resume(self, kept: Mapping[str, NDArray[np.float64]]) -> None:
        """As of `March`."""
        if kept["released"].any():
            self._compact(kept["released"].astype(bool))
        for name in _KEPT:
            setattr(self, "_" + name, np.array(kept[name]))
        super().resume(kept)
        self._failed = float(kept["failed"])

    def _skin(self) -> SelfContact:
        """Contact of the surface as it is now, and of nodes that belong to released voxels alone."""
        points = np.flatnonzero(self._points)
        phases = np.zeros(len(self.body.nodes), np.int64)
        phases[self.body.corners[self._released]] = self.body.phases[self._released, None]
        # a ball of a voxel moves about half of its mass
        shares = SOFT * np.minimum(1.0, 2 * self._mass0[points] / self._modulus[phases[points]])
        return SelfContact(
            self._live, self._stiffness, self._modulus, self.load.friction, self.dt, self._share, points, shares,
            phases[points],
        )  # fmt: skip

    @property
    def _alone(self) -> NDArray[np.bool_]:
        """Nodes that belong to released voxels alone."""
        alone = np.zeros(len(self.body.nodes), bool)
        alone[self.body.corners[self._released]] = True
        alone[self.body.corners[~self._released]] = False
        return alone

    def _release(self, ratios: NDArray[np.float64]) -> None:
        """Take the stress off voxels that have failed; their mass stays with their nodes."""
        alpha, phases = self._of_elements(ALPHA), self.body.phases
        alpha[self._released] = 0
        failed = alpha >= self._failure[phases]
        # past half of the softening, by plastic strain
        failing = 2 * alpha > (self._softening + self._failure)[phases]
        inside_out = (alpha > self._softening[phases]) & ~(ratios > 0)
        if len(self._cracks):
            first, reached, damage = (self._unblocked(self._cracks[:, row], 0.0) for row in range(3))
            failing |= damage > 0.5
            inside_out |= (damage > 0) & ~(ratios > 0)
            failed |= (damage > 0) & ((1 - damage) * reached <= RELEASED * first)
        failed |= inside_out
        # those about to fail may be torn or crushed before
        doubtful = np.flatnonzero(failing & ~failed)
        if len(doubtful):
            corners = self.x[self.body.corners[doubtful]]
            high = np.array([[a >> c & 1 ^ 1 for c in range(3)] for a in range(8)], float)
            gradients = np.einsum("nac,ab->ncb", corners, (2 * high - 1) / 4)
            volumes = np.linalg.det(gradients)
            failed[doubtful[~((volumes > VOLUMES[0]) & (volumes < VOLUMES[1]))]] = True
        failed &= ~self._released
        if not failed.any():
            return
        self._last_alpha[failed] = alpha[failed]
        elements = np.flatnonzero(failed)
        stored, bent = self._unloaded(elements)
        # off the sums of this step, which the next one sets
        self._sums[0] -= stored, bent, 0.0, bent
        self._failed += stored + bent
        self._compact(failed)

    def _unloaded(self, elements: NDArray[np.int64]) -> tuple[float, float]:
        """Take forces of elements off those of the nodes; their energies stored in the mean strain and in bending."""
        blocks, lanes = np.nonzero(np.isin(self._live.lanes, elements))
        count = len(blocks)
        corners = np.full((count, LANES, 8), -1, np.int32)
        corners[:, 0] = self._corners[blocks, lanes]
        state = np.zeros((count, element.STATE, LANES))
        state[:, :3] = state[:, 8 : element.STATE] = 1
        state[:, :, 0] = self._state[blocks, :, lanes]
        cracks = np.zeros((count if len(self._cracks) else 0, 4, LANES))
        if len(cracks):
            cracks[:, :, 0] = self._cracks[blocks, :, lanes]
        f, sums = np.zeros_like(self._f), np.zeros((1, element.SUMS))
        element.forces(
            self.x, corners, self._phases[blocks], np.array([0, count]), 0, 1, self._table, state,
            np.full((count, LANES), -1, np.int32), self._contact.pushed, self._contact.push,
            np.zeros(element.ROWS * LANES), f, sums, self._failing, cracks,
        )  # fmt: skip
        # a voxel that is inside out has no energy that means anything
        if not np.isfinite(f).all() or not np.isfinite(sums).all():
            raise Failed(self.strain, "a voxel turned inside out")
        self._f -= f
        return float(sums[0, 0]), float(sums[0, 1])

    def _compact(self, failed: NDArray[np.bool_]) -> None:
        """Take failed elements out of their lanes; those behind them move up."""
        self._released |= failed
        lanes = self._live.lanes
        gone = (lanes >= 0) & self._released[lanes]
        blocks = np.flatnonzero(gone.any(1))
        order = np.argsort(gone[blocks], axis=1, kind="stable")
        moved = np.take_along_axis(np.where(gone[blocks], -1, lanes[blocks]), order, 1)
        kept = lanes.copy()
        kept[blocks] = moved
        self._live = self._live._replace(lanes=kept)
        empty = (moved < 0)[:, None]
        at_rest = np.zeros((element.STATE, 1))
        at_rest[:3] = at_rest[8 : element.STATE] = 1
        self._state[blocks] = np.where(empty, at_rest, np.take_along_axis(self._state[blocks], order[:, None], 2))
        if len(self._cracks):
            self._cracks[blocks] = np.where(empty, 0.0, np.take_along_axis(self._cracks[blocks], order[:, None], 2))
        self._arrange()
        self._bare = True
        self._haunt()
        if not self.load.rubble:
            self._drop()

    def _haunt(self) -> None:
        """Find what contact pushes without an element that would pass the force on."""
        surface = self._live.surface
        points = np.arange(len(surface), len(self._contact.pushed))
        self._ghosts = np.concatenate([np.flatnonzero(self._released[surface]), points])

    def _scatter(self) -> None:
        """Nodes that belong to released voxels alone become points that contact pushes, once they overlap nothing."""
        from scipy.spatial import cKDTree

        new = np.flatnonzero(self._alone & ~self._points)
        if len(new):
            balls = self.x[self._live.corners[self._live.surface]].reshape(-1, 3)
            others = np.concatenate([balls, self.x[self._points]])
            near, _ = cKDTree(others).query(self.x[new], distance_upper_bound=FREE)
            self._points[new[np.isinf(near)]] = True

    def _drop(self) -> None:
        """Nodes that belong to released voxels alone leave, with their motion."""
        leaving = self._alone & (self._held & DROPPED == 0)
        if leaving.any():
            self._failed += 0.5 * float(np.sum(self._mass[leaving, None] * self._v[leaving] ** 2))
            self._v[leaving] = 0
            self._f[leaving] = 0
            self._held[leaving] |= DROPPED

    def _expose(self) -> None:
        """The surface of what is left, whose contacts are to be searched."""
        live = np.flatnonzero(~self._released).astype(np.int32)
        surface, carried = surface_of(self.body.shape, self.body.voxels[live], self.load.confined)
        lost = self._contact.lost
        self._live = self._live._replace(surface=live[surface], carried=carried)
        if self.load.rubble:
            self._scatter()
        self._arrange()
        self._contact = self._skin()
        self._contact.lost = lost
        self._bare = False
        self._haunt()
