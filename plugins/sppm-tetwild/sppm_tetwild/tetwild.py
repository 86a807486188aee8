"""``mesh.tetwild``: a solid filled with tetrahedra."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from sppm_tetrahedra import VolumeMesh

from sppm_pipeline import Context, DesignError, InputError, Length, Stage, SurfaceMesh, option, options

FLAT = 1e-6
"""A mesh thinner than this share of its diagonal counts as flat."""

MAX_ENVELOPE = 0.1
"""Share of the volume that the envelope may make up without a warning."""

HINT = "repair the mesh, decimate it, or give a larger `epsilon`; `time_limit` gives more time"


@dataclass(frozen=True, kw_only=True)
class TetWild(Stage):
    """Fill a closed surface with tetrahedra (fTetWild: Hu, Schneider, Wang, Zorin and Panozzo 2020).

    Surfaces that cross themselves are taken. The new boundary keeps within the distance `epsilon` of the old one; the
    smaller `epsilon`, the longer it takes. fTetWild draws random numbers from the system; they are replaced with those
    of the run, so that the same seed gives the same mesh. Where that is not possible (anywhere but on Linux), the stage
    says so and reports `reproducible: false`. fTetWild runs in a child process, on one thread.
    """

    name: ClassVar[str] = "mesh.tetwild"

    epsilon: Length = option(
        Length(1e-3),
        help="how far the boundary may lie from the surface; with a unit a length, else a fraction",
        unit="diagonals of the box",
        above=0,
    )
    ideal_edge_length: Length = option(
        Length(0.05),
        help="target length of edges inside; with a unit a length, else a fraction",
        unit="diagonals of the box",
        above=0,
        formerly="edge",
    )
    optimize: bool = option(
        True, help="improve the tetrahedra; without it they are useless for simulation, and only good for a first look"
    )
    rounds: int = options.rounds(80, note="of improvement, at most", maximum=1000, formerly="iterations")
    stop_energy: float = option(
        10.0, help="stop when no tetrahedron is worse (conformal AMIPS energy; 3 is a regular one)", above=3
    )
    coarsen: bool = option(False, help="as few tetrahedra as the quality allows")
    cell: Length | None = options.cell(
        None,
        note="of a periodic cell, a cube with a corner at the origin, if the surface is one, capped",
        above=0,
        minimum=None,
        maximum=None,
    )
    time_limit: float = options.time_limit(1800.0)

    @property
    def periodic_box(self) -> bool:
        """True if the mesh has the box of a cell, which `homogenize.tet` requires."""
        return self.cell is not None

    def run(self, context: Context, mesh: SurfaceMesh) -> VolumeMesh:
        """Fill the surface, check volume and orientation, report the quality."""
        from sppm_pipeline import run_native
        from sppm_pipeline.nouns import ArraySpec

        diagonal, area, enclosed = _checked(mesh)
        epsilon, edge = (
            length.value if length.unit is None else length.mm() / diagonal
            for length in (self.epsilon, self.ideal_edge_length)
        )
        if edge > 1 or epsilon > 0.1:
            raise DesignError(
                f"`ideal_edge_length` may be as long as the diagonal of the box ({diagonal:.4g} mm) and `epsilon` a "
                "tenth of it, "
                f"got {edge * diagonal:.4g} mm and {epsilon * diagonal:.4g} mm"
            )
        box = self._box(mesh, epsilon * diagonal)
        if epsilon * diagonal * area > MAX_ENVELOPE * enclosed:
            context.warn(
                f"within `epsilon` ({epsilon * diagonal:.3g} mm) of the surface lies "
                f"{epsilon * diagonal * area / enclosed:.0%} of the volume: thin walls may close or vanish"
            )
        result = run_native(
            "sppm_tetwild.child:tetrahedra",
            {"vertices": mesh.vertices, "faces": mesh.faces},
            {
                "epsilon": epsilon,
                "edge": edge,
                "optimize": self.optimize,
                "iterations": self.rounds,
                "stop_energy": self.stop_energy,
                "coarsen": self.coarsen,
                "seed": int(context.rng().integers(2**32)),
            },
            returns={"nodes": ArraySpec("float64", (None, 3)), "cells": ArraySpec("int32", (None, 4))},
            distribution="pytetwild",
            seconds=self.time_limit,
            hint=HINT,
            progress=context.progress,
        )
        nodes, cells = _oriented(result.arrays["nodes"], result.arrays["cells"], mesh.name)
        reproducible = result.values["draws"] > 0
        context.report(reproducible=reproducible)
        if not reproducible:
            context.warn("this mesh can't be repeated: fTetWild has drawn its random numbers from the system")
        made = VolumeMesh(nodes, cells, box=box, name=mesh.name)
        self._report(context, made, enclosed, epsilon * diagonal * area)
        return made

    def _box(self, mesh: SurfaceMesh, reach: float) -> NDArray[np.float64] | None:
        """The periodic cell, if there is one."""
        if self.cell is None:
            return None
        edge = self.cell.mm()
        if mesh.lower.min() < -reach or mesh.upper.max() > edge + reach:
            raise DesignError(
                f"{mesh.name} reaches from {mesh.lower.min():.4g} to {mesh.upper.max():.4g} mm; a cell of {self.cell} "
                f"reaches from 0 to {edge:.4g} mm"
            )
        return np.array([[0.0] * 3, [edge] * 3])

    def _report(self, context: Context, made: VolumeMesh, enclosed: float, envelope: float) -> None:
        """Report volume and quality; `DesignError` if more volume is missing or added than the envelope can hold."""
        from sppm_tetwild.quality import aspect_ratios, dihedral_angles

        angles = dihedral_angles(made.nodes, made.cells)
        ratios = aspect_ratios(made.nodes, made.cells)
        change = made.volume / enclosed - 1
        context.report(
            surface_volume_mm3=enclosed,
            volume_change=change,
            smallest_dihedral_angle=float(angles.min()),
            largest_dihedral_angle=float(angles.max()),
            share_below_10_degrees=float((angles.min(1) < 10).mean()),
            mean_aspect_ratio=float(ratios.mean()),
            largest_aspect_ratio=float(ratios.max()),
        )
        if abs(change) > 0.001 + 2 * envelope / enclosed:
            raise DesignError(
                f"the tetrahedra have {made.volume:.6g} mm^3, the surface encloses {enclosed:.6g} mm^3",
                hint="surfaces that overlap count twice: mesh.repair unites them; or give a smaller `epsilon`",
            )
        if angles.min() < 1:
            context.warn(
                f"the smallest dihedral angle is {angles.min():.2g} degrees; simulations will suffer. "
                "More `rounds` or a smaller `stop_energy` may help"
            )


def _checked(mesh: SurfaceMesh) -> tuple[float, float, float]:
    """Diagonal of the box, area and volume of a surface; `InputError` if it is empty, flat, open or inside out."""
    from sppm_pipeline.numerics import mesh_area as surface_area
    from sppm_pipeline.numerics import mesh_edges as edge_counts
    from sppm_pipeline.numerics import mesh_volume as volume

    if not len(mesh.faces):
        raise InputError(f"{mesh.name} has no triangles")
    extent = mesh.upper - mesh.lower
    diagonal = float(np.linalg.norm(extent))
    if not extent.min() > FLAT * diagonal:
        raise InputError(f"{mesh.name} is flat: its size is {' x '.join(f'{side:g}' for side in extent)} mm")
    counts = edge_counts(mesh.faces)
    if not counts.bounds_solid:
        raise InputError(
            f"{mesh.name} does not bound a solid: {counts.boundary} open edges, {counts.unbalanced} edges where the "
            "winding does not match",
            hint="repair it first, for example with mesh.repair of the plugin sppm-pymeshlab",
        )
    enclosed = volume(mesh.vertices, mesh.faces)
    if not enclosed > FLAT * float(np.prod(extent)):
        raise InputError(
            f"{mesh.name} encloses {enclosed:.4g} mm^3 in a box of {float(np.prod(extent)):.4g} mm^3",
            hint="it is inside out, or two sheets lie on each other; repair it first",
        )
    return diagonal, surface_area(mesh.vertices, mesh.faces), enclosed


def _oriented(
    nodes: NDArray[np.float64], cells: NDArray[np.int32], name: str
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Nodes in use, and tetrahedra with positive volume.

    `DesignError` if nothing came back, a tetrahedron is flat, or some overlap.
    """
    from sppm_tetwild.quality import cell_volumes, non_manifold_faces

    if not len(cells):
        raise DesignError(f"no tetrahedra were made of {name}", hint="give a smaller `epsilon`")
    if cells.min() < 0 or cells.max() >= len(nodes):
        raise DesignError(f"the tetrahedra of {name} name nodes that do not exist", hint=HINT)
    used = np.unique(cells)
    renumbered = np.zeros(len(nodes), np.int32)
    renumbered[used] = np.arange(len(used), dtype=np.int32)
    nodes, cells = nodes[used], renumbered[cells]
    turned = cell_volumes(nodes, cells) < 0
    cells[turned] = cells[turned][:, [0, 2, 1, 3]]
    flat = int((cell_volumes(nodes, cells) <= 0).sum())
    non_manifold = non_manifold_faces(cells)
    if flat or non_manifold:
        raise DesignError(
            f"of {len(cells)} tetrahedra made of {name}, {flat} are flat, and {non_manifold} triangles belong to "
            "more than two",
            hint="leave `optimize` on, or repair the mesh",
        )
    return nodes, cells
