"""Base class of stages that say how a parameter varies through a part: one method makes its law."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass

from sppm_pipeline.data.grading import QUANTITIES, RESERVED, Grading, Law
from sppm_pipeline.data.length import UNITS_IN_MM
from sppm_pipeline.data.mesh import SurfaceMesh
from sppm_pipeline.errors import ConfigError
from sppm_pipeline.stage import Context, Stage, option


@dataclass(frozen=True, kw_only=True)
class Grader(Stage):
    """Common base of the family ``grade``: implement `law`; `run` adds it to the maps made before."""

    of: str = option(
        help="name of the map; other stages look for porosity, scale, spacing, pore_radius, tunnel_radius, stretch, "
        "direction_x, direction_y, direction_z and weight, any other name is data for formulas"
    )
    measure: str | None = option(
        None,
        help="unit of the values; millimeters for spacing and radii, else none if omitted. Lengths of these are "
        "converted to millimeters",
    )

    def check_options(self) -> None:
        if not (self.of.isidentifier() and self.of.isascii()) or len(self.of) > 40:
            raise ConfigError(f"`of: {self.of[:50]}` is no name", hint="use letters, digits and _, at most 40")
        if self.of in RESERVED:
            raise ConfigError(f"`of: {self.of}` has a meaning in formulas already", hint="give another name")
        known = QUANTITIES.get(self.of)
        if known is not None and self.measure is not None:
            allowed = tuple(UNITS_IN_MM) if known.unit == "mm" else ("",)
            if self.measure not in allowed:
                words = "no unit" if known.unit != "mm" else "one of " + ", ".join(allowed)
                raise ConfigError(f"`measure: {self.measure[:40]}`: {self.of} has {words}", hint=known.meaning)

    @property
    def unit_of_values(self) -> str:
        """The unit that the map's values have."""
        known = QUANTITIES.get(self.of)
        return known.unit if known is not None else (self.measure or "")[:40]

    @property
    def factor(self) -> float:
        """What the values that were given are multiplied by, so that lengths are millimeters."""
        known = QUANTITIES.get(self.of)
        return UNITS_IN_MM[self.measure] if known is not None and known.unit and self.measure else 1.0

    @abstractmethod
    def law(self, context: Context, before: Grading, part: SurfaceMesh | None) -> Law:
        """What stands behind the map.

        Parameters
        ----------
        context : Context
        before : Grading
            The maps made before; a formula may use them.
        part : SurfaceMesh or None
        """

    def run(self, context: Context, grading: Grading | None, part: SurfaceMesh | None) -> Grading:
        """Add the map to those made before."""
        before = Grading() if grading is None else grading
        return before.added(self.law(context, before, part))
