"""``field.struts``: lattices of round struts."""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import (
    ConfigError,
    Context,
    FieldMaker,
    InputError,
    Length,
    Palette,
    ScalarField,
    Size,
    option,
    options,
)
from sppm_pipeline.nouns import FormulaField
from sppm_structures.graphs import LATTICES, StrutGraph, strut_graph
from sppm_structures.sizes import field_size, near_struts, of_struts

LARGEST_FILE = 1 << 24
MAX_STRUTS = 5000


@dataclass(frozen=True, eq=False, kw_only=True)
class StrutField(FormulaField):
    """Distance from the surface of struts, less where several are near, so that joints are round.

    Axes `starts`, `ends` (m, 3), `radius` and the length `blend`, over which joints are rounded, are in cell sizes;
    `radii` (m, 2) at both ends are over `radius`. There are `repeat` copies along an edge of the cell.
    """

    lattice: str
    starts: NDArray[np.float64]
    ends: NDArray[np.float64]
    radii: NDArray[np.float64]
    radius: float
    blend: float
    repeat: int = 1
    grown: float = 0.0
    """Length added to all radii after the shares were applied, cell sizes."""
    kept: dict[str, Any] = field(default_factory=dict, compare=False, repr=False)

    def evaluate(self, x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64]) -> NDArray[np.floating]:
        from sppm_structures.strut_kernels import evaluate_struts, strut_table

        n = self.repeat
        if "table" not in self.kept:
            graph = StrutGraph(self.starts, self.ends, self.radii[:, 0], self.radii[:, 1])
            self.kept["table"] = strut_table(graph, self.radius * n, self.blend * n)
        within = [(n * axis.reshape(-1)) % 1.0 for axis in (x, y, z)]
        values = evaluate_struts(self.kept["table"], self.blend * n, *within)
        values /= np.float32(n)
        values -= np.float32(self.grown)
        return values

    def cut_at(self, value: float) -> StrutField:
        return replace(self, grown=self.grown + value)

    def summary(self) -> dict[str, Any]:
        """The lattice and its radius."""
        radius = self.radius + self.grown
        summary: dict[str, Any] = {"lattice": self.lattice, "struts": len(self.starts), "radius": radius}
        if self.edge is not None:
            summary["radius_mm"] = radius * self.edge
        return summary


@dataclass(frozen=True, kw_only=True)
class Struts(FieldMaker):
    """Round struts along the edges of a periodic graph, joined smoothly.

    The field is the distance d from the nearest strut's surface. With a blend length b, struts that are further away by
    less than 4 b lower it, as in the smooth minimum ``-b log(sum exp(-d / b))`` (with ``(1 - t/4)^4`` for ``exp(-t)``):
    joints get fillets. ``tune.porosity`` adds the same to all radii.

    A custom graph is a JSON file ``{"nodes": [[x, y, z], ...], "edges": [[i, j], ...], "radii": [...]}`` with
    positions in cell sizes and, if wanted, a radius for each node over the option `radius`; or a CSV file with a strut
    in each row: x1, y1, z1, x2, y2, z2. Ends may lie in neighboring cells; copies are counted once.
    """

    name: ClassVar[str] = "field.struts"

    lattice: str = option("octet", help="which lattice; without effect if there is a file", choices=tuple(LATTICES))
    path: Path | None = options.read_path(None, note="a graph, .json or .csv")
    radius: Length = option(Length(0.05), help="radius of the struts", unit="cell size", above=0)
    blend: Length = option(Length(0.02), help="length over which joints are rounded", unit="cell size", minimum=0)
    repeat: int = option(1, help="periods along an edge of the cell", minimum=1, maximum=64)

    def estimate(self, palette: Palette) -> Size:
        graph = LATTICES[self.lattice]() if self.path is None else read_graph(self.path)
        return size_of_struts(self.edge_mm, graph, self.in_cells(self.radius), self.in_cells(self.blend), self.repeat)

    def run(self, context: Context) -> ScalarField:
        """Lay the graph out; the field is evaluated where it is sampled."""
        radius, blend = self.in_cells(self.radius), self.in_cells(self.blend)
        if not (radius < 0.5 and blend < 0.5):
            raise ConfigError(f"radius {radius:g} and blend {blend:g} must be less than half the cell size")
        graph = LATTICES[self.lattice]() if self.path is None else read_graph(self.path)
        return StrutField(
            lattice=self.lattice if self.path is None else self.path.name,
            starts=graph.starts,
            ends=graph.ends,
            radii=np.column_stack([graph.start_radii, graph.end_radii]),
            radius=radius,
            blend=blend,
            repeat=self.repeat,
            edge=self.edge_mm,
        )


