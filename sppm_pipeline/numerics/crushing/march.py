"""Explicit march of a compressed body through time, with a balance of energy."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.crushing import contact, element, plates
from sppm_pipeline.numerics.crushing.body import Body, wave_speed
from sppm_pipeline.numerics.crushing.material import ALPHA, LANES, PLASTIC, RATIO, Material, constants

COURANT = 0.6
"""Time step over the time that a pressure wave takes for an edge."""

DAMPING = 0.2
"""Share of critical damping of the slowest wave along the body: 0.4 pi times it is the rate for one of its length."""

RESCALED = 20
"""Steps after which the mass of crushed elements is adapted to their stiffness."""

SLOW, SLOW_TO, FULL_FROM = 0.25, 0.02, 0.06
"""Share of the plate's speed up to a strain, and the strain from which it is full. A body that is set in motion
uniformly resists too much until waves have crossed it a few times; so slowly, that is over within a strain of .006 at
the default rate (a gyroid of 32 voxels, beside a tenth of the rate), and .02 without."""

POINTS = 600
"""Points of a curve to 60 % strain: one for each .1 %."""

ENERGIES = ("elastic", "hourglass", "plastic", "contact", "friction", "kinetic", "damping", "plates", "mass")


_ARRAYS = ("v", "f", "state", "mass", "sums", "node_sums")


class Failed(ArithmeticError):
    """The body came apart; `strain` says when."""

    def __init__(self, strain: float, why: str) -> None:
        super().__init__(f"{why} at a strain of {strain:.3g}")
        self.strain = strain
        self.why = why


class Load(NamedTuple):
    """How a body is compressed.

    Attributes
    ----------
    strain : float
        Of the whole height, at the end.
    rate : float
        Speed of the upper plate over that of waves in a bar of the first material.
    plates : float
        Coefficient of friction of the plates; negative if the body sticks to them.
    confined : bool
        Whether rollers hold the sides.
    friction : float
        Coefficient of friction where the body touches itself.
    """

    strain: float = 0.6
    rate: float = 0.01
    plates: float = 0.0
    confined: bool = False
    friction: float = 0.2


class History(NamedTuple):
    """What was recorded, in units of voxel edges and of the first material.

    Attributes
    ----------
    strain : (n,) float64
    top, bottom : (n,) float64
        Forces of the plates, means over the time between records.
    work : (n,) float64
        Of the upper plate.
    energies : mapping of the names in `ENERGIES` to (n,) float64
        Of the elements, stored in their mean strain, stored in bending and dissipated; of contacts, stored and lost;
        kinetic; lost to damping and at the plates; given to the body by mass that was added.
    """

    strain: NDArray[np.float64]
    top: NDArray[np.float64]
    bottom: NDArray[np.float64]
    work: NDArray[np.float64]
    energies: Mapping[str, NDArray[np.float64]]


class March:
    """A body on its way; `to` moves it on.

    Parameters
    ----------
    body : Body
    materials : tuple of Material
        Of each phase.
    load : Load
    threads : int
        The result does not depend on it.
    """

    def __init__(self, body: Body, materials: tuple[Material, ...], load: Load, threads: int = 1) -> None:
        self.body, self.load = body, load
        self._threads = max(1, threads)
        self._pool = ThreadPoolExecutor(self._threads) if threads > 1 else None
        nz = body.shape[2]
        self._table = constants(materials)
        self._modulus = np.array([m.wave_modulus for m in materials]) / materials[0].wave_modulus
        self.dt = COURANT / wave_speed(materials)
        self._strains = _strains(load, self.dt / nz)
        self.steps = len(self._strains) - 1
        self._recorded = 0.0
        self._corners = body.blocked(body.corners, -1)
        self._phases = body.phases[body.lanes[:, 0]].astype(np.int32)
        number = np.full(len(body.corners), -1, np.int32)
        number[body.surface] = np.arange(len(body.surface), dtype=np.int32)
        self._surface = body.blocked(number, -1)
        self._density = self._modulus[body.phases]
        self._held = np.zeros(len(body.nodes), np.uint8)
        if load.confined:
            for axis, bit in ((0, plates.ROLLS_X), (1, plates.ROLLS_Y)):
                at = body.nodes[:, axis]
                self._held[(at == 0) | (at == body.shape[axis])] |= bit
        # what changes
        self.x = body.nodes.astype(np.float64)
        self._v = np.zeros_like(self.x)
        self._v[:, 2] = -self._speed(0) * self.x[:, 2] / nz
        self._f = np.zeros_like(self.x)
        self._state = np.zeros((len(body.lanes), element.STATE, LANES))
        self._state[:, :3] = 1
        self._state[:, 8 : element.STATE] = 1
        self._mass0 = self._node_masses(self._density)
        self._mass = self._mass0.copy()
        self.step = 0
        self._sums = np.zeros((len(body.slabs) - 1, element.SUMS))
        self._node_sums = np.zeros((-(-len(self.x) // plates.CHUNK), plates.SUMS))
        self._work = 0.0
        self._from_mass = 0.0
        self._contact_lost = 0.0
        self._records: list[list[float]] = []
        self._given = self._kinetic()
        self._begin_contact(materials)
        self._last = self._balance()

    # -- contact

    def _begin_contact(self, materials: tuple[Material, ...]) -> None:
        body = self.body
        shape = (len(body.surface), 8, 3)
        self._touching = body.corners[body.surface].astype(np.uint32)
        self._places = body.voxels[body.surface]
        phase = body.phases[body.surface]
        k = min(contact.STIFFNESS, contact.STABLE / (wave_speed(materials) * self.dt) ** 2)
        wave = self._table[0, 0] + 2 * self._table[0, 1]
        self._stiffness = k * wave * self._modulus[phase]
        self._contact_mass = self._modulus[phase]
        self._balls = [np.zeros(shape) for _ in range(3)]
        self._lossy, self._push = np.zeros(shape), np.zeros(shape)
        self._pushed = np.zeros(len(body.surface), np.uint8)
        self._room = 64
        self._contact_sums = np.zeros((0, contact.SUMS))
        self._starts = np.zeros(8 * len(body.surface) + 1, np.int32)
        self._everything = np.arange(len(body.surface), dtype=np.int32)
        self.relist()

    def relist(self) -> None:
        """Search the pairs that may come to touch, and what touches now."""
        self._listed, self._listed_height = self.x.copy(), self._height(self.step)
        self._contact_lost += float(self._contact_sums[:, 1].sum())
        now, before, _ = self._balls
        self._place(now, self._everything, 0.0)
        centers = now.mean(1)
        radii = np.sqrt(((now - centers[:, None]) ** 2).sum(2).max(1))
        width = contact.REACH + 2 * float(radii.max())
        # a piece that has flown off counts to the border of the grid
        origin = np.maximum(centers.min(0), [-n for n in self.body.shape])
        far = np.minimum(centers.max(0), [2 * n for n in self.body.shape])
        shape = np.maximum(np.floor((far - origin) / width).astype(np.int64), 0) + 1
        starts = np.zeros(int(np.prod(shape)) + 2, np.int32)
        names, points, homes = np.empty(len(now), np.int32), np.empty((len(now), 4)), np.empty((len(now), 3), np.int32)
        contact.sort_voxels(centers, radii, self._places, origin, width, shape, starts, names, points, homes)
        found: dict[int, NDArray[np.int32]] = {}

        def layers(first: int, last: int) -> None:
            room = 1 + self._room * (last - first)
            while True:
                pairs = np.empty((room, 2), np.int32)
                count = contact.search(starts, names, points, homes, shape, first, last, now, self.body.carried, pairs)
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
        self._contact_sums = np.zeros((-(-len(self._active) // contact.CHUNK), contact.SUMS))
        self._place(before, self._active, self.dt)
        self._lossy[:] = 0
        self._pushed[:] = 0
        self._repel()

    def _place(self, balls: NDArray[np.float64], active: NDArray[np.int32], ago: float) -> None:
        self._share(len(active), lambda a, b: contact.place(self.x, self._v, ago, self._touching, active, a, b, balls))

    def _repel(self) -> None:
        now, before, earlier = self._balls

        def chunks(a: int, b: int) -> None:
            contact.repel(
                now, before, earlier, self._active, a, b, self._starts, self._partners, self._stiffness,
                self._contact_mass, self.load.friction, self.dt, self._lossy, self._pushed, self._push,
                self._contact_sums,
            )  # fmt: skip

        self._share(len(self._contact_sums), chunks)

    def _touch(self) -> None:
        if len(self._active):
            self._balls = [self._balls[2], self._balls[0], self._balls[1]]
            self._place(self._balls[0], self._active, 0.0)
            self._repel()
        if float(self._node_sums[:, plates.MOVED].max()) > contact.SLACK**2:
            self.relist()

    # -- the step

    def _share(self, many: int, work: Callable[[int, int], None]) -> None:
        """Let the threads work on about equal shares."""
        if self._pool is None or many < 2:
            work(0, many)
            return
        ends = [many * t // self._threads for t in range(self._threads + 1)]
        list(self._pool.map(work, ends[:-1], ends[1:]))

    def _height(self, step: int) -> float:
        return float(self.body.shape[2] * (1 - self._strains[step]))

    def _speed(self, step: int) -> float:
        """Of the upper plate from this step to the next."""
        return (self._height(step) - self._height(step + 1)) / self.dt

    def _advance(self) -> None:
        nx, ny, nz = self.body.shape
        load = self.load
        wide = (float(nx), float(ny)) if load.confined else (0.0, 0.0)
        rate = 0.4 * math.pi * DAMPING / nz
        speed = self._speed(self.step)
        faster = speed - self._speed(self.step - 1) if self.step else 0.0
        step = np.array([
            self.dt, self._height(self.step), self._height(self.step + 1), speed, rate * self.dt, load.plates,
            self._listed_height, *wide, faster,
        ])  # fmt: skip

        def nodes(a: int, b: int) -> None:
            plates.move(self.x, self._v, self._f, self._mass, self._held, self._listed, a, b, step, self._node_sums)

        before = float(self._node_sums[:, plates.TOP].sum())
        self._share(len(self._node_sums), nodes)
        self._work += speed * (float(self._node_sums[:, plates.TOP].sum()) - before)
        self.step += 1
        self._touch()
        self._forces()
        if self.step % RESCALED == 0:
            self._rescale()
        if self.strain >= self._recorded + 0.6 / POINTS or self.step == self.steps:
            self._record()

    def _forces(self) -> None:
        slabs = len(self._sums)
        for odd in (0, 1):

            def part(a: int, b: int, odd: int = odd) -> None:
                scratch = np.zeros(element.ROWS * LANES)
                element.forces(
                    self.x, self._corners, self._phases, self.body.slabs, 2 * a + odd, min(2 * b + odd, slabs),
                    self._table, self._state, self._surface, self._pushed, self._push, scratch, self._f, self._sums,
                )  # fmt: skip

            self._share((slabs + 1 - odd) // 2, part)

    def _node_masses(self, masses: NDArray[np.float64]) -> NDArray[np.float64]:
        shares = np.repeat(masses / 8, 8)
        return np.bincount(self.body.corners.ravel(), shares, len(self.body.nodes)).astype(np.float64)

    def _rescale(self) -> None:
        """Give crushed elements, which are stiffer, so much more mass that the step stays stable."""
        ratios = self._of_elements(RATIO)
        if not np.isfinite(ratios).all():
            raise Failed(self.strain, "an element has turned inside out")
        if ratios.max() <= 2 and self.added_mass == 0:
            return
        before = self._kinetic()
        self._mass = self._node_masses(self._density * np.maximum(1, 0.5 * ratios))
        self._from_mass += self._kinetic() - before

    def _of_elements(self, row: int) -> NDArray[np.float64]:
        values = np.empty(len(self.body.corners))
        filled = self.body.lanes >= 0
        values[self.body.lanes[filled]] = self._state[:, row - PLASTIC][filled]
        return values

    def _kinetic(self) -> float:
        return 0.5 * float(np.sum(self._mass[:, None] * self._v**2))

    # -- what is known

    @property
    def strain(self) -> float:
        """Of the whole height."""
        return float(self._strains[self.step])

    @property
    def added_mass(self) -> float:
        """Share of the mass of the body."""
        return float(self._mass.sum() / self._mass0.sum() - 1)

    @property
    def plastic_strain(self) -> NDArray[np.float64]:
        """Equivalent plastic strain of each element."""
        return self._of_elements(ALPHA)

    def _balance(self) -> list[float]:
        elements, nodes = self._sums.sum(0), self._node_sums.sum(0)
        touching = self._contact_sums.sum(0)
        kinetic = nodes[plates.KINETIC] if self.step else self._given
        plastic = elements[2] + elements[3] - elements[1]
        return [
            self.strain, self.step * self.dt, nodes[plates.TOP], nodes[plates.BOTTOM], self._work,
            elements[0], elements[1], plastic, touching[0], self._contact_lost + touching[1], kinetic,
            nodes[plates.DAMPED], self._work - nodes[plates.WORK], self._from_mass,
        ]  # fmt: skip

    def _record(self) -> None:
        """Means since the last record: forces by impulse, energies by both ends."""
        now, last = self._balance(), self._last
        if not np.isfinite(now).all():
            raise Failed(self.strain, "the forces have no end")
        time = now[1] - last[1]
        mean = [(a + b) / 2 for a, b in zip(now, last, strict=True)]
        self._records.append([mean[0], (now[2] - last[2]) / time, (now[3] - last[3]) / time, *mean[4:]])
        self._last, self._recorded = now, self.strain

    def to(self, strain: float, told: Callable[[float], None] = lambda strain: None) -> None:
        """Move on to a strain; `told` is called after each record.

        Raises
        ------
        Failed
            If the body comes apart.
        """
        end = min(self.steps, int(np.searchsorted(self._strains, strain - 1e-9)))
        while self.step < end:
            records = len(self._records)
            self._advance()
            if len(self._records) > records:
                told(self.strain)

    def kept(self) -> dict[str, NDArray[np.float64]]:
        """All that another march of the same body needs to go on from here by `resume`, with the same result.

        Contacts are searched anew, here and there, so that a march in which this is called differs in rounding from one
        in which it is not.
        """
        self.relist()
        kept = {name: np.array(getattr(self, "_" + name)) for name in _ARRAYS}
        scalars = (self.step, self._work, self._from_mass, self._contact_lost, self._recorded, self._given)
        return {**kept, "x": self.x.copy(), "scalars": np.array(scalars), "last": np.array(self._last),
                "records": np.array(self._records).reshape(-1, 4 + len(ENERGIES))}  # fmt: skip

    def resume(self, kept: Mapping[str, NDArray[np.float64]]) -> None:
        """Go on from where another march was."""
        for name in _ARRAYS:
            setattr(self, "_" + name, np.array(kept[name]))
        self.x = np.array(kept["x"])
        step, self._work, self._from_mass, lost, self._recorded, self._given = kept["scalars"].tolist()
        self.step = int(step)
        self._contact_sums = np.zeros((0, contact.SUMS))
        self.relist()
        self._contact_lost = lost
        self._last, self._records = kept["last"].tolist(), kept["records"].tolist()

    def history(self) -> History:
        """All records; the first one is the body at rest."""
        start = [0.0] * (4 + len(ENERGIES))
        start[4 + ENERGIES.index("kinetic")] = self._given
        rows = np.array([start, *self._records]).T
        return History(rows[0], rows[1], rows[2], rows[3], dict(zip(ENERGIES, rows[4:], strict=True)))

    def shares(self) -> dict[str, float]:
        """Each energy over the work of the upper plate; the rest is `unbalanced`."""
        now = self._balance()
        work = now[4] or 1.0
        shares = {name: value / work for name, value in zip(ENERGIES, now[5:], strict=True)}
        shares["mass"] = -shares["mass"]
        shares["unbalanced"] = 1 + self._given / work - sum(shares.values())
        return shares

    def close(self) -> None:
        """End the threads."""
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)


def _strains(load: Load, way: float) -> NDArray[np.float64]:
    """Strain after each step, in which waves in a bar go this part of the height: slowly at first, then faster."""
    found = [0.0]
    while found[-1] < load.strain:
        share = SLOW + (1 - SLOW) * (found[-1] - SLOW_TO) / (FULL_FROM - SLOW_TO)
        found.append(found[-1] + load.rate * way * min(max(share, SLOW), 1.0))
    found[-1] = load.strain
    return np.array(found)
