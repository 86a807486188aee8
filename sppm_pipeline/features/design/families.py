"""Families of structures of the atlas: recipes with parameters, and configurations that make and measure one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

PORES = 40
"""Pores of the cells that the atlas measures; in a cell of n pores, lengths are (n / 40)^(-1/3) times as long."""

RESOLUTION = 40
"""Voxels along an edge of these cells: 12 from pore to pore."""

SIZES = 1.8
"""Times as many for sizes, so that walls are some voxels thick."""

DARTS = "{stage: sample.dart_throwing, total: TOTAL, spacing: 0.05}"
EVEN = "{stage: sample.hyperuniform, total: TOTAL}"
JOINED = "{stage: connect.mbdst, degree: [3, 5], mode: greedy}"
KERNELS = "{stage: field.gaussian, pore_radius: PORE, tunnel_radius: TUNNEL}"
WALLS = "{stage: field.walls, tunnel_radius: HOLE, struts: STRUTS}"


class Family(NamedTuple):
    """A recipe, and the parameters that the atlas varies, besides the porosity.

    Attributes
    ----------
    stages : tuple of str
        YAML; words in capitals stand for values.
    ranges : mapping of name to (low, high)
        Lengths are in mean distances of pores, ``total ** (-1 / 3)`` cell sizes.
    """

    stages: tuple[str, ...]
    ranges: Mapping[str, tuple[float, float]]


POROSITY = "porosity"

_TUNNELS = {POROSITY: (0.45, 0.88), "tunnel": (0.06, 0.3)}

FAMILIES: Mapping[str, Family] = {
    "paper": Family((DARTS, JOINED, KERNELS), _TUNNELS),
    "even": Family((EVEN, JOINED, KERNELS), _TUNNELS),
    "walls": Family((EVEN, JOINED, WALLS), {POROSITY: (0.5, 0.9), "hole": (0.1, 0.4), "struts": (0.0, 0.8)}),
    "thrown_walls": Family((DARTS, JOINED, WALLS), {POROSITY: (0.5, 0.88), "hole": (0.1, 0.4), "struts": (0.0, 0.6)}),
    "sheet": Family((EVEN, "{stage: field.sheet, balance: BALANCE}"), {POROSITY: (0.5, 0.75), "balance": (0.35, 0.5)}),
}

PORE = 0.44
"""Radius of the paper's pores, in mean distances of pores: that of 95 pores of omega 30 at level 0.25 in a cell of edge
2. Tuning the porosity changes it, and the tunnels with it."""


def recipe_of(family: str, values: Mapping[str, float], total: int = PORES) -> list[str]:
    """The recipe of a design, a line of YAML each stage."""
    length = total ** (-1 / 3)
    words = {"TOTAL": str(total), "PORE": f"{PORE * length:.6g}"}
    for name, value in values.items():
        scaled = value * length if name in ("tunnel", "hole") else value
        words[name.upper()] = f"{scaled:.6g}"
    lines = list(FAMILIES[family].stages)
    for word, text in words.items():
        lines = [line.replace(word, text) for line in lines]
    return lines


def configuration(name: str, family: str, values: Mapping[str, float], total: int = PORES, cell: str = "") -> str:
    """A configuration that makes one cell of a design and measures what the atlas holds."""
    stages = "\n".join(f"    - {line}" for line in recipe_of(family, values, total))
    more = f", edge: {cell}" if cell else ""
    if more:
        stages = stages.replace("TOTAL", str(total)).replace(f"total: {total}", f"total: {total}{more}", 1)
    n, source = round(RESOLUTION * (total / PORES) ** (1 / 3)), "from: tune.porosity"
    return f"""sppm: 1
name: {name}
recipes:
  cell:
{stages}
pipeline:
  - {{stage: tune.porosity, recipe: cell, target: {values[POROSITY]:.4g}}}
  - {{stage: homogenize.voxel, resolution: {n}, {source}}}
  - {{stage: homogenize.conductivity, resolution: {n}, {source}}}
  - {{stage: homogenize.permeability, resolution: {n}, {source}}}
  - {{stage: check.sizes, resolution: {round(SIZES * n)}, {source}}}
"""
