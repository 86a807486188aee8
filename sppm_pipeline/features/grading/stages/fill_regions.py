"""``fill.regions``: bodies of a part with fields of their own, solid ones and empty ones, blended where they meet."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from sppm_pipeline import (
    ConfigError,
    Context,
    InputError,
    Length,
    Palette,
    ScalarField,
    Size,
    Stage,
    SurfaceMesh,
    option,
)
from sppm_pipeline.features.grading.stages.field_blend import ScoreTable, in_cells_of, scored, scores_of
from sppm_pipeline.method.nouns.conditions import Region, region_of
from sppm_pipeline.method.part.domain_sampler import DomainSampler
from sppm_pipeline.services.arrays import F32, F64
from sppm_pipeline.services.grid import Grid

SOLID, EMPTY = -1, -2

FARTHEST = 8.0
"""Score at which the solid of a porosity of 0 or 1 is cut; those of fields end one before. One share in 10^12."""

_FILL = re.compile(r"(?:(?P<kind>solid|empty)|field (?P<number>\d{1,3})) in (?P<where>.+)")


class Body(NamedTuple):
    """A piece of the part, and what it is filled with."""

    text: str  # as it was written
    fill: int  # number of a field from 0 on, `SOLID` or `EMPTY`
    region: Region  # a box, sphere or cylinder; of others the mesh counts
    mesh: SurfaceMesh | None  # closed, mm


@dataclass(frozen=True, eq=False)
class RegionsField(ScalarField):
    """Fields, solid and void in bodies, each laid over those before it; lattice and place are those of the first field.

    Within a body, up to `blend_mm` outside of it and there less and less, its fill replaces what was before. Shares of
    fields are mixed by their normal scores as in `BlendedField`, and cut where the porosity, the mean by shares, is
    right; solid has a porosity of 0, void of 1, and these two do not blend.
    """

    reported: ClassVar[tuple[str, ...]] = ("porosities.#4",)

    fields: tuple[ScalarField, ...]
    bodies: tuple[Body, ...]
    blend_mm: float
    tables: tuple[ScoreTable, ...]
    porosities: tuple[float, ...]

    def check(self) -> None:
        """All fields are in order."""
        for field in self.fields:
            field.check()

    @property
    def cells(self) -> tuple[int, int, int]:
        return self.fields[0].cells

    @property
    def periodic(self) -> bool:
        return False

    @property
    def edge_mm(self) -> float | None:
        return self.fields[0].edge_mm

    @property
    def origin_mm(self) -> tuple[float, float, float]:
        return self.fields[0].origin_mm

    @property
    def finest_radius(self) -> float | None:
        return self._least([field.finest_radius for field in self.fields])

    @property
    def thinnest_wall(self) -> float | None:
        return self._least([field.thinnest_wall for field in self.fields])

    def _least(self, lengths: list[float | None]) -> float | None:
        """The least of lengths, each in cells of its field, in cells of the first."""
        own = self.physical_edge()
        known = [
            n * field.physical_edge() / own for n, field in zip(lengths, self.fields, strict=True) if n is not None
        ]
        return min(known, default=None)

    def sample_layers(self, grid: Grid, start: int, stop: int, threads: int = 1) -> F32:
        shape = (stop - start, *grid.shape[1::-1])
        shares, away = {0: np.ones(shape, np.float32)}, self._distances(grid, start, stop)
        for body, distance in zip(self.bodies, away, strict=True):
            own = np.ones(shape, np.float32)
            outside = distance > 0
            own[outside] = np.clip(1 - distance[outside] / self.blend_mm, 0, 1) if self.blend_mm else 0
            # between solid and void nothing is blended: a surface would lie somewhere in between
            stays = {SOLID: EMPTY, EMPTY: SOLID}.get(body.fill)
            shares = {n: share * (outside if n == stays else 1 - own) for n, share in shares.items() if n != body.fill}
            shares[body.fill] = 1 - sum(shares.values(), np.zeros(shape, np.float32))
        shares.pop(SOLID, None)
        empty = shares.pop(EMPTY, None)
        structured = sum(shares.values()) + np.zeros(shape, np.float32)
        porosity = np.zeros(shape) if empty is None else empty.astype(np.float64)
        mixed, square = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        for number, share in shares.items():
            if not share.any():
                continue
            field = self.fields[number]
            values = field.sample_zyx(in_cells_of(field, self.fields[0], grid), start, stop, threads)
            of = np.divide(share, structured, out=np.zeros_like(share), where=structured > 0)
            weight = np.where(of >= 1, 1, np.sin(np.float32(np.pi / 2) * of))
            mixed += weight * scores_of(self.tables[number], values)
            square += weight * weight
            porosity += share * self.porosities[number]
        np.divide(mixed, np.sqrt(square), out=mixed, where=square > 0)
        return self._cut(mixed, porosity, away).T

    def _cut(self, mixed: F32, porosity: F64, away: list[F32]) -> F32:
        """Scores less those at the porosity; the surfaces of solid and empty bodies are their own."""
        from scipy.special import ndtri

        field = np.clip(mixed, 1 - FARTHEST, FARTHEST - 1)
        field -= np.clip(ndtri(1 - np.clip(porosity, 0, 1)), -FARTHEST, FARTHEST).astype(np.float32)
        edge = np.float32(self.physical_edge())
        for number, body in enumerate(self.bodies):
            if body.fill >= 0:
                continue
            distance = away[number] / edge
            meant = np.minimum(field, distance) if body.fill == SOLID else np.maximum(field, -distance)
            # on both sides a distance, so that the surface is found between samples
            meant = np.where(distance <= 0, distance if body.fill == SOLID else -distance, meant)
            later = np.logical_or.reduce([other <= self.blend_mm for other in away[number + 1 :]], initial=False)
            field = np.where(later, field, meant)
        return field

    def _distances(self, grid: Grid, start: int, stop: int) -> list[F32]:
        """Distances from each body, mm, negative inside, (layers, ny, nx); far beyond `blend_mm` of it."""
        kept = _KEPT.get(self)
        if kept is None or kept[0] != grid:
            edge = self.physical_edge()
            x, y, z = (o + edge * g for o, g in zip(self.origin_mm, grid.origin, strict=True))
            hx, hy, hz = (edge * h for h in grid.spacing)
            world = Grid((x, y, z), (hx, hy, hz), grid.shape)
            # windows of the grid, whichever layers are asked for, so that all get the same bits
            kept = _KEPT[self] = grid, [_Near(body, world, self.blend_mm) for body in self.bodies]
        found = []
        ends = (start, stop), (0, grid.shape[1]), (0, grid.shape[0])
        for near in kept[1]:
            low, n = near.low[::-1], near.grid.shape[::-1]
            own = [(max(a, at), min(b, at + m)) for (a, b), at, m in zip(ends, low, n, strict=True)]
            distance = np.full((stop - start, *grid.shape[1::-1]), np.inf, np.float32)
            if all(a < b for a, b in own):
                (k, j, i), to = (
                    tuple(slice(a - o, b - o) for (a, b), o in zip(own, at, strict=True)) for at in (low, (start, 0, 0))
                )
                distance[to] = near.distance(k.start, k.stop)[:, j, i]
            found.append(distance)
        return found

    def summary(self) -> dict[str, Any]:
        """The bodies as they were written, and the porosities of the fields by themselves."""
        return {"regions": [body.text for body in self.bodies], "porosities": list(self.porosities)}


class _Near:
    """The samples near a body, a `grid` in mm; `low` are the numbers of the first in that of the part, or negative."""

    def __init__(self, body: Body, world: Grid, blend_mm: float) -> None:
        origin, spacing = np.array(world.origin), np.array(world.spacing)
        lower, upper = (body.mesh.lower, body.mesh.upper) if body.mesh is not None else body.region.bounds
        # of a body that reaches beyond the grid as much as is felt there
        around = np.ceil(blend_mm / spacing) + 2
        ends = [(corner - origin) / spacing for corner in (lower - blend_mm - spacing, upper + blend_mm + spacing)]
        most = np.array(world.shape) + around
        first, last = np.clip(np.floor(ends[0]), -around, most), np.clip(np.ceil(ends[1]) + 1, -around, most)
        self.low = tuple(int(n) for n in first)
        x, y, z = (origin + first * spacing).tolist()
        nx, ny, nz = (max(0, int(n)) for n in last - first)
        self.grid, self._region = Grid((x, y, z), world.spacing, (nx, ny, nz)), body.region
        self._mesh: DomainSampler | None = None
        if body.mesh is not None:
            self._mesh = DomainSampler(body.mesh, self.grid, self.grid, blend_mm, "scanline")

    def distance(self, start: int, stop: int) -> F32:
        """Distances in layers start <= k < stop of `grid`."""
        if self._mesh is not None:
            return self._mesh.distance(start, stop)
        layers = self.grid.layers(start, stop)
        z, y, x = np.meshgrid(*(layers.axis(axis) for axis in (2, 1, 0)), indexing="ij")
        points = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
        return self._region.signed_distances(points).astype(np.float32).reshape(x.shape)


_KEPT: WeakKeyDictionary[RegionsField, tuple[Grid, list[_Near]]] = WeakKeyDictionary()


@dataclass(frozen=True, kw_only=True)
class FillRegions(Stage):
    """Fill bodies of a part with fields of their own, with solid, or leave them empty, and blend where they meet.

    The first field is everywhere; each body of `regions` in turn is laid over it: ``solid in body boss``, ``field 2 in
    group rim``, ``empty in cylinder z at 12 0 radius 4 mm``. Within a body its fill is there alone. Outside, over the
    width `blend_width`, it blends into what was there: fields by their normal scores as in `field.blend`, so that
    the porosity goes evenly from one to the other, and towards solid or empty bodies to 0 or 1. A body is a box, sphere
    or cylinder, or closed: a body of a CAD file, an object of a mesh file, or the mesh at the port `near`. The fields
    are numbered as in ``from: {fields: [a, b]}``; lattice and place of the result are those of the first one, and
    `fill.implicit` puts it into the part.
    """

    name: ClassVar[str] = "fill.regions"

    regions: tuple[str, ...] = option(
        (),
        help="bodies and their fills, later ones over earlier ones: 'solid in BODY', 'empty in BODY' or 'field 2 in "
        "BODY'; a BODY is 'body NAME' of a CAD file, 'group NAME' of a mesh, 'near', 'box 0 0 0 to 10 10 5 mm', "
        "'sphere 0 0 5 radius 3 mm' or 'cylinder z at 12 0 radius 4 mm'",
    )
    blend_width: Length | None = option(
        None, help="width outside of a body over which its fill fades out; half a cell of the first field if omitted",
        unit="mm", minimum=0, maximum=1e4,
    )  # fmt: skip
    probes: int = option(
        1_000_000,
        help="number of places at which each field is sampled for its scores",
        minimum=10_000,
        maximum=100_000_000,
    )

    def check_options(self) -> None:
        """Each text is a fill and a body; of a mesh it is looked up later."""
        if not self.regions:
            raise ConfigError("there are no `regions`", hint="write for example 'solid in body boss'")
        for text in self.regions:
            self._parsed(text, None, None)

    def estimate(
        self, palette: Palette, fields: tuple[Size, ...], domain: Size | None = None, near: Size | None = None
    ) -> Size:
        samples = float(self.probes)
        sums = sum(samples * field.body.kernels for field in fields)
        return Size(samples=samples * len(fields), sums=sums, design=fields[0].design, geometry=fields[0].geometry)

    def run(
        self,
        context: Context,
        fields: tuple[ScalarField, ...],
        domain: SurfaceMesh | None = None,
        near: SurfaceMesh | None = None,
    ) -> RegionsField:
        """Find the bodies, and take the scores of the fields."""
        bodies = tuple(self._body(text, domain, near, len(fields)) for text in self.regions)
        named = {f"field {number}": field for number, field in enumerate(fields, 1)}
        tables, porosities = scored(context, named, self.probes)
        blend = fields[0].physical_edge() / 2 if self.blend_width is None else self.blend_width.mm()
        context.report(blend_mm=blend)
        return RegionsField(fields, bodies, blend, tuple(tables), tuple(porosities))

    @staticmethod
    def _parsed(text: str, part: SurfaceMesh | None, near: SurfaceMesh | None) -> tuple[int, Region]:
        match = _FILL.fullmatch(" ".join(text.split()))
        if match is None or match["number"] in ("0", "00", "000"):
            raise ConfigError(
                f"{text[:100]!r} in `regions` fills nothing",
                hint="write for example 'solid in body boss', 'empty in near' or 'field 2 in box 0 0 0 to 10 10 5 mm'",
            )
        region = region_of(match["where"], part, near)
        if region.kind in ("plane", "surface"):
            raise ConfigError(f"{text[:100]!r} in `regions`: a {region.kind} has no inside", hint="name a body")
        return {"solid": SOLID, "empty": EMPTY}.get(match["kind"]) or int(match["number"]) - 1, region

    def _body(self, text: str, part: SurfaceMesh | None, near: SurfaceMesh | None, fields: int) -> Body:
        fill, region = self._parsed(text, near if part is None else part, near)
        if fill >= fields:
            raise ConfigError(
                f"{text[:100]!r} in `regions`: there is no field {fill + 1}, only {fields}",
                hint="wire more, for example `from: {fields: [coarse, fine]}`",
            )
        if region.kind != "triangles":
            return Body(text, fill, region, None)
        if not len(region.triangles):
            raise ConfigError(f"{text[:100]!r} in `regions` needs a mesh", hint="read a part before this stage")
        from sppm_pipeline.services.mesh.orientation import orient

        vertices, which = np.unique(region.triangles.reshape(-1, 3), axis=0, return_inverse=True)
        faces = which.reshape(-1, 3).astype(np.int32)
        mesh = SurfaceMesh(vertices, orient(vertices, faces).faces, region.text)
        if not mesh.bounds_solid:
            raise InputError(
                f"{text[:100]!r} in `regions`: the {len(faces)} triangles do not close, so they bound no body",
                hint="choose a whole body or object; for solid near faces `fill.implicit` has `solid_near`",
            )
        return Body(text, fill, region._replace(triangles=np.zeros((0, 3, 3))), mesh)
