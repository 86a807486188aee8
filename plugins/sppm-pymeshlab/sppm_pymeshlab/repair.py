"""``mesh.repair``: a broken mesh becomes one that bounds a solid, step by step, each followed by an inside test."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

from sppm_pipeline import ConfigError, Context, InputError, Length, SppmError, Stage, SurfaceMesh, option, options
from sppm_pipeline.errors import NativeCrash, ResourceError

if TYPE_CHECKING:
    from sppm_pymeshlab.inside_test import InsideTest

STEPS = ("clean", "merge", "split", "orient", "close", "unite", "wrap")
"""The steps, in the order in which ``auto`` tries them."""

FEW = 30
"""Fewer sample points inside than this measure changes coarsely."""


@dataclass(frozen=True, kw_only=True)
class RepairMesh(Stage):
    """Repair a mesh until it bounds a solid, and report what each step has changed.

    ``clean`` removes duplicate and degenerate triangles and unused vertices, ``merge`` joins vertices that are close,
    ``split`` cuts where three or more triangles meet in an edge, ``orient`` winds neighbors alike and outwards,
    ``close`` fills holes, ``unite`` resolves self-intersections exactly (the union of the mesh with itself), ``wrap``
    shrinks a new surface around whatever there is (alpha wrap, Portaneri et al. 2022). With ``auto`` only the steps
    that something calls for are tried, and a step is undone if it changes what is inside: sample points are asked by
    their generalized winding number before and after. A mesh without defects comes back as it was. MeshLab runs in a
    child process.
    """

    name: ClassVar[str] = "mesh.repair"

    steps: str | tuple[str, ...] = option(
        "auto", help="auto, or the steps to take in this order, none of them undone", choices=("auto", *STEPS)
    )
    last_resort: str = option(
        "refuse",
        help="what `auto` does with a mesh that no other step closes: refuse it, or wrap it with a warning",
        choices=("refuse", "wrap"),
    )
    must_close: bool = option(True, help="fail if the result does not bound a solid")
    largest_hole: int = option(1000, help="edges around the largest hole that is closed", minimum=3)
    merge_distance: Length | None = option(
        None, help="vertices closer than this are joined; 1e-5 of the box's diagonal if omitted", unit="mm", above=0
    )
    wrap_gap: Length | None = option(
        None, help="gaps narrower than this are bridged by `wrap`; 2 % of the diagonal if omitted", unit="mm", above=0
    )
    wrap_offset: Length | None = option(
        None, help="distance of the wrap from the mesh; 0.1 % of the diagonal if omitted", unit="mm", above=0
    )
    maximum_change: float = option(
        0.05,
        help="`auto` undoes a step after which more sample points change sides, as a fraction of those inside",
        above=0,
        below=1,
        formerly="tolerance",
    )
    samples: int = option(1000, help="sample points in the bounding box", minimum=100, maximum=1_000_000)
    time_limit: float = options.time_limit(600.0, note="there is one for each step")

    def check_options(self) -> None:
        if isinstance(self.steps, tuple) and (not self.steps or "auto" in self.steps):
            raise ConfigError(
                "`steps` needs a list of steps, or the lone word auto",
                hint=f"the steps are {', '.join(STEPS)}",
            )

    def run(self, context: Context, mesh: SurfaceMesh) -> SurfaceMesh:
        """Repair the mesh, report each step."""
        if not len(mesh.faces):
            raise InputError(f"{mesh.name} has no triangles")
        work = _Repair(self, context, mesh)
        if self.steps == "auto":
            work.automatically()
        else:
            for step in (self.steps,) if isinstance(self.steps, str) else self.steps:
                work.take(step)
        return work.finished()


@dataclass
class _Repair:
    """One mesh on its way."""

    options: RepairMesh
    context: Context
    start: SurfaceMesh
    log: list[dict[str, Any]] = field(default_factory=list)
    intersecting: int | None = None

    def __post_init__(self) -> None:
        from sppm_pipeline.numerics import mesh_edges as edge_counts

        self.mesh = self.start
        self.consistent = edge_counts(self.start.faces).consistent
        self._inside_test: InsideTest | None = None

    @property
    def inside_test(self) -> InsideTest:
        """The inside test, made when first needed, as it takes longer than most steps."""
        from sppm_pymeshlab.inside_test import InsideTest

        if self._inside_test is None:
            self._inside_test = InsideTest(self.start, self.options.samples, self.context.threads)
            inside = int(self._inside_test.inside.sum())
            if inside < FEW:
                self.context.warn(
                    f"only {inside} of {self.options.samples} sample points lie inside {self.start.name}, so steps "
                    "are measured coarsely; give more `samples` if the part is slender"
                )
        return self._inside_test

    def automatically(self) -> None:
        """Take the steps that are called for; those that spoil something are undone."""
        for number, step in enumerate(STEPS):
            if self._called_for(step):
                self.context.progress(number, len(STEPS), step)
                try:
                    self.take(step, undoing=True)
                except (NativeCrash, ResourceError) as error:
                    self._note(step, self.mesh, None, f"{type(error).__name__}: {error.message}")
                    self.context.warn(f"the step {step!r} was left out: {error.message}")

    def _called_for(self, step: str) -> bool:
        from sppm_pipeline.numerics import mesh_measures as measure_surface
        from sppm_pipeline.numerics import mesh_volume as volume

        faces = self.mesh.faces
        measures = measure_surface(self.mesh.vertices, faces)
        edges = measures.edges
        if step == "clean":
            return measures.degenerate > 0 or not edges.bounds_solid
        if step == "merge":
            return edges.boundary > 0
        if step == "split":
            return edges.non_manifold > 0 and not edges.bounds_solid
        if step == "orient":
            return edges.unbalanced > edges.boundary or volume(self.mesh.vertices, faces) < 0
        if step == "close":
            return edges.boundary > 0
        if step == "unite":
            return edges.bounds_solid and self._intersections() > 0
        return not edges.bounds_solid and self.options.last_resort == "wrap"

    def _intersections(self) -> int:
        from sppm_pymeshlab.meshlab import self_intersections

        if self.intersecting is None:
            self.intersecting = self_intersections(self.mesh, self.options.time_limit)
        return self.intersecting

    def take(self, step: str, *, undoing: bool = False) -> None:
        """Take one step; with `undoing` keep it only if it has kept the solid."""
        from sppm_pymeshlab.meshlab import Refused

        try:
            made = self._made(step)
        except Refused as error:
            if not undoing:
                raise
            self._note(step, self.mesh, None, error.message)
            return
        changed = self.inside_test.changed(made)
        wrapping, turning = step == "wrap", step == "orient" and not self.consistent
        spoilt = self._spoilt(step, made)
        if not spoilt and changed > self.options.maximum_change and not (wrapping or turning):
            spoilt = f"{changed:.1%} of the sample points would change sides"
        if spoilt and undoing:
            self._note(step, made, changed, spoilt)
            return
        if spoilt:
            self.context.warn(f"after the step {step!r}: {spoilt}")
        self._note(step, made, changed, None)
        self.inside_test.accept(made, as_new_truth=turning)
        self.mesh = made
        self.intersecting = None

    def _spoilt(self, step: str, made: SurfaceMesh) -> str | None:
        """Defects that a step has increased though it was to reduce them."""
        from sppm_pipeline.numerics import mesh_edges as edge_counts

        was, now = edge_counts(self.mesh.faces), edge_counts(made.faces)
        if step in ("clean", "merge", "close") and now.boundary > was.boundary:
            return f"there would be {now.boundary} open edges instead of {was.boundary}"
        if step in ("merge", "split") and now.non_manifold > was.non_manifold:
            return f"{now.non_manifold} edges would have three or more triangles instead of {was.non_manifold}"
        if step in ("orient", "unite", "wrap") and now.unbalanced > was.unbalanced:
            return f"the winding would not match at {now.unbalanced} edges instead of {was.unbalanced}"
        return None

    def _made(self, step: str) -> SurfaceMesh:
        import numpy as np

        from sppm_pymeshlab.meshlab import filtered
        from sppm_pymeshlab.outward import turned_outward

        options = self.options
        diagonal = float(np.linalg.norm(self.start.upper - self.start.lower))

        def length(given: Length | None, share: float) -> float:
            return given.mm() if given is not None else share * diagonal

        given: dict[str, Any] = {}
        if step == "merge":
            given = {"distance": length(options.merge_distance, 1e-5)}
        elif step == "close":
            given = {"edges": options.largest_hole}
        elif step == "wrap":
            given = {"gap": length(options.wrap_gap, 0.02), "offset": length(options.wrap_offset, 0.001)}
        # what the other steps have made of a hopeless mesh would only be wrapped as well
        source = self.start if step == "wrap" and options.steps == "auto" else self.mesh
        if step == "orient" and self.consistent:
            made = source
        else:
            made = filtered(source, step, options.time_limit, **given)
        if step == "orient":
            turned = turned_outward(made.vertices, made.faces, as_whole=self.consistent, threads=self.context.threads)
            made = SurfaceMesh(made.vertices, turned, made.name)
        return made

    def _note(self, step: str, made: SurfaceMesh, changed: float | None, undone: str | None) -> None:
        from sppm_pipeline.numerics import mesh_edges as edge_counts
        from sppm_pipeline.numerics import mesh_volume as volume

        entry: dict[str, Any] = {"step": step, "kept": undone is None}
        if undone is not None:
            entry["undone"] = undone
        for key, mesh in (("before", self.mesh), ("after", made)):
            edges = edge_counts(mesh.faces)
            entry |= {
                f"triangles_{key}": len(mesh.faces),
                f"open_edges_{key}": edges.boundary,
                f"non_manifold_edges_{key}": edges.non_manifold,
                f"unmatched_edges_{key}": edges.unbalanced,
                f"volume_{key}_mm3": volume(mesh.vertices, mesh.faces),
            }
        if changed is not None:
            entry["changed_share"] = changed
        self.log.append(entry)

    def finished(self) -> SurfaceMesh:
        """The mesh, if it is acceptable; the report of all steps in any case."""
        from sppm_pipeline.numerics import mesh_edges as edge_counts
        from sppm_pipeline.numerics import mesh_volume as volume

        edges = edge_counts(self.mesh.faces)
        before = volume(self.start.vertices, self.start.faces)
        after = volume(self.mesh.vertices, self.mesh.faces)
        self.context.report(
            steps=self.log,
            closed=edges.closed,
            bounds_solid=edges.bounds_solid,
            volume_before_mm3=before,
            volume_after_mm3=after,
            triangles_before=len(self.start.faces),
        )
        if edges.bounds_solid and after > 0:
            try:
                self.context.report(self_intersecting_triangles=self._intersections())
            except SppmError as error:
                self.context.warn(f"self-intersections could not be counted: {error.message}")
        if self.mesh is not self.start:
            self.context.report(changed_share=self.inside_test.changed(self.mesh))
        if self.options.must_close and not (edges.bounds_solid and after > 0):
            taken = ", ".join(f"{entry['step']}{'' if entry['kept'] else ' (undone)'}" for entry in self.log) or "none"
            raise InputError(
                f"{self.start.name} can't be repaired: {edges.boundary} open edges, {edges.non_manifold} edges of "
                f"three or more triangles and {edges.unbalanced} edges where the winding does not match are left "
                f"after these steps: {taken}",
                hint="`last_resort: wrap` makes a new surface around it, `must_close: false` hands it on as it is; "
                "a modeller knows better what was meant",
            )
        wrapped = [entry for entry in self.log if entry["step"] == "wrap" and entry["kept"]]
        if wrapped:
            self.context.warn(
                f"{self.start.name} was wrapped: the result is a new surface around it, a little outside of it, with "
                f"{after:.4g} mm^3; the old one was too broken to tell what was meant. Look at it before you use it"
            )
        elif self.mesh is not self.start and not edges.bounds_solid:
            self.context.warn(f"{edges.boundary} open edges are left")
        left = self.intersecting
        if left:
            self.context.warn(f"{left} triangles pass through others")
        return self.mesh