def size_of_struts(edge_mm: float | None, graph: StrutGraph, radius: float, blend: float, repeat: int) -> Size:
    """The size of a field of struts, for a radius and a length of blending in cell sizes."""
    # in a copy of edge 1; nanoseconds of a sample as measured on nine lattices, within a factor of 1.5
    length = float(np.linalg.norm(graph.ends - graph.starts, axis=1).sum())
    near = near_struts(length, (radius + 4 * blend) * repeat)
    solid, surface = of_struts(length, radius * repeat)
    return field_size(edge_mm, solid, surface * repeat, 25 + 75 * near)


def read_graph(path: Path) -> StrutGraph:
    """Read a graph of struts from JSON or CSV; `InputError` with its place if it is none."""
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise InputError(f"{path} is larger than {LARGEST_FILE // 2**20} MiB, too large for a graph of struts")
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot read {path}: {getattr(error, 'strerror', None) or 'it is no text'}") from error
    if path.suffix.lower() == ".json":
        return _from_json(text, path.name)
    if path.suffix.lower() == ".csv":
        return _from_csv(text, path.name)
    raise InputError(f"{path.name} should end in .json or .csv")


def _from_json(text: str, name: str) -> StrutGraph:
    try:
        found = json.loads(text)
        nodes = np.array(found["nodes"], np.float64).reshape(-1, 3)
        edges = np.array(found["edges"], np.int64).reshape(-1, 2)
        radii = np.array(found.get("radii", np.ones(len(nodes))), np.float64).reshape(-1)
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError) as error:
        raise InputError(
            f"{name} is no graph of struts: {type(error).__name__}: {error}",
            hint='it should read {"nodes": [[x, y, z], ...], "edges": [[i, j], ...]}',
        ) from error
    if len(edges) > MAX_STRUTS:
        raise InputError(f"{name} has {len(edges)} struts; the limit is {MAX_STRUTS}")
    if len(edges) and not (edges.min() >= 0 and edges.max() < len(nodes)):
        bad = int(edges.max() if edges.max() >= len(nodes) else edges.min())
        raise InputError(f"{name}: an edge names node {bad}; there are nodes 0 to {len(nodes) - 1}")
    if len(radii) != len(nodes) or not (np.isfinite(radii).all() and (radii > 0).all()):
        raise InputError(f"{name}: each node has one positive radius, or none has")
    a, b = edges.T
    return strut_graph(nodes[a], nodes[b], radii[a], radii[b])


def _from_csv(text: str, name: str) -> StrutGraph:
    rows: list[list[float]] = []
    for number, row in enumerate(csv.reader(text.splitlines()), 1):
        if not row or row[0].lstrip().startswith("#"):
            continue
        try:
            values = [float(word) for word in row]
        except ValueError:
            if not rows and number == 1:
                continue  # a line of headings
            raise InputError(f"{name}:{number}: a strut is six numbers, got {','.join(row)[:60]!r}") from None
        if len(values) != 6:
            raise InputError(f"{name}:{number}: a strut is six numbers x1, y1, z1, x2, y2, z2, got {len(values)}")
        rows.append(values)
        if len(rows) > MAX_STRUTS:
            raise InputError(f"{name} has more struts than the limit of {MAX_STRUTS}")
    struts = np.array(rows, np.float64).reshape(-1, 6)
    return strut_graph(struts[:, :3], struts[:, 3:])
