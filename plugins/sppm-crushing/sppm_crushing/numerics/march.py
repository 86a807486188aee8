"""Explicit march of a compressed body through time, with a balance of energy."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_crushing.numerics import contact, element
from sppm_crushing.numerics.body import (
    BOTTOM,
    CHUNK,
    DAMPED,
    KINETIC,
    MOVED,
    ROLLS_X,
    ROLLS_Y,
    SUMS,
    TOP,
    WORK,
    Body,
    move,
    wave_speed,
)
from sppm_crushing.numerics.contact import SelfContact
from sppm_crushing.numerics.material import ALPHA, LANES, PLASTIC, RATIO, Material, constants
from sppm_pipeline.numerics import find_components

COURANT, STABLE = 0.6, 0.8
"""Largest time step over the time that a pressure wave takes for an edge; share of the squared step at which a brick of
its own would get unstable, that its own stiffness may use up: contacts and bending add to it. Bricks amid others bear
more; a brick that hangs on by an edge bears no more than this."""

DAMPING = 0.2
"""Share of critical damping of the slowest wave along the body: 0.4 pi times it is the rate for one of its length."""

RESCALED, AHEAD = 5, 1.05
"""Steps after which the stiffness of crushed elements is looked at, and by how much more mass they are then given than
they need. They keep it: what trembles would be light again whenever its stiffness is seen at a good moment."""

SLOW, SLOW_TO, FULL_FROM = 0.25, 0.02, 0.06
"""Share of the plate's speed up to a strain, and the strain from which it is full. A body that is set in motion
uniformly resists too much until waves have crossed it a few times; so slowly, that is over within a strain of 0.006 at
the default rate (a gyroid of 32 voxels, beside a tenth of the rate), and 0.02 without."""

_SHARES = 2
"""Shares of the work for each thread: where one is held up, another takes over. More cost more than they gain."""

POINTS = 600
"""Points of a curve to 60 % strain: one for each 0.1 %."""

MISSING = 0.01
"""Before a failure, records count up to the last one at which the fraction of work that is missing from the balance of
energy changed by no more than this: a heuristic, not measured. It is half of what a run may miss in all before a
warning, and there are up to 800 records."""

ENERGIES = ("elastic", "hourglass", "plastic", "contact", "friction", "kinetic", "damping", "plates", "mass")

_ARRAYS = ("v", "f", "state", "mass", "heavier", "sums", "node_sums")


class Failed(ArithmeticError):
    """Elements inverted or forces diverged; what was recorded holds up to `strain`."""

    def __init__(self, strain: float, why: str) -> None:
        super().__init__(f"{why} beyond a strain of {strain:.3g}")
        self.strain = strain
        self.why = why


class Load(NamedTuple):
    """Load on a body."""

    strain: float = 0.6  # of the whole height, at the end
    rate: float = 0.01  # speed of the upper plate over that of waves in a bar of the first material
    plates: float = 0.0  # coefficient of friction of the plates; negative if the body sticks to them
    confined: bool = False  # rollers hold the sides
    friction: float = 0.2  # coefficient of friction where the body touches itself
    rubble: bool = True  # nodes of released voxels stay as points that contact pushes; else they leave


class History(NamedTuple):
    """Records (n,) of a run, in units of voxel edges and of the first material.

    Energies, by the names of `March.energies`: of the elements, stored in their mean strain, stored in bending and
    dissipated; of contacts, stored and lost; kinetic; lost to damping and at the plates; given to the body by mass that
    was added.
    """

    strain: NDArray[np.float64]
    top: NDArray[np.float64]  # forces of the plates, means over the time between records
    bottom: NDArray[np.float64]
    work: NDArray[np.float64]  # of the upper plate
    energies: Mapping[str, NDArray[np.float64]]


class March:
    """A body on its way, with a material of each phase; `to` moves it on. The result does not depend on the threads."""

    energies: tuple[str, ...] = ENERGIES
    fails = False
    _failing = np.zeros((0, 3))
    _cracks = np.zeros((0, 4, LANES))

    def __init__(self, body: Body, materials: tuple[Material, ...], load: Load, threads: int = 1) -> None:
        self.body, self.load = body, load
        self._threads = max(1, threads)
        self._pool = ThreadPoolExecutor(self._threads) if threads > 1 else None
        nz = body.shape[2]
        self._table = constants(materials)
        self._modulus = np.array([m.wave_modulus for m in materials]) / materials[0].wave_modulus
        # at rest the volume is what is stiffest
        stiffest = max((3 * m.lame[0] + 2 * m.lame[1]) / m.wave_modulus for m in materials)
        courant = min(COURANT, (STABLE / stiffest) ** 0.5)
        self.dt = courant / wave_speed(materials)
        self._needed = courant**2 / STABLE
        self._strains = _strains(load, self.dt / nz)
        self.steps = len(self._strains) - 1
        self._recorded = 0.0
        self._phases = body.phases[body.lanes[:, 0]].astype(np.int32)
        self._live = body
        self._arrange()
        self._density = self._modulus[body.phases]
        self._held = np.zeros(len(body.nodes), np.uint8)
        if load.confined:
            for axis, bit in ((0, ROLLS_X), (1, ROLLS_Y)):
                at = body.nodes[:, axis]
                self._held[(at == 0) | (at == body.shape[axis])] |= bit
        # what changes
        self.x = body.nodes.astype(np.float64)
        self._v = np.zeros_like(self.x)
        # an affine field: no shock runs through the body at the start
        self._v[:, 2] = -self._speed(0) * self.x[:, 2] / nz
        self._f = np.zeros_like(self.x)
        self._state = np.zeros((len(body.lanes), element.STATE, LANES))
        self._state[:, :3] = 1
        self._state[:, 8 : element.STATE] = 1
        self._mass0 = self._node_masses(self._density)
        self._mass = self._mass0.copy()
        self._heavier = np.ones(len(body.corners))
        self.step = 0
        self._sums = np.zeros((len(body.slabs) - 1, element.SUMS))
        self._node_sums = np.zeros((-(-len(self.x) // CHUNK), SUMS))
        self._work = 0.0
        self._from_mass = 0.0
        k = min(contact.STIFFNESS, contact.STABLE / (wave_speed(materials) * self.dt) ** 2)
        self._stiffness = k * (self._table[0, 0] + 2 * self._table[0, 1]) * self._modulus
        self._contact = self._skin()
        self.relist()
        self._given = self._kinetic()
        self._rows = [self._balance()]

    def _arrange(self) -> None:
        """Nodes of the elements in their lanes, and their numbers at the surface."""
        live = self._live
        self._corners = live.blocked(live.corners, -1)
        number = np.full(len(live.corners), -1, np.int32)
        number[live.surface] = np.arange(len(live.surface), dtype=np.int32)
        self._surface = live.blocked(number, -1)

    def _skin(self) -> SelfContact:
        """Contact of the surface."""
        return SelfContact(self._live, self._stiffness, self._modulus, self.load.friction, self.dt, self._share)

    def relist(self) -> None:
        """Search the surfaces that may come to touch."""
        self._listed, self._listed_height = self.x.copy(), self._height(self.step)
        self._contact.search(self.x, self._v)

    # -- the step

    def _share(self, many: int, work: Callable[[int, int], None]) -> None:
        """Let the threads work on about equal shares, each on the next as soon as it is done."""
        if self._pool is None or many < 2:
            work(0, many)
            return
        shares = min(many, _SHARES * self._threads)
        ends = [many * t // shares for t in range(shares + 1)]
        list(self._pool.map(work, ends[:-1], ends[1:]))

    def _height(self, step: int) -> float:
        return float(self.body.shape[2] * (1 - self._strains[step]))

    def _speed(self, step: int) -> float:
        """Of the upper plate from this step to the next."""
        return float((self._height(step) - self._height(step + 1)) / self.dt)

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
            move(
                self.x, self._v, self._f, self._mass, self._mass0, self._held, self._listed, a, b, step,
                self._node_sums,
            )  # fmt: skip

        before = float(self._node_sums[:, TOP].sum())
        self._share(len(self._node_sums), nodes)
        self._work += speed * (float(self._node_sums[:, TOP].sum()) - before)
        self.step += 1
        self._contact.follow(self.x, self._v)
        if float(self._node_sums[:, MOVED].max()) > contact.SLACK**2:
            self.relist()
        self._forces()
        # looking at stiffness costs a pass over the elements, which compress by less than a percent in so few steps
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
                    self._table, self._state, self._surface, self._contact.pushed, self._contact.push, scratch, self._f,
                    self._sums, self._failing, self._cracks,
                )  # fmt: skip

            self._share((slabs + 1 - odd) // 2, part)

    def _node_masses(self, masses: NDArray[np.float64]) -> NDArray[np.float64]:
        shares = np.repeat(masses / 8, 8)
        return np.bincount(self.body.corners.ravel(), shares, len(self.body.nodes)).astype(np.float64)

    def _rescale(self) -> None:
        """Give crushed elements, which are stiffer, so much more mass that the step stays stable."""
        ratios = self._ratios()
        if not (ratios > 0).all():
            raise Failed(self.strain, "a voxel turned inside out")
        needed = self._needed * ratios
        light = needed > self._heavier
        if not light.any():
            return
        self._heavier[light] = AHEAD * needed[light]
        before = self._kinetic()
        self._mass = self._node_masses(self._density * self._heavier)
        self._from_mass += self._kinetic() - before

    def _ratios(self) -> NDArray[np.float64]:
        """Largest stiffness of each element over its wave modulus."""
        return self._of_elements(RATIO)

    def _of_elements(self, row: int) -> NDArray[np.float64]:
        """Of released ones what is larger than 0."""
        return self._unblocked(self._state[:, row - PLASTIC], 0.5)

    def _unblocked(self, values: NDArray[np.float64], empty: float) -> NDArray[np.float64]:
        found = np.full(len(self.body.corners), empty)
        filled = self._live.lanes >= 0
        found[self._live.lanes[filled]] = values[filled]
        return found

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
        """Equivalent plastic strain of each element; of a released one that at its end."""
        return self._of_elements(ALPHA)

    @property
    def released(self) -> NDArray[np.bool_]:
        """Which elements have failed."""
        return np.zeros(len(self.body.corners), bool)

    def fragments(self) -> int:
        """Pieces of what has not failed, connected across faces of voxels."""
        solid = np.zeros(self.body.shape[::-1], np.uint8)
        x, y, z = self.body.voxels[~self.released].T
        solid[z, y, x] = 1
        return len(find_components(solid, (False,) * 3, 6).sizes)

    def _balance(self) -> list[float]:
        elements, nodes = self._sums.sum(0), self._node_sums.sum(0)
        kinetic = nodes[KINETIC] if self.step else self._given
        plastic = elements[2] + elements[3] - elements[1]
        return [
            self.strain, self.step * self.dt, nodes[TOP], nodes[BOTTOM], self._work, elements[0], elements[1], plastic,
            self._contact.stored, self._contact.lost, kinetic, nodes[DAMPED], self._work - nodes[WORK], self._from_mass,
        ]  # fmt: skip

    def _record(self) -> None:
        now = self._balance()
        if not np.isfinite(now).all():
            raise Failed(self.strain, "forces grew without bound")
        self._rows.append(now)
        self._recorded = self.strain

    def to(self, strain: float, report: Callable[[float], None] = lambda strain: None) -> None:
        """Move on to a strain; `report` is called with it after each record.

        `Failed` if elements invert or forces diverge. What was recorded up to its strain holds: there, the energies
        still add up.
        """
        end = min(self.steps, int(np.searchsorted(self._strains, strain - 1e-9)))
        while self.step < end:
            records = len(self._rows)
            try:
                self._advance()
            except Failed as error:
                # failing elements add energy for some steps before they are detected
                missing = np.abs(np.diff([self._shares(row)["unbalanced"] for row in self._rows]))
                while len(self._rows) > 1 and missing[len(self._rows) - 2] > MISSING:
                    self._rows.pop()
                raise Failed(self._rows[-1][0], error.why) from None
            if len(self._rows) > records:
                report(self.strain)

    def kept(self) -> dict[str, NDArray[np.float64]]:
        """All that another march of the same body needs to go on from here by `resume`, with the same result."""
        self.relist()
        # contacts were searched again, as `resume` does: this changes the rounding of the march
        kept = {name: np.array(getattr(self, "_" + name)) for name in _ARRAYS}
        scalars = (self.step, self._work, self._from_mass, self._contact.lost, self._recorded, self._given)
        return {**kept, "x": self.x.copy(), "scalars": np.array(scalars), "rows": np.array(self._rows)}

    def resume(self, kept: Mapping[str, NDArray[np.float64]]) -> None:
        """Go on from where another march was."""
        for name in _ARRAYS:
            setattr(self, "_" + name, np.array(kept[name]))
        self.x = np.array(kept["x"])
        step, self._work, self._from_mass, lost, self._recorded, self._given = kept["scalars"].tolist()
        self.step = int(step)
        self.relist()
        self._contact.lost = lost
        self._rows = kept["rows"].tolist()

    def history(self) -> History:
        """The body at rest, all records, and the end, to which the forces go on as between the last records."""
        # forces of a record are those of the impulse since the one before, its energies the means of both
        rows = np.array(self._rows)
        rest = np.zeros(rows.shape[1])
        rest[5 + ENERGIES.index("kinetic")] = self._given
        mean = np.concatenate([rest[None], (rows[1:] + rows[:-1]) / 2, rows[-1:]])
        forces = np.diff(rows[:, 2:4], axis=0) / np.diff(rows[:, 1:2], axis=0)
        forces = np.concatenate([np.zeros((1, 2)), forces])
        ahead = (mean[-1, 0] - mean[-2, 0]) / (mean[-2, 0] - mean[-3, 0]) if len(mean) > 2 else 0.0
        top, bottom = np.concatenate([forces, forces[-1:] + ahead * (forces[-1:] - forces[-2:-1])]).T
        return History(mean[:, 0], top, bottom, mean[:, 4], dict(zip(self.energies, mean[:, 5:].T, strict=True)))

    def shares(self) -> dict[str, float]:
        """Each energy at the last record over the work of the upper plate; the rest is `unbalanced`."""
        return self._shares(self._rows[-1])

    def _shares(self, row: list[float]) -> dict[str, float]:
        work = row[4] or 1.0
        shares = {name: value / work for name, value in zip(self.energies, row[5:], strict=True)}
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
