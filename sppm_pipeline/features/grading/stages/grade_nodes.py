"""``grade.nodes``: a parameter given by a result of finite elements."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from sppm_pipeline import ConfigError, Context, InputError, Length, SurfaceMesh, option, options
from sppm_pipeline.errors import did_you_mean
from sppm_pipeline.features.grading.grader import DataGrader
from sppm_pipeline.features.grading.laws import (
    CORNERS,
    NodesLaw,
    as_tetrahedra,
    at_nodes,
    smoothed,
    tetrahedra_of,
    volumes,
)
from sppm_pipeline.nouns.length import UNITS_IN_MM
from sppm_pipeline.services.arrays import F64, I64
from sppm_pipeline.services.formats.element_file import check_elements, read_elements

_AXES = ("x", "y", "z")
COMPONENTS = {
    3: _AXES,
    6: ("xx", "yy", "zz", "xy", "yz", "xz"),  # the order of VTK's symmetric tensors
    9: tuple(a + b for a in _AXES for b in _AXES),
}
"""Names of the components of an array by their number."""


@dataclass(frozen=True, kw_only=True)
class GradeNodes(DataGrader):
    """Let a parameter follow a result of finite elements: an array of a VTU, VTK, INP or MSH file, read by meshio.

    Elements are tetrahedra, hexahedra, wedges and pyramids; only their corners are looked at, and in between values are
    linear in tetrahedra that fill the elements. Values of elements become those of nodes as means weighted by volume.
    The six components of a tensor are xx, yy, zz, xy, yz, xz.
    """

    name: ClassVar[str] = "grade.nodes"
    libraries: ClassVar[tuple[str, ...]] = ("meshio",)

    path: Path = options.read_path(note="a result of finite elements: .vtu, .vtk, .inp or .msh")
    array: str | None = option(None, help="name of the array; needed if the file holds several")
    component: str | None = option(
        None, help="of an array of vectors or tensors: magnitude, mises, or a component such as x or xx"
    )
    unit: str = options.unit("mm", note="of the nodes")
    smooth: Length | None = option(
        None, help="standard deviation of a Gaussian that the values are smoothed by", unit="mm", above=0, maximum=1e6
    )

    def check_options(self) -> None:
        super().check_options()
        check_elements(self.path)

    def data(self, context: Context, part: SurfaceMesh | None) -> NodesLaw:
        """Read the file, and make values at nodes of what it holds."""
        read = read_elements(self.path, "write the result again, perhaps as VTU")
        points = np.asarray(read.points, np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
            raise InputError(f"{self.path.name}: the nodes are no finite points in space")
        points = points * UNITS_IN_MM[self.unit]
        solids = [(i, block) for i, block in enumerate(read.cells) if block.type in CORNERS]
        if not solids:
            kinds = ", ".join(sorted({block.type for block in read.cells}))[:200] or "none"
            raise InputError(f"{self.path.name} holds no solid elements", hint=f"its elements are: {kinds}")
        blocks = [(block.type, np.asarray(block.data, np.int64)) for _, block in solids]
        if any(nodes.min(initial=0) < 0 or nodes.max(initial=0) >= len(points) for _, nodes in blocks):
            raise InputError(f"{self.path.name}: an element names a node that does not exist")
        tetrahedra = as_tetrahedra(blocks)
        volume = volumes(points[tetrahedra])
        values, of_cells = self._array(read, [i for i, _ in solids])
        if len(values) != (sum(len(nodes) for _, nodes in blocks) if of_cells else len(points)):
            raise InputError(
                f"{self.path.name}: the array has {len(values)} values, one for each node or element needed"
            )
        if of_cells:
            values = np.repeat(values, tetrahedra_of(blocks))
            good = self.finite(values, "values of elements") & (volume > 0)
            values = at_nodes(tetrahedra[good], volume[good], values[good], len(points))
        return self._law(points, tetrahedra[volume > 0], volume[volume > 0], values, of_cells)

    def _law(self, points: F64, tetrahedra: I64, volume: F64, values: F64, gaps: bool) -> NodesLaw:
        """The law of values at nodes; nodes of no solid element are left out."""
        if not len(tetrahedra):
            raise InputError(f"{self.path.name}: all elements are flat")
        used, numbered = np.unique(tetrahedra, return_inverse=True)
        points, values, tetrahedra = points[used], values[used], numbered.reshape(-1, 4)
        good = np.isfinite(values) if gaps else self.finite(values, "values of nodes")
        if not good.all():
            from scipy.spatial import cKDTree

            values = values.copy()
            values[~good] = values[good][cKDTree(points[good]).query(points[~good])[1]]
        if self.smooth is not None:
            weights = np.bincount(tetrahedra.ravel(), np.repeat(volume / 4, 4), len(points)).astype(np.float64)
            try:
                values = smoothed(points, weights, values, self.smooth.mm())
            except ValueError as error:
                raise ConfigError(f"`smooth: {self.smooth}`: {error}", hint="smooth less, or a coarser mesh") from None
        return NodesLaw(self.of, self.unit_of_values, self.outside, points, self.factor * values, tetrahedra=tetrahedra)

    def _array(self, read: Any, places: list[int]) -> tuple[F64, bool]:
        """One number for each node, or for each element in blocks of these places; and which of both."""
        names = [*read.point_data, *(name for name in read.cell_data if name not in read.point_data)]
        if self.array is None and len(names) != 1:
            hint = (
                f"name one by `array`; there are {', '.join(names)[:200]}" if names else "export a field with the mesh"
            )
            raise InputError(f"{self.path.name} holds {len(names)} arrays", hint=hint)
        name = names[0] if self.array is None else self.array
        if name not in names:
            hint = (did_you_mean(name, names) or "the file holds no arrays at all")[:300]
            raise InputError(f"{self.path.name} has no array {name[:60]!r}", hint=hint)
        of_cells = name not in read.point_data
        parts = [read.cell_data[name][i] for i in places] if of_cells else [read.point_data[name]]
        try:
            array = np.concatenate([np.asarray(values, np.float64).reshape(len(values), -1) for values in parts])
        except (TypeError, ValueError) as error:
            raise InputError(f"{self.path.name}: the array {name[:60]!r} holds no numbers of one shape") from error
        return self._component(array, name), of_cells

    def _component(self, array: F64, name: str) -> F64:
        count = array.shape[1]
        if count == 1 and self.component is None:
            return array[:, 0]
        words = COMPONENTS.get(count, ())
        allowed = [*words, *({3: ["magnitude"], 6: ["mises"], 9: ["mises"]}.get(count, []))]
        if self.component not in allowed:
            listed = ", ".join(allowed) if allowed else "none, as it holds numbers" if count == 1 else "not known"
            raise ConfigError(
                f"`component` is {self.component!r:.60}, and the array {name[:60]!r} has {count} component(s)",
                hint=f"its components are {listed}",
            )
        if self.component in words:
            return array[:, words.index(self.component)]
        if self.component == "magnitude":
            length: F64 = np.linalg.norm(array, axis=1)
            return length
        xx, yy, zz, xy, yz, xz = (array[:, k] for k in (range(6) if count == 6 else (0, 4, 8, 1, 5, 2)))
        # von Mises: three halves of the square of the deviator
        squares = ((xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2) / 2
        mises: F64 = np.sqrt(squares + 3 * (xy**2 + yz**2 + xz**2))
        return mises
