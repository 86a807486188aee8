"""Base of stages that crush blocks: material, load, march, and result."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_crushing.compression import CrushedBody
from sppm_crushing.crusher_options import CrusherOptions
from sppm_pipeline import Context, DesignError, ScalarField, Size, Voxels

if TYPE_CHECKING:
    from sppm_crushing.crusher_options import Table
    from sppm_crushing.numerics.body import Body
    from sppm_crushing.numerics.march import Failed, History, March
    from sppm_crushing.numerics.material import Material

SHARES = {
    "kinetic": (0.05, "is in motion: the plates are too fast; lower `rate`"),
    "hourglass": (0.10, "bends voxels rather than walls: raise `resolution`, walls want 4 voxels or more"),
    "contact": (0.05, "is stored in overlapping surfaces: raise `resolution`, or lower `rate`"),
    "damping": (0.10, "went into damping, which is numerical: lower `rate`"),
    "unbalanced": (0.02, "is missing from the balance: lower `rate`, and don't trust this run"),
}
"""Fractions of the work of the plates above which a run triggers a warning: heuristics. Each is an error of about as
much in the stress, so that a factor of two is one in the accuracy that passes without a word."""

ADDED_MASS, PLATES = 0.30, 0.05
"""Fraction of mass that may be added to crushed voxels, which slows waves by half as much, and by which the forces of
both plates may differ, twice the error of their mean: heuristics for errors as above."""


PLATEAU = (0.2, 0.4)
"""Strains between which the plateau stress is taken."""


def mean_stress(strain: NDArray[np.float64], stress: NDArray[np.float64], low: float, high: float) -> float:
    """Mean of the stress between two strains, of as many records as there are."""
    return float(stress[(strain >= low - 1e-9) & (strain <= high + 1e-9)].mean())


def numbers_of(history: History, march: March, area: float, rate: float, young: float) -> dict[str, Any]:
    """Summary numbers of a run, with its balance of energy."""
    end = float(history.strain[-1])
    stress = 0.5 * young / area * (history.top + history.bottom)
    later = history.strain >= min(0.05, end / 2)
    nx, ny, nz = march.body.shape
    difference = np.sqrt(np.mean((history.top - history.bottom)[later] ** 2))
    return {
        "plateau": mean_stress(history.strain, stress, *PLATEAU) if end >= PLATEAU[1] - 1e-9 else None,
        "work": float(history.work[-1] * young / (area * nz)),
        "relative_density": len(march.body.corners) / (nx * ny * nz),
        "rate": rate,
        **{name: round(float(share), 6) for name, share in march.shares().items()},
        "plates_differ": round(float(difference / max(np.abs(history.top[later]).mean(), 1e-300)), 6),
        "added_mass": round(march.added_mass, 6),
        **({"released": round(float(march.released.mean()), 6), "fragments": march.fragments()} if march.fails else {}),
    }


def is_quiet(numbers: Mapping[str, Any]) -> bool:
    """True if the balance of energy gives no reason for a lower rate."""
    shares = {name: SHARES[name][0] for name in ("kinetic", "damping", "unbalanced")} | {"plates_differ": PLATES}
    return all(abs(numbers[name]) <= most for name, most in shares.items())


def warnings_of(numbers: Mapping[str, Any], tables: tuple[Table, ...]) -> list[str]:
    """Warnings for a run whose numbers are doubtful."""
    if numbers["work"] <= 0:
        return ["the plates met no resistance"]
    found = [
        f"{abs(numbers[name]):.1%} of the work {what}" for name, (most, what) in SHARES.items()
        if abs(numbers[name]) > most
    ]  # fmt: skip
    if numbers["plates_differ"] > PLATES:
        found.append(f"the forces of both plates differ by {numbers['plates_differ']:.1%}: lower `rate`")
    if numbers["added_mass"] > ADDED_MASS:
        found.append(f"crushed voxels were given {numbers['added_mass']:.0%} more mass: lower `rate`, or end earlier")
    if any(b[1] < a[1] for table in tables for a, b in pairwise(table)):
        found.append("the solid softens: strain gathers in single voxels, so that the result depends on `resolution`")
    return found


def change_between(one: CrushedBody, other: CrushedBody, fails: bool) -> float:
    """Largest relative difference of plateau stress (of a short run, of its second half), highest stress, and work.

    If the solid fails, that of the highest stress alone: which piece breaks next depends on everything.
    """
    end = float(min(one.strain[-1], other.strain[-1]))
    found: list[tuple[float, ...]] = []
    for body in (one, other):
        highest = float(body.stress[body.strain <= PLATEAU[0]].max())
        if fails:
            found.append((highest,))
            continue
        level = mean_stress(body.strain, body.stress, min(PLATEAU[0], end / 2), min(PLATEAU[1], end))
        found.append((level, highest, float(np.interp(end, body.strain, body.energies["external"]))))
    return max((abs(after / before - 1) for before, after in zip(*found, strict=True) if before), default=0.0)


PERMUTED = {"x": (2, 0, 1), "y": (1, 2, 0), "z": (0, 1, 2)}
"""Axes of an image z, y, x in the order that turns the axis of compression into the first."""


class Frame(NamedTuple):
    """Strain, positions of the nodes, plastic strain of the elements and which of them have failed."""

    strain: float
    nodes: NDArray[np.float32]
    alpha: NDArray[np.float32]
    released: NDArray[np.bool_]


def frame_of(march: March) -> Frame:
    """The march as it is now."""
    return Frame(march.strain, march.x.astype(np.float32), march.plastic_strain.astype(np.float32), march.released)


def turned_corner(column: int, axis: int) -> int:
    """The corner of a turned voxel that is at the upper end along x, y, z where bits 0, 1, 2 of `column` are set."""
    low = [1 - (column >> c & 1) for c in range(3)]
    x, y, z = low if axis == 2 else (low[1], low[2], low[0]) if axis == 0 else (low[2], low[0], low[1])
    return x + 2 * y + 4 * z


def binary_image(field: ScalarField, resolution: int, threads: int) -> NDArray[np.uint8]:
    """Whole voxels of a field, (nz, ny, nx), cut at the level at which they have the density of a finer grid."""
    values = field.sample(resolution, threads).T
    density = float(field.solid(2 * resolution, threads).mean(dtype=np.float64))
    count = round(density * values.size)
    if not count:
        return np.zeros(values.shape, np.uint8)
    # voxels of one value go together, so that symmetry stays
    most = np.partition(values.reshape(-1), count - 1)[count - 1]
    with_them, without = values <= most, values < most
    fewer = count - np.count_nonzero(without) < np.count_nonzero(with_them) - count
    return np.asarray(without if fewer and without.any() else with_them).view(np.uint8)


def loose_pieces(image: NDArray[np.uint8]) -> list[str]:
    """Warnings for solid that carries nothing."""
    from sppm_pipeline.numerics import find_components

    found = find_components((image > 0).view(np.uint8), (False,) * 3, 6)
    spanning = found.faces[:, 4] & found.faces[:, 5]
    if not spanning.any():
        return ["no load path between the plates: the force is zero until pieces meet"]
    loose = float(found.sizes[~spanning].sum() / found.sizes.sum())
    return [f"{loose:.2g} of the solid is not connected to the load path between the plates"] if loose else []


AUTO = (0.02, 0.01, 0.005, 0.0025, 0.00125)
"""Rates that `auto` tries."""

MAX_CHANGE = 0.02
"""Change of plateau stress, highest stress before it, and work by the last halving of the rate that ends `auto`; if the
solid fails, of the highest stress alone."""

USUAL, MIN_DENSITY = 0.01, 0.2
"""Rate that is tried first, and the only one if the solid fills as much as this and the balance of energy is quiet.
Slender struts have no time to bow at this rate: a bowed column of 4 x 4 x 48 voxels bears 1.6 times what it does at an
eighth of it, and is 12 times as long as wide. Struts of a cubic lattice of this density, with 3 r^2 - 2 r^3 = 0.2 for
r the width over the spacing of nodes, are 3.5 times as long as wide from node to node."""

STRIDE, PAUSE = 0.02, 20.0
"""Strains between states from which an interrupted run can go on, and seconds between those that are written:
heuristics. A factor of two changes how much an interruption costs, not the result."""


@dataclass(frozen=True, kw_only=True)
class Crusher(CrusherOptions):
    """Base of stages that crush blocks: what comes of it."""

    def crushing(self, source: Size) -> Size:
        """Elements times steps; voxels too large for the way in which the solid fails are refused."""
        if source.geometry and not source.voxels:
            cell = source.geometry.edge_mm or 1.0
            unit = "mm" if source.geometry.edge_mm else "cell sizes"
            self._check_snap_back(cell / self.resolution, cell, unit)
        grid = Size(voxels=source.voxels) if source.voxels else source.grid(self.resolution)
        voxels = source.voxels or grid.samples
        solid = 1 - (source.geometry.porosity if source.geometry else 0.5)
        box = source.geometry.box if source.geometry and not source.voxels else (1.0, 1.0, 1.0)
        layers = (voxels / np.prod(box)) ** (1 / 3) * box["xyz".index(self.axis)]
        tried = self._rates()[: 1 if self.rate is None and solid >= MIN_DENSITY else 2]
        rate = sum(1 / r for r in tried)
        nu = self._poisson()[0]
        # the slow start takes as long as 0.09 more strain; pressure waves cross this part of a voxel in a step: COURANT
        # and STABLE of the march, which are not worth compiling for
        courant = min(0.6, (0.8 * (1 - nu) / (1 + nu)) ** 0.5)
        steps = (self.strain + 0.09) * layers * rate * ((1 - nu) / (1 + nu) / (1 - 2 * nu)) ** 0.5 / courant
        solid *= voxels
        return Size(
            samples=grid.samples, sums=grid.sums, voxels=solid * steps, nodes=solid * (3 + len(self.frames)),
            resident=solid,
        )  # fmt: skip

    def crush(self, context: Context, source: ScalarField | Voxels) -> CrushedBody:
        """Crush, at lower and lower rates until that changes nothing unless the rate is given."""
        image, spacing, physical = self._image(context, source)
        cell = None if isinstance(source, Voxels) else spacing * self.resolution
        self._check_snap_back(spacing, cell, "mm" if physical else "cell sizes")
        rates = self._rates()
        if len(rates) == 1:
            return self._crushed(context, image, spacing, physical, rates[0])
        made: CrushedBody | None = None
        change = math.nan
        for rate in rates:
            last = made
            try:
                made = self._crushed(context, image, spacing, physical, rate)
            except DesignError:  # it failed early: perhaps not at a lower rate
                if rate == rates[-1]:
                    raise
                made = None
                continue
            # the rate of all but slender structures: one run is enough
            usual = self.rate is None and rate == USUAL and made.numbers["relative_density"] >= MIN_DENSITY
            change = change_between(last, made, self.failure != "none") if last is not None else math.nan
            if change < MAX_CHANGE or (usual and is_quiet(made.numbers)):
                return made
        assert made is not None
        known = "are known from one alone" if math.isnan(change) else f"still change by {change:.2g}"
        context.warn(f"stress and work {known} where the rate is {rates[-1]:g}")
        return made

    def _rates(self) -> tuple[float, ...]:
        """Rates that are tried, from fast to slow."""
        if isinstance(self.rate, (int, float)):
            return (self.rate,)
        return AUTO if self.rate == "auto" else AUTO[AUTO.index(USUAL) :]

    def _image(self, context: Context, source: ScalarField | Voxels) -> tuple[NDArray[np.uint8], float, bool]:
        """Phases (nz, ny, nx), edge of a voxel, and whether that is in mm."""
        if isinstance(source, Voxels):
            edges = source.spacing
            if max(edges) > (1 + 1e-4) * min(edges):
                raise DesignError(
                    f"the voxels measure {' x '.join(f'{e:g}' for e in edges)}; only cubes can be crushed",
                    hint="resample the image to cubes",
                )
            image = (source.solid() if source.fractions else source.values).astype(np.uint8)
            image, spacing, physical = image.T, edges[0], source.physical
        else:
            if coarse := source.coarseness(1 / self.resolution):
                context.warn(coarse)
            image = binary_image(source, self.resolution, context.threads)
            spacing, physical = (source.edge_mm or 1.0) / self.resolution, source.edge_mm is not None
        if (phases := int(image.max())) > len(self._young()):
            raise DesignError(
                f"the image has phases up to {phases}, and materials are given for {len(self._young())}",
                hint="give `young`, `poisson` and `yield_stress` a value for every phase from 1 on",
            )
        if not phases:
            raise DesignError("the block is empty: there is nothing to crush", hint="lower the porosity")
        return image, spacing, physical

    def _crushed(
        self, context: Context, image: NDArray[np.uint8], spacing: float, physical: bool, rate: float
    ) -> CrushedBody:
        """Crush at one rate."""
        from sppm_crushing.numerics.body import body_of
        from sppm_crushing.numerics.failing_march import FailingMarch
        from sppm_crushing.numerics.march import Load, March

        # the march compresses along the first axis
        turned = np.ascontiguousarray(image.transpose(PERMUTED[self.axis]))
        used = np.flatnonzero(turned.any((1, 2)))
        first, last = int(used[0]), int(used[-1]) + 1
        if first > 0 or last < len(turned):
            context.warn(
                f"the block touches no plate at an end: it begins {first} voxels above the lower and ends "
                f"{len(turned) - last} below the upper one; plates and height are taken where the solid is"
            )
        warnings = loose_pieces(turned[first:last])
        body = body_of(turned[first:last], confined=self.sides == "confined")
        plates = {"slip": 0.0, "stick": -1.0, "friction": self.friction}[self.plates]
        load = Load(self.strain, rate, plates, self.sides == "confined", self.friction, self.rubble == "keep")
        materials = self._materials(spacing)
        make = March if self.failure == "none" else FailingMarch
        march = make(body, materials, load, context.threads)
        kept, failed = self._marched(context, march, materials)
        context.report(steps=march.step, elements=len(body.corners))
        if failed is not None:
            context.warn(f"the simulation stopped: {failed}; its curve ends there")
        history = march.history()
        area = float(body.shape[0] * body.shape[1])
        numbers = numbers_of(history, march, area, rate, self._young()[0])
        warnings += warnings_of(numbers, self._tables())
        for warning in warnings:
            context.warn(warning)
        return self._result(body, history, kept, numbers, image, spacing, physical, first, failed.why if failed else "")

    def _marched(
        self, context: Context, march: March, materials: tuple[Material, ...]
    ) -> tuple[list[Frame], Failed | None]:
        """The frames of a march that goes on where an interrupted run has left it, and why it ended early."""
        from sppm_crushing.numerics.march import Failed

        frames = {f for f in self.frames if f < self.strain} | {0.0, self.strain}
        # states are kept at strains that depend on no option, so that neither frames nor the strain at the end change
        # the march, whose contacts are searched again at each; a run that was interrupted may end where it was
        strides = {round(step * STRIDE, 9) for step in range(1, int(self.strain / STRIDE) + 1)} - {self.strain}
        # a state belongs to all that changes the march or its frames, but for the strain at its end
        described = repr((materials, march.load._replace(strain=0.0), self.frames, march.body.shape))
        content = described.encode() + march.body.voxels.tobytes() + march.body.phases.tobytes()
        key = hashlib.sha256(content).hexdigest()
        found: list[Frame] = []
        state = context.recall(key)
        if state is not None and state["strain"] <= self.strain:
            march.resume(state["march"])
            found = [Frame(*frame) for frame in state["frames"]]
        state, last = None, frame_of(march)
        saved = time.monotonic()

        def report_progress(strain: float) -> None:
            context.progress(march.step, march.steps, f"strain {strain:.3f}")

        try:
            for stop in sorted(frames | strides):
                if march.step and stop <= march.strain + 1e-6:
                    continue
                march.to(stop, report_progress)
                last = frame_of(march)
                if stop in frames:
                    found.append(last)
                if stop in strides:
                    state = {"strain": stop, "march": march.kept(), "frames": [tuple(frame) for frame in found]}
                    if time.monotonic() > saved + PAUSE:
                        context.remember(key, state)
                        state, saved = None, time.monotonic()
        except KeyboardInterrupt:
            if state is not None:
                context.remember(key, state)
            raise
        except Failed as error:
            # a curve too short to be of use is an error; a longer one is kept up to where its energies add up
            if error.strain < min(self.least_strain, self.strain):
                raise DesignError(
                    f"the simulation stopped: {error}, after {march.step} of {march.steps} steps",
                    hint="lower `rate`, raise `resolution`, or keep what there is by a smaller `least_strain`",
                ) from None
            # the last state that there is, as far as it can be trusted
            found = [frame for frame in (*found, last) if frame.strain <= error.strain]
            context.remember(key, None)
            return found[:-1] if len(found) > 1 and found[-1].strain == found[-2].strain else found, error
        finally:
            march.close()
        context.remember(key, None)
        return found, None

    def _result(
        self, body: Body, history: History, kept: list[Frame], numbers: dict[str, Any], image: NDArray[np.uint8],
        spacing: float, physical: bool, first: int, ended: str,
    ) -> CrushedBody:  # fmt: skip
        nx, ny, nz = body.shape
        # forces are in Young's moduli of the first phase and squared voxel edges
        unit = self._young()[0] / (nx * ny)
        per_volume = unit / nz
        energies = {name: values * per_volume for name, values in history.energies.items()}
        axis = "xyz".index(self.axis)
        # places and positions of the turned block back to x, y, z
        back = [(2, 0, 1), (1, 2, 0), (0, 1, 2)][axis]
        lift = np.array([0, 0, first])
        columns = [turned_corner(c, axis) for c in range(8)]
        size = spacing if physical else None
        solid = np.count_nonzero(image) / image[0].size / len(image)
        return CrushedBody(
            strain=history.strain, stress=0.5 * unit * (history.top + history.bottom), unit=self.stress_unit,
            origin="simulated", area=nx * ny * size**2 if size else None, height=nz * size if size else None,
            density=self.solid_density * solid if self.solid_density else None,
            energies={"external": history.work * per_volume, **energies},
            plates=unit * np.stack([history.bottom, history.top], axis=1), numbers=numbers, ended=ended,
            grid=image.shape[::-1], spacing=spacing, physical=physical, axis=self.axis,
            voxels=(body.voxels + lift)[:, back], phases=body.phases + 1, elements=body.corners[:, columns],
            frame_strains=np.array([frame.strain for frame in kept]),
            frame_nodes=np.stack([((frame.nodes + lift) * spacing)[:, back] for frame in kept]),
            frame_alpha=np.stack([frame.alpha for frame in kept]), frame_released=np.zeros((0, 0), bool)
            if self.failure == "none"
            else np.stack([frame.released for frame in kept]),
        )  # fmt: skip
