"""Options of stages that crush blocks: the load, the solid and the way in which it fails."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, ClassVar

from sppm_pipeline import ConfigError, Stage, option, options
from sppm_pipeline.numerics import per_phase

if TYPE_CHECKING:
    from sppm_crushing.numerics.material import Material


def least_strain(default: float, *, note: str, minimum: float) -> Any:
    """The declaration of an option that all these stages have."""
    return option(default, help=f"strain that must be reached; {note}", minimum=minimum, maximum=0.8)


Table = tuple[tuple[float, float], ...]
"""Pairs of plastic strain and yield stress."""


@dataclass(frozen=True, kw_only=True)
class CrusherOptions(Stage):
    """Base of `Crusher`: how a block is crushed, and of which material."""

    advice: ClassVar[str] = "lower `resolution`, or raise `rate`"

    resolution: int = options.resolution(24, note="of fields; images keep theirs", maximum=256)
    axis: str = options.axis("z")
    strain: float = option(0.6, help="strain at the end", minimum=0.01, maximum=0.8)
    least_strain: float = least_strain(
        0.2, note="a run that fails earlier is an error, later a warning and a curve that ends there", minimum=0.01,
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
        "solid if empty", minimum=0, maximum=1e15,
    )  # fmt: skip
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
        from sppm_crushing.numerics.material import Material

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
        """Refuse voxels so large that one stores more energy than a crack takes; a `cell` has a resolution."""
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
