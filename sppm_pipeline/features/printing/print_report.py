"""Report on a stack of layers, in millimeters: numbers, events, curves over the height, and rules."""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import ConfigError


class Measure(NamedTuple):
    """A number of the report that a rule may refuse."""

    number: str  # its name in `PrintReport.numbers`
    unit: str  # empty for a ratio or count
    text: str  # its name in the message of a refused print
    sign: str = ">"  # ">" or "<", on which side of a threshold it is refused


MEASURES: Mapping[str, Measure] = {
    "trap": Measure("trap_mm3", "mm3", "void in resin traps"),
    "cup": Measure("largest_cup_mm2", "mm2", "largest section of a suction cup"),
    "island": Measure("largest_island_mm2", "mm2", "largest section of an island"),
    "floating": Measure("floating_mm3", "mm3", "solid that never joins the part"),
    "overhang": Measure("largest_overhang_mm2", "mm2", "largest overhang of a layer"),
    "undrained": Measure("undrained_mm3", "mm3", "void that does not drain through throats of `drain`"),
    "way": Measure("way_out_mm", "mm", "longest way out of void that drains through throats of `drain`"),
    "thin": Measure("thin_solid_share", "", "share of the solid that is thinner than `min_feature`"),
    "clogged": Measure("clogged_mm3", "mm3", "void that later layers cure shut"),
    "adhesion": Measure("adhesion", "", "first layer over the largest one", "<"),
    "margin": Measure("foot_margin_mm", "mm", "distance of the center of mass from the edge of the foot", "<"),
}
"""Names that `fail:` accepts."""

_RULE = re.compile(r"\s*([a-z_]+)\s*(?:([<>])\s*(-?[0-9.]+(?:e-?[0-9]+)?)\s*([a-z0-9]*)\s*)?")


class Rule(NamedTuple):
    """A measure and the threshold beyond which a print is refused."""

    measure: Measure
    threshold: float

    def broken_by(self, numbers: Mapping[str, Any]) -> str | None:
        """Violation of this rule in words; None if there is none, or if the number is not known."""
        value = numbers.get(self.measure.number)
        if value is None or not (value > self.threshold if self.measure.sign == ">" else value < self.threshold):
            return None
        unit = f" {self.measure.unit}" if self.measure.unit else ""
        word = "more" if self.measure.sign == ">" else "less"
        limit = f", {word} than {self.threshold:g}" if self.threshold else ""
        return f"{self.measure.text}: {value:.4g}{unit}{limit}"


def parse_rule(text: str, measures: Mapping[str, Measure] = MEASURES) -> Rule:
    """Read ``trap`` or ``cup > 100 mm2``; `measures` are what it may name. ConfigError if it is no such rule."""
    match = _RULE.fullmatch(text)
    name = match[1] if match else ""
    if match is None or name not in measures:
        example = next(
            f"{name} {m.sign} {'100' if m.unit else '0.1'} {m.unit}".rstrip() for name, m in measures.items()
        )
        raise ConfigError(
            f"{text!r} in `fail` is no rule", hint=f"write for example {example!r}; known: {', '.join(measures)}"
        )
    measure = measures[name]
    if match[2] is None:
        if measure.sign == "<":
            raise ConfigError(f"{text!r} in `fail` needs a threshold", hint=f"write for example '{name} < 1'")
        return Rule(measure, 0.0)
    if match[2] != measure.sign or match[4] not in ("", measure.unit):
        form = f"{name} {measure.sign} NUMBER {measure.unit}".rstrip()
        raise ConfigError(f"{text!r} in `fail` can't be compared", hint=f"the rule is written '{form}'")
    try:
        return Rule(measure, float(match[3]))
    except ValueError as error:
        raise ConfigError(f"{match[3]!r} in {text!r} of `fail` is not a number") from error


@dataclass(frozen=True, eq=False)
class PrintReport:
    """Results of a check of a stack of layers.

    `numbers` are the measures that the terminal, the run record and `fail` know; None where there is nothing to
    measure. `events` are ``traps``, ``cups`` and ``islands``, the largest first, with layers, volume, largest section
    and place; and ``throats``, by diameter.
    """

    numbers: Mapping[str, Any]
    events: Mapping[str, Sequence[Mapping[str, Any]]]
    layers: Mapping[str, NDArray[Any]]  # a column (n,) for each curve
    settings: Mapping[str, Any]  # pitch, limits and assumptions

    @property
    def verdict(self) -> str:
        """One sentence."""
        n = self.numbers
        said = [trapped(n) if n["traps"] else "no resin trap"]
        if n["cups"] or n["traps"]:
            other = "other " if n["traps"] else ""
            large, small = n["cups_above_30_mm2"], n["cups_below_3_mm2"]
            sizes = f" ({large:,} above 30 mm2, {small:,} below 3 mm2, {_count(n['cups_open_at_top'], 'through hole')})"
            said.append(
                f"{_count(n['cups'], f'{other}suction cup')}, sections up to {n['largest_cup_mm2']:.4g} mm2"
                f"{sizes if n['cups'] else ''}"
            )
        else:
            said.append("no suction cup")
        said.append(
            f"{_count(n['islands'], 'island')} up to {n['largest_island_mm2']:.3g} mm2" if n["islands"] else "no island"
        )
        if n["floating_parts"]:
            said.append(f"{_count(n['floating_parts'], 'part')} afloat ({n['floating_mm3']:.4g} mm3)")
        if n.get("resin_g") is not None:
            price = "" if n["price"] is None else f", price {n['price']:.2f}"
            hours = "" if n["print_time_s"] is None else f", {n['print_time_s'] / 3600:.1f} h"
            said.append(f"{n['resin_ml']:.3g} ml of resin, {n['resin_g']:.3g} g{price}{hours}")
        return "; ".join(said)

    def json(self) -> str:
        """The report without the curves, as JSON."""
        document = {"verdict": self.verdict, "numbers": self.numbers, **self.events, "settings": self.settings}
        return json.dumps(_plain(document), indent=1, allow_nan=False) + "\n"

    def csv(self) -> str:
        """The curves, a row for each layer."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self.layers)
        columns = [[_short(value) for value in column.tolist()] for column in self.layers.values()]
        writer.writerows(zip(*columns, strict=True))
        return text.getvalue()


def _short(value: float) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _plain(value: Any) -> Any:
    """Numbers to six digits, as nothing here is known better."""
    if isinstance(value, float):
        return float(f"{value:.6g}")
    if isinstance(value, Mapping):
        return {key: _plain(inner) for key, inner in value.items()}
    return [_plain(inner) for inner in value] if isinstance(value, (list, tuple)) else value


def trapped(numbers: Mapping[str, Any]) -> str:
    """Summary of the traps in words."""
    traps, largest = numbers["traps"], numbers["largest_trap_mm3"]
    most = f" (the largest {largest:.4g})" if traps > 1 else ""
    return f"{_count(traps, 'resin trap')} of {numbers['trap_mm3']:.4g} mm3{most}"


def _count(n: int, what: str) -> str:
    return f"{n:,} {what}{'' if n == 1 else 's'}"


def rounded(values: NDArray[np.floating[Any]]) -> list[float]:
    """Coordinates as they are written: to a tenth of a micrometer."""
    return [round(float(value), 4) for value in values]
