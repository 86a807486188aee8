"""``grade.points``: a parameter given at points in a CSV file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from sppm_pipeline import Context, InputError, SurfaceMesh, option, options
from sppm_pipeline.features.grading.grader import DataGrader
from sppm_pipeline.features.grading.laws import PointsLaw
from sppm_pipeline.nouns.length import UNITS_IN_MM
from sppm_pipeline.services.arrays import F64

MAX_LINEAR = 200_000
"""Maximum number of points of a Delaunay tetrahedralization, which takes about 10 s then."""


@dataclass(frozen=True, kw_only=True)
class GradePoints(DataGrader):
    """Let a parameter follow samples at points: a CSV file with a line of names, and columns x, y, z and value.

    Commas, semicolons, tabs or blanks separate the columns; what follows a # is a comment. Samples at the same place
    are averaged.
    """

    name: ClassVar[str] = "grade.points"

    path: Path = options.read_path(note="a CSV file")
    coordinates: tuple[str, str, str] = option(("x", "y", "z"), help="names of the columns of the coordinates")
    value: str = option("value", help="name of the column of the values")
    unit: str = options.unit("mm", note="of the columns x, y, z")
    interpolation: str = option(
        "linear",
        help="what is between the points: linear in Delaunay's tetrahedra, the value of the nearest point, or a mean "
        "of the eight nearest by inverse squared distances",
        choices=("linear", "nearest", "idw"),
    )

    def data(self, context: Context, part: SurfaceMesh | None) -> PointsLaw:
        """Read the file."""
        from sppm_pipeline.services.formats.csv_columns import read_columns

        table = read_columns(self.path, (*self.coordinates, self.value), gaps=self.missing == "fill")
        bad = np.flatnonzero(~np.isfinite(table[:, :3]).all(axis=1))
        if len(bad):
            raise InputError(f"{self.path.name}: row {bad[0] + 1} has coordinates that are no finite numbers")
        table = table[self.finite(table[:, 3], f"values of {self.path.name}")]
        # samples at one place would make flat tetrahedra
        points, group = np.unique(UNITS_IN_MM[self.unit] * table[:, :3], axis=0, return_inverse=True)
        counts = np.bincount(group.ravel())
        values = self.factor * np.bincount(group.ravel(), table[:, 3]) / counts
        if len(points) < len(table):
            context.warn(f"{len(table) - len(points)} samples lie at the place of another one; they are averaged")
        if self.interpolation == "linear":
            self._require_space(points)
        return PointsLaw(self.of, self.unit_of_values, self.outside, points, values, self.interpolation)

    def _require_space(self, points: F64) -> None:
        hint = "give `interpolation: nearest` or `interpolation: idw`"
        if len(points) > MAX_LINEAR:
            raise InputError(
                f"{len(points)} points are too many for `interpolation: linear`, up to {MAX_LINEAR} are", hint=hint
            )
        size = np.linalg.svd(points - points.mean(axis=0), compute_uv=False) if len(points) > 3 else np.zeros(3)
        # the smallest extent along principal axes: there are no tetrahedra in a plane
        if not size[-1] > 1e-9 * size[0]:
            raise InputError(
                f"{self.path.name}: its {len(points)} points lie in a plane, on a line or at one", hint=hint
            )
