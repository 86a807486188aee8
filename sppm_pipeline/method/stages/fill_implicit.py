"""``fill.implicit``: microstructure AND part, decided point by point."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from sppm_pipeline import Length, Palette, Part, ScalarField, Size, SurfaceMesh, options
from sppm_pipeline.errors import ConfigError, InputError
from sppm_pipeline.method.families.inside_test import outward_mesh
from sppm_pipeline.method.part.border import KEPT_NODES, PER_DIAMETER, Border
from sppm_pipeline.services.arrays import F64, I32, I64
from sppm_pipeline.services.formats.input_file import content_of
from sppm_pipeline.stage import Context, Headline, Stage, option

MIN_CELLS = 2
"""Cells along the longest side of a part below which a warning asks for the unit: an inch is 25 mm."""

MAX_LIST_BYTES = 2**27
"""Bytes of a list of triangles."""

WARNED_VOID = 5e-3
"""Sealed void that triggers a warning, as a fraction of the part's bounding box. The coarse grid has 2^20 voxels, so
less may be voxels that it closes by mistake; a factor of two changes only who is warned."""

NODES_IN_WORK, VALUES_IN_WORK = 6e6, 16
"""Nodes of a border that are worked on at a time, and values of 16 bits of each, for the estimate: fitted to parts of
2, 4, 7 and 16 million nodes, of which they give 4 to 13 % too much."""

THINNEST = Length(0.3, "mm")
"""Solid that resin printers make: most state 0.2 to 0.5 mm as the thinnest strut."""


@dataclass(frozen=True, kw_only=True)
class ImplicitFill(Stage):
    """Intersect the implicit fields of the microstructure and of the part (paper, "Mesh-free Slicing").

    The field is not evaluated here; layers, meshes and pictures evaluate the part where they need it. A part that is
    not closed is tested on a coarse grid: its triangles are wound outwards, and it is filled where its winding number
    is above one half, or refused if too much of it is near one half.

    A skin closes what it covers: how much void it seals, in which liquid resin or powder stays, is measured on a coarse
    grid and warned about. `check.print` measures it on the layers. `drains` open it: they win over skin and
    microstructure, where the part is, in the coordinates of the part.

    A skin may be on some faces only: on the triangles that face one of the directions `skin_toward`, on those of
    `skin_groups` of the file or listed in `skin_triangles`, and on those near the mesh at the port `skin_near`, all of
    these together. What lies in the part within the thickness of one of them is solid, so the skin ends around the edge
    of the faces in a round rim. `solid_near` names faces around which the part is solid farther in, within
    `solid_within`, whatever has the skin: the holes of screws, say.

    Cut at the surface of a part, struts end in shards. With `border: round` the solid is a union of balls, which lie
    inside of the part: what is too thin goes, struts that are a little too thin are thickened, edges get round, and
    faces stay flat. Voxels of a sixth of `thinnest` then show hardly any solid thinner than that; for this the balls
    are larger by two fifths. The field is evaluated on a grid of two sevenths of `thinnest` and interpolated, so that
    layers and meshes agree. Disconnected solid is left out as islands. An extension of the paper.

    With `border: frame` struts along the surface unite with the solid before that, so that no strut ends there alone:
    points are spread over the surface, and neighbors along it are joined, so that the meshes between are the pores of
    the surface.

    With `border: closed` the part is closed, by walls of different thickness: pores and tunnels that the surface would
    cut, or that come nearer to it than `thinnest`, are left out before that. Its porosity is then below that of the
    structure. It needs scattered pores. What is sealed is measured and warned about as with a skin.
    """

    name: ClassVar[str] = "fill.implicit"
    version: ClassVar[int] = 2
    headline: ClassVar[tuple[Headline, ...]] = (
        Headline("turned_triangles", "turned triangles"), Headline("skin_mm", "skin", "mm"),
        Headline("sealed_mm3", "void sealed by it", "mm^3"),
    )  # fmt: skip

    skin: Length | None = options.skin(None, minimum=1e-3, maximum=1e4)
    skin_toward: tuple[tuple[float, float, float], ...] = option(
        (), help="skin on faces that point in one of these directions [x, y, z]", minimum=-1e6, maximum=1e6
    )
    skin_angle: float = option(
        45.0, help="largest angle between these and the normal of a face", unit="degrees", minimum=0, maximum=180
    )
    skin_groups: tuple[str, ...] = option(
        (),
        help="skin on these groups of the mesh file: objects, groups and materials of OBJ, objects of 3MF, solids of "
        "an ASCII STL, faces of a CAD file such as 'holes', 'cylinder d<6mm' or 'color red'",
    )
    skin_triangles: Path | None = options.read_path(
        None, note="numbers of the triangles that have the skin, counted from 0 in the order of the mesh file"
    )
    skin_within: Length | None = option(
        None, help="skin on triangles whose three corners are within this distance of the mesh at `skin_near`",
        unit="mm", minimum=0, maximum=1e4,
    )  # fmt: skip
    solid_near: tuple[str, ...] = option((), help="groups or faces, as for `skin_groups`, near which the part is solid")
    solid_within: Length | None = option(
        None, help="distance from the faces `solid_near` within which the part is solid",
        unit="mm", minimum=1e-3, maximum=1e4,
    )  # fmt: skip
    drains: tuple[tuple[float, float, float, float, float, float, float], ...] = option(
        (),
        help="holes through skin and microstructure: [x, y, z, x, y, z, radius], a ball that moves between two points",
        unit="mm", minimum=-1e5, maximum=1e5,
    )  # fmt: skip
    border: str = option(
        "cut", help="how the solid ends at the surface of the part: as cut, without what is too thin, or that and in a "
        "net of struts along the surface or, closed, with whole pores only",
        choices=("cut", "round", "frame", "closed"),
    )  # fmt: skip
    frame: Length | None = option(
        None, help="diameter of the struts along the surface; 1.5 times `thinnest` if omitted",
        unit="mm", minimum=1e-3, maximum=1e3,
    )  # fmt: skip
    frame_spacing: Length | None = option(
        None, help="least distance of the points along the surface that struts join; half of a cell if omitted",
        unit="mm", minimum=1e-2, maximum=1e4,
    )  # fmt: skip
    thinnest: Length | None = option(
        None, help="thinnest solid that a border leaves, and what sharp edges are rounded to; 0.3 mm if omitted",
        unit="mm", minimum=1e-3, maximum=1e3,
    )  # fmt: skip
    islands: str = options.islands("auto", note="in the finished part")
    inside: str = options.inside("auto")

    def check_options(self) -> None:
        """Drains that are open, and faces to choose only for a skin."""
        if self.border == "cut" and self.thinnest is not None:
            raise ConfigError("`thinnest` is what a border leaves, and there is none", hint="give `border: round`")
        if self.border != "frame" and (self.frame is not None or self.frame_spacing is not None):
            raise ConfigError(
                "`frame` and `frame_spacing` describe a net that there is not", hint="give `border: frame`"
            )
        if self.frame is not None and self.frame.mm() < (self.thinnest or THINNEST).mm():
            raise ConfigError(
                f"struts of {self.frame.mm():g} mm along the surface are thinner than `thinnest`, "
                f"{(self.thinnest or THINNEST).mm():g} mm",
                hint="make `frame` thicker, or `thinnest` smaller",
            )
        least = 2 * (self.thinnest or THINNEST).mm()
        for what, thick in (("skin", self.skin), ("solid near faces", self.solid_within)):
            if self.border != "cut" and thick is not None and thick.mm() < least:
                raise ConfigError(
                    f"a {what} of {thick.mm():g} mm is not sure to stay whole; with a border it is twice as thick as "
                    f"`thinnest`, {least:g} mm, or more",
                    hint=f"make the {what.split()[0]} thicker, or `thinnest` smaller",
                )
        if (self.solid_within is None) != (not self.solid_near):
            raise ConfigError(
                "`solid_near` names faces, and `solid_within` says how far from them the part is solid: both or none",
                hint="write for example `solid_near: [holes], solid_within: 2 mm`",
            )
        if self.skin is None and self._chooses:
            raise ConfigError("faces are chosen for a skin, and there is none", hint="give `skin: 1 mm`")
        for number, direction in enumerate(self.skin_toward, 1):
            if not any(direction):
                raise ConfigError(f"direction {number} of `skin_toward` is 0 along all axes, which is none")
        for number, drain in enumerate(self.drains, 1):
            if drain[6] <= 0:
                raise ConfigError(f"the radius of drain {number} is {drain[6]:g} mm; it must be above 0")

    def estimate(self, palette: Palette, field: Size, domain: Size, skin_near: Size | None = None) -> Size:
        body, part = field.body, domain.body.in_unit(field.body.scale)
        made = replace(body, box=part.box, volume=part.volume, envelope=part.envelope)
        held = 0.0
        if self.border != "cut":  # what samples the part first makes it, and the part keeps it
            voxel = (self.thinnest or THINNEST).mm() / PER_DIAMETER
            border = math.prod(part.box) * (body.scale / voxel) ** 3
            held = min(border, KEPT_NODES) + VALUES_IN_WORK * min(border, NODES_IN_WORK)
        return Size(nodes=domain.triangles / 2, resident=held, design=field.design, geometry=made)

    @property
    def _chooses(self) -> bool:
        chosen = (self.skin_toward, self.skin_groups, self.skin_triangles, self.skin_within)
        return any(choice not in ((), None) for choice in chosen)

    def run(
        self, context: Context, field: ScalarField, domain: SurfaceMesh, skin_near: SurfaceMesh | None = None
    ) -> Part:
        """Put the two together, and measure what the skin seals."""
        part = self.filled(context, field, domain, skin_near)
        if part.skin_mm or self.border == "closed":
            sealed = sealed_void(part, context.threads)
            context.report(sealed_mm3=sealed)
            if sealed > WARNED_VOID * float(np.prod(part.domain.upper - part.domain.lower)):
                what = f"skin of {part.skin_mm:g} mm" if part.skin_mm else "closed border"
                context.warn(
                    f"the {what} seals about {sealed:.3g} mm3 of void, in which liquid resin or "
                    "powder stays; let `fix.drains` open it, or keep the skin to some faces (`skin_toward`)"
                )
        return part

    def filled(
        self, context: Context, field: ScalarField, domain: SurfaceMesh, skin_near: SurfaceMesh | None = None
    ) -> Part:
        """The part, of which nothing has been measured."""
        if self.skin_within is not None and skin_near is None:
            raise ConfigError(
                "`skin_within` is a distance from a mesh, and none is wired to the port `skin_near`",
                hint="read it by a stage with an id, and say from: {domain: PART, skin_near: ID}",
            )
        edge = field.physical_edge()
        domain, method = outward_mesh(context, domain, self.inside)
        extent = domain.upper - domain.lower if len(domain.faces) else None
        if extent is not None and extent.max() < MIN_CELLS * edge:
            context.warn(
                f"{domain.name} is {' x '.join(f'{side:.4g}' for side in extent)} mm in size, less than {MIN_CELLS} "
                f"cells of {edge:g} mm; if its file is in inches, `unit: in` of `read.mesh` makes it "
                f"{' x '.join(f'{25.4 * side:.4g}' for side in extent)} mm"
            )
        chosen = self._chosen(context, domain, skin_near) if self._chooses else None
        border = None if self.border == "cut" else Border((self.thinnest or THINNEST).mm())
        skin = self.skin.mm() if self.skin else 0.0
        if self.border == "closed":
            field = self._closed(context, field, domain)
        part = Part(field, domain, skin, self.islands, method, self.drains, chosen, border=border)
        if self.solid_within is not None:
            from sppm_pipeline.method.nouns.named_faces import named_triangles

            faces = np.flatnonzero(named_triangles(domain, self.solid_near)).astype(np.int32)
            context.report(solid_triangles=len(faces))
            part = replace(part, solid_mm=self.solid_within.mm(), solid_faces=faces)
        if self.border == "frame":
            part = replace(part, fills=self._frame(context, domain, edge))
        return part

    def _frame(self, context: Context, domain: SurfaceMesh, edge: float) -> F64:
        """Capsules of the net along the surface."""
        from sppm_pipeline.method.part.surface_net import surface_net

        thick = 1.5 * (self.thinnest or THINNEST).mm() if self.frame is None else self.frame.mm()
        spacing = edge / 2 if self.frame_spacing is None else self.frame_spacing.mm()
        net = surface_net(_triangles(domain), spacing, thick / 2, context.rng())
        context.report(frame_points=len(net.points), frame_struts=len(net.edges))
        return net.capsules

    def _closed(self, context: Context, field: ScalarField, domain: SurfaceMesh) -> ScalarField:
        """The structure without the pores that the surface would cut."""
        from sppm_pipeline.method.part.whole_pores import with_whole_pores

        closed, stays = with_whole_pores(field, _triangles(domain), (self.thinnest or THINNEST).mm())
        context.report(whole_pores=int(stays.sum()))
        return closed

    def _chosen(self, context: Context, domain: SurfaceMesh, near: SurfaceMesh | None) -> I32:
        """Numbers of the triangles that have the skin."""
        from sppm_pipeline.method.nouns.named_faces import named_triangles
        from sppm_pipeline.method.part.chosen_faces import faces_toward, faces_within
        from sppm_pipeline.services.mesh.measures import surface_area

        chosen = np.zeros(len(domain.faces), np.bool_)
        if self.skin_toward:
            chosen |= faces_toward(domain.vertices, domain.faces, self.skin_toward, self.skin_angle)
        if self.skin_within is not None and near is not None:
            others = near.vertices[near.faces]
            chosen |= faces_within(domain.vertices, domain.faces, others, self.skin_within.mm())
        chosen |= named_triangles(domain, self.skin_groups)
        if self.skin_triangles is not None:
            chosen[listed_triangles(self.skin_triangles, len(chosen))] = True
        if not chosen.any():
            raise InputError(
                f"none of the {len(chosen)} triangles of {domain.name} is chosen for the skin",
                hint="widen `skin_angle` or `skin_within`, or leave out `skin`",
            )
        context.report(
            skin_triangles=int(chosen.sum()), skin_area_mm2=surface_area(domain.vertices, domain.faces[chosen])
        )
        return np.flatnonzero(chosen).astype(np.int32)


def _triangles(domain: SurfaceMesh) -> F64:
    """The triangles (m, 3, 3) of the surface that a part has from outside, mm."""
    outer = domain.outer_surface
    return domain.vertices[domain.faces] if outer is None else outer.triangles


def listed_triangles(path: Path, count: int) -> I64:
    """The triangle numbers in a text file, between blanks, commas or line ends."""
    words = content_of(path, MAX_LIST_BYTES).replace(b",", b" ").split()
    wrong = next((word for word in words if not (word.isdigit() and len(word) < 10 and int(word) < count)), None)
    if wrong is not None:
        raise InputError(
            f"{path.name}: {wrong[:40].decode('utf-8', 'replace')!r} is no triangle; there are {count}, numbered from 0"
        )
    return np.array([int(word) for word in words], np.int64)


def sealed_void(part: Part, threads: int) -> float:
    """Volume of the void of a part that opens nowhere, mm3, on a coarse grid."""
    from sppm_pipeline.method.connectivity.components import find_components

    solid, grid = part.coarse_solid(threads)
    voids = find_components(solid, (False, False, False), 6, zeros=True)
    return float(voids.sizes[~voids.faces.any(1)].sum()) * math.prod(grid.spacing)
