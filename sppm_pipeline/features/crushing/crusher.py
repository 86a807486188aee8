"""Base of stages that crush blocks: material, load, march, and result."""

from __future__ import annotations

import hashlib
import math
import time
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import ConfigError, Context, DesignError, ScalarField, Size, Stage, Voxels, option, options
from sppm_pipeline.features.crushing.compression import CrushedBody
from sppm_pipeline.features.crushing.crush_report import Table, change_between, is_quiet, numbers_of, warnings_of
from sppm_pipeline.features.crushing.voxel_block import (
    PERMUTED,
    Frame,
    binary_image,
    frame_of,
    loose_pieces,
    turned_corner,
)
from sppm_pipeline.numerics import per_phase

if TYPE_CHECKING:
    from sppm_pipeline.features.crushing.numerics.body import Body
    from sppm_pipeline.features.crushing.numerics.march import Failed, History, March
    from sppm_pipeline.features.crushing.numerics.material import Material

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
class Crusher(Stage):
    """Base of stages that crush blocks: how, of which material, and what comes of it."""

    advice: ClassVar[str] = "lower `resolution`, or raise `rate`"

    resolution: int = options.resolution(24, note="of fields; images keep theirs", maximum=256)
    axis: str = options.axis("z")
    strain: float = option(0.6, help="strain at the end", minimum=0.01, maximum=0.8)
    least_strain: float = options.least_strain(
        0.2, note="a run that fails earlier is an error, later a warning and a curve that ends there",
        minimum=0.01,
    )  # fmt: skip
    rate: float | str | None = option(
        None, help="speed of the plate over that of waves in a bar of the solid; auto halves it until nothing changes; "
        "if omitted 0.01, halved as well below a density of 0.2 or if the balance of energy is not quiet",
        minimum=1e-4, maximum=0.05, choices=("auto",),
    )  # fmt: skip
    plates: str = option(
        "slip", help="whether the block slides on the plates, sticks to them, or is held by friction",
        choices=("slip", "stick", "friction"),
    )  # fmt: skip
    friction: float = option(
        0.2, help="coefficient of friction where the block touches itself, and of the plates", minimum=0, maximum=2
    )
    sides: str = option("free", help="whether the sides may bulge or are held by rollers", choices=("free", "confined"))
    young: float | tuple[float, ...] = options.young(1.0, note="or of each phase from 1 on")
    poisson: float | tuple[float, ...] = options.poisson(0.35, note="or of each phase from 1 on")
    yield_stress: float | Table | tuple[Table, ...] = option(
        (),
        help="yield stress, or its table [[plastic strain, true stress], ...], or a table for each phase; an elastic "
        "solid if empty",
        minimum=0,
        maximum=1e15,
    )
    failure: str = option(
        "none",
        help="how the solid fails: j2, its yield stress falls beyond the last plastic strain of its table; rankine, it "
        "cracks where the largest principal stress reaches `tensile_strength`; or both",
        choices=("none", "j2", "rankine", "both"),
    )
    fracture_energy: float | tuple[float, ...] | None = option(
        None, help=f"work to failure per area of a crack, {options.EACH_PHASE}; in `stress_unit` times mm, which is "
        "kJ/m2 for MPa, or times cell sizes where the cell has no size in mm", above=0, maximum=1e15,
    )  # fmt: skip
    tensile_strength: float | tuple[float, ...] | None = option(
        None, help=f"stress at which the solid cracks, {options.EACH_PHASE}; the first yield stress if omitted",
        above=0, maximum=1e15,
    )  # fmt: skip
    rubble: str = option(
        "drop", help="whether nodes of failed voxels leave, or stay as points of mass that contact pushes",
        choices=("drop", "keep"),
    )  # fmt: skip
    stress_unit: str = options.stress_unit("relative")
    solid_density: float | None = option(None, help="density of the solid", unit="g/cm3", above=0, maximum=100)
    frames: tuple[float, ...] = option(
        (0.0, 0.15, 0.3, 0.45, 0.6), help="strains at which the deformed block is kept", minimum=0, maximum=0.8
    )

    def check_options(self) -> None:
        """As many materials as phases, tables that rise from 0, stress that is not beyond the modulus."""
        young, poisson, tables = self._young(), self._poisson(), self._tables()
        if not young or len(poisson) != len(young) or len(tables) != len(young):
            raise ConfigError(
                f"`young` has {len(young)} values, `poisson` {len(poisson)}, and `yield_stress` {len(tables)} tables",
                hint="give one of each, or one for every phase",
            )
        for modulus, table in zip(young, tables, strict=True):
            strains, stresses = [row[0] for row in table], [row[1] for row in table]
            if table and (strains[0] != 0 or any(b <= a for a, b in pairwise(strains))):
                raise ConfigError(f"the plastic strains of `yield_stress` are {strains}; they start at 0 and rise")
            if any(not 0 < stress <= modulus / 2 for stress in stresses):
                raise ConfigError(
                    f"`yield_stress` has {stresses} beside a Young's modulus of {modulus:g}",
                    hint="give both in the same unit; yield stresses lie above 0 and below half of the modulus",
                )
        self._check_failure(young, tables)

    def _check_failure(self, young: tuple[float, ...], tables: tuple[Table, ...]) -> None:
        """What failure needs, and nothing that only failure uses without it."""
        if self.failure == "none":
            for name in ("fracture_energy", "tensile_strength"):
                if getattr(self, name) is not None:
                    raise ConfigError(
                        f"`{name}` is of no use with `failure: none`", hint="write `failure: j2`, `rankine` or `both`"
                    )
            return
        if self.fracture_energy is None:
            raise ConfigError(f"`failure: {self.failure}` needs a `fracture_energy`")
        for name in ("fracture_energy", "tensile_strength"):
            if len(per_phase(getattr(self, name))) not in (0, 1, len(young)):
                raise ConfigError(
                    f"`{name}` has {len(per_phase(getattr(self, name)))} values, and `young` {len(young)}",
                    hint="give one, or one for every phase",
                )
        if self.failure == "j2" and self.tensile_strength is not None:
            raise ConfigError("`tensile_strength` is of no use with `failure: j2`", hint="write `failure: both`")
        if self.failure != "rankine":
            if not any(tables):
                raise ConfigError(
                    f"`failure: {self.failure}` needs a `yield_stress`", hint="an elastic solid fails by `rankine`"
                )
            for table in tables:
                if any(b[1] < a[1] for a, b in pairwise(table)):
                    raise ConfigError(
                        f"`yield_stress` falls: {[row[1] for row in table]}",
                        hint="leave out what falls: the solid softens by its `fracture_energy`",
                    )
        strengths = self._strengths()
        if self.failure != "j2" and any(not 0 < f <= e / 2 for f, e in zip(strengths, young, strict=True)):
            raise ConfigError(
                f"`tensile_strength` is {strengths} (of a solid that does not yield it must be given) beside Young's "
                f"moduli {young}",
                hint="give both in the same unit; it lies above 0 and below half of the modulus",
            )

    def _young(self) -> tuple[float, ...]:
        return self.young if isinstance(self.young, tuple) else (self.young,)

    def _poisson(self) -> tuple[float, ...]:
        given = self.poisson if isinstance(self.poisson, tuple) else (self.poisson,)
        return given * len(self._young()) if len(given) == 1 else given

    def _tables(self) -> tuple[Table, ...]:
        """A table for each phase."""
        given: Any = self.yield_stress
        if isinstance(given, float):
            given = ((0.0, given),)
        flat = not given or isinstance(given[0][0:1] and given[0][0], float)
        tables: tuple[Table, ...] = (given,) if flat else given
        return tables * len(self._young()) if len(tables) == 1 else tables

    def _strengths(self) -> tuple[float, ...]:
        """Tensile strength of each phase."""
        given = per_phase(self.tensile_strength)
        if given:
            return given * len(self._young()) if len(given) == 1 else given
        return tuple(table[0][1] if table else math.inf for table in self._tables())

    def _materials(self, edge: float) -> tuple[Material, ...]:
        """Material of each phase in voxels with this edge, mm or cell sizes."""
        from sppm_pipeline.features.crushing.numerics.material import Material

        made = tuple(map(Material, self._young(), self._poisson(), self._tables()))
        if self.failure == "none":
            return made
        energies = per_phase(self.fracture_energy)
        energies = energies * len(made) if len(energies) == 1 else energies
        softens, cracks = self.failure != "rankine", self.failure != "j2"
        return tuple(
            one._replace(fracture=energy / edge, strength=strength if cracks else math.inf, softens=softens)
            for one, energy, strength in zip(made, energies, self._strengths(), strict=True)
        )

    def _check_snap_back(self, edge: float, cell: float | None, unit: str) -> None:
        """Refuse voxels so large that the energy which one stores is more than a crack through it takes.

        `edge` is that of a voxel, `cell` that of a cell, if a resolution can be named; both in `unit`.
        """
        if self.failure == "none":
            return
        largest = min(edge * m.fracture / m.least_fracture for m in self._materials(edge) if m.least_fracture > 0)
        if edge > largest:
            fine = "" if cell is None else f"`resolution: {math.ceil(cell / largest)}`, "
            raise ConfigError(
                f"voxels of {edge:.4g} {unit} store more energy than `fracture_energy: {self.fracture_energy}` takes "
                f"up: their stress would snap back; the largest that are allowed have {largest:.4g} {unit}",
                hint=f"write {fine}or a larger `fracture_energy`" if fine else "give a finer image, or a larger energy",
            )

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
        from sppm_pipeline.features.crushing.numerics.body import body_of
        from sppm_pipeline.features.crushing.numerics.failing_march import FailingMarch
        from sppm_pipeline.features.crushing.numerics.march import Load, March

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
        from sppm_pipeline.features.crushing.numerics.march import Failed

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
            strain=history.strain,
            stress=0.5 * unit * (history.top + history.bottom),
            unit=self.stress_unit,
            origin="simulated",
            area=nx * ny * size**2 if size else None,
            height=nz * size if size else None,
            density=self.solid_density * solid if self.solid_density else None,
            energies={"external": history.work * per_volume, **energies},
            plates=unit * np.stack([history.bottom, history.top], axis=1),
            numbers=numbers,
            ended=ended,
            grid=image.shape[::-1],
            spacing=spacing,
            physical=physical,
            axis=self.axis,
            voxels=(body.voxels + lift)[:, back],
            phases=body.phases + 1,
            elements=body.corners[:, columns],
            frame_strains=np.array([frame.strain for frame in kept]),
            frame_nodes=np.stack([((frame.nodes + lift) * spacing)[:, back] for frame in kept]),
            frame_alpha=np.stack([frame.alpha for frame in kept]),
            frame_released=np.zeros((0, 0), bool)
            if self.failure == "none"
            else np.stack([frame.released for frame in kept]),
        )
