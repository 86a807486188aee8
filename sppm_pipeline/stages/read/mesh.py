"""``read.mesh``: the part to fill, from a mesh file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.data.estimate import Estimate, Given
from sppm_pipeline.data.length import UNITS_IN_MM, Length
from sppm_pipeline.data.mesh import SurfaceMesh
from sppm_pipeline.errors import ConfigError, InputError
from sppm_pipeline.stage import Context, Stage, option

LARGEST_FILE = 2 * 2**30
"""Bytes; larger files are refused before they are read."""

PROBED = 64
"""Samples along the longest side when it is found out how open a mesh is."""

PROBED_FILE = 2**26
"""Bytes of the largest file that is read to foretell a run."""

MOST_OPEN = 0.3
"""Share of rays that do not leave a mesh as often as they enter it; above, what is inside is guesswork."""


@dataclass(frozen=True, kw_only=True)
class ReadMesh(Stage):
    """Read an STL, OBJ, PLY or OFF file, turn, scale and place it, and judge whether it encloses a volume.

    First the mesh is turned, then scaled, then placed.
    """

    name: ClassVar[str] = "read.mesh"

    path: Path = option(help="file to read: .stl, .obj, .ply or .off")
    unit: str = option("mm", help="unit of the coordinates in the file", choices=tuple(UNITS_IN_MM))
    turn: tuple[float, float, float] = option(
        (0.0, 0.0, 0.0), help="angles about x, then y, then z", unit="degrees", minimum=-360, maximum=360
    )
    scale: float | None = option(None, help="factor of all lengths", minimum=1e-9, maximum=1e9)
    height: Length | None = option(
        None, help="scale the part to this size along z", unit="mm", minimum=1e-3, maximum=1e5
    )
    place: str = option(
        "keep",
        help="where the part goes: as in the file, low corner at the origin, or standing centred on the origin",
        choices=("keep", "corner", "center"),
    )
    accept: str = option(
        "closed",
        help="closed: refuse a mesh with holes or faces wound against each other; any: fill what a vote of rays along "
        "x, y and z calls inside, with a warning",
        choices=("closed", "any"),
    )

    def check_options(self) -> None:
        if self.scale is not None and self.height is not None:
            raise ConfigError("`scale` and `height` exclude each other")

    def estimate(self, given: Given) -> Estimate:
        """From the file itself, which is read: nothing else tells the size of the part."""
        from sppm_pipeline.formats.detect import decode_mesh
        from sppm_pipeline.numerics.surface.measures import surface_area, volume

        if self.path.stat().st_size > PROBED_FILE:
            return Estimate(memory=4 * self.path.stat().st_size, seconds=self.path.stat().st_size * 2e-8)
        vertices, faces = decode_mesh(self.path.read_bytes(), self.path.name)
        vertices = vertices * UNITS_IN_MM[self.unit] @ _rotation(self.turn).T
        used = vertices[np.unique(faces)]
        extent = used.max(0) - used.min(0)
        factor = float(self.height.mm() / extent[2]) if self.height is not None else self.scale or 1.0
        return Estimate(
            makes={
                "triangles": len(faces),
                "size_mm": tuple(float(v) for v in extent * factor),
                "volume_mm3": abs(volume(vertices, faces)) * factor**3,
                "area_mm2": surface_area(vertices, faces) * factor**2,
            },
            keeps=24 * len(vertices) + 12 * len(faces),
            memory=200 * len(faces),
            seconds=4e-7 * len(faces),
            advice="simplify the mesh",
        )

    def run(self, context: Context) -> SurfaceMesh:
        """Read the file."""
        from sppm_pipeline.formats.detect import decode_mesh
        from sppm_pipeline.numerics.surface.measures import edge_counts, volume

        try:
            size = self.path.stat().st_size
            if size > LARGEST_FILE:
                raise InputError(f"{self.path} has {size} bytes; the limit is {LARGEST_FILE}")
            data = self.path.read_bytes()
        except OSError as error:
            raise InputError(
                f"cannot read {self.path}: {error.strerror or error}", hint="check the path and the permissions"
            ) from error
        vertices, faces = decode_mesh(data, self.path.name)
        vertices = vertices * UNITS_IN_MM[self.unit] @ _rotation(self.turn).T
        used = vertices[np.unique(faces)]
        lower, upper = used.min(0), used.max(0)
        extent = upper - lower
        if not (extent > 0).all():
            raise InputError(f"{self.path.name} is flat: its size is {extent[0]:g} x {extent[1]:g} x {extent[2]:g} mm")
        factor = self.height.mm() / extent[2] if self.height is not None else self.scale or 1.0
        offset = {
            "keep": np.zeros(3),
            "corner": -lower * factor,
            "center": -np.array([(lower[0] + upper[0]) / 2, (lower[1] + upper[1]) / 2, lower[2]]) * factor,
        }[self.place]
        vertices = vertices * factor + offset
        counts, enclosed = edge_counts(faces), volume(vertices, faces)
        context.report(closed=counts.closed, boundary_edges=counts.boundary)
        if counts.consistent and enclosed < 0:
            context.warn("the mesh was wound inside out; its faces have been turned")
            faces = faces[:, ::-1]
        if not counts.bounds_solid:
            message = (
                f"{self.path.name} does not bound a volume: {counts.boundary} open edges, {counts.non_manifold} edges "
                f"of three or more triangles, {counts.unbalanced} edges where the winding does not match"
            )
            if self.accept == "closed":
                raise InputError(
                    message, hint="repair the mesh, or give `accept: any` to let rays along x, y and z vote"
                )
            share = _open_share(vertices, faces)
            context.report(open_rays_share=share)
            if share > MOST_OPEN:
                raise InputError(
                    f"{message}; {share:.0%} of the rays through it do not leave it as often as they enter, "
                    f"so that nobody can tell inside from outside (accepted are up to {MOST_OPEN:.0%})",
                    hint="repair the mesh: close its holes and wind its faces consistently",
                )
            context.warn(f"{message}; {share:.1%} of the rays through it do not close, a vote decides what is inside")
        return SurfaceMesh(vertices, faces.astype(np.int32), name=self.path.name)


def _open_share(vertices: NDArray[np.float64], faces: NDArray[np.integer]) -> float:
    """Share of rays along x, y and z that do not leave the mesh as often as they enter it."""
    from sppm_pipeline.numerics.domain.inside import inside_layers, prepare_inside
    from sppm_pipeline.numerics.grid import Grid

    used = vertices[np.unique(faces)]
    lower, upper = used.min(0), used.max(0)
    h = float((upper - lower).max()) / PROBED
    nx, ny, nz = (max(1, round(float(v))) for v in (upper - lower) / h)
    x, y, z = ((lower + upper - (np.array([nx, ny, nz]) - 1) * h) / 2).tolist()
    probe = inside_layers(prepare_inside(vertices, faces, Grid((x, y, z), (h,) * 3, (nx, ny, nz)), False), 0, nz)
    return probe.open_rays / max(1, probe.crossed_rays)


def _rotation(degrees: tuple[float, float, float]) -> NDArray[np.float64]:
    """Turn about x, then y, then z; quarter turns are exact."""
    total = np.eye(3)
    for axis, angle in enumerate(degrees):
        quarter = angle % 360
        exact = {0.0: (1.0, 0.0), 90.0: (0.0, 1.0), 180.0: (-1.0, 0.0), 270.0: (0.0, -1.0)}
        c, s = exact.get(quarter, (float(np.cos(np.radians(angle))), float(np.sin(np.radians(angle)))))
        turn = np.eye(3)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        turn[i, i], turn[i, j], turn[j, i], turn[j, j] = c, -s, s, c
        total = turn @ total
    return total
