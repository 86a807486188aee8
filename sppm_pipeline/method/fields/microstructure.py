"""The microstructure: kernels of all interiors and faces, and the level at which their sum is cut."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar
from weakref import WeakKeyDictionary

import numpy as np

from sppm_pipeline.errors import ConfigError
from sppm_pipeline.method.assembly.contents import Pieces, TilingArrays, connector_code, lone_periodic_cell
from sppm_pipeline.method.fields.kernel_sum import KernelSum
from sppm_pipeline.method.fields.scalar_field import WrappedField
from sppm_pipeline.method.kernels.kernels import Kernels, kernel_reaches, steepest
from sppm_pipeline.method.kernels.profiles import PORE_PROFILE, TUNNEL_PROFILES
from sppm_pipeline.method.nouns.pores import PoreSet
from sppm_pipeline.method.nouns.tunnels import TunnelGraph
from sppm_pipeline.nouns.artifact import frozen
from sppm_pipeline.nouns.length import Cell
from sppm_pipeline.services.arrays import F32, F64, I32, I64, Bools
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.metric import check_metric

if TYPE_CHECKING:
    from sppm_pipeline.method.assembly.gather import Catalog

CUTOFF = 1e-5
"""Value below which a single kernel is left out of the sum; flips about 2e-5 of the voxels."""


COARSE_PITCH = 0.5
"""Samples this many radii of the thinnest tunnel apart are fine enough for finer ones to be interpolated from them:
on each of 20 cells less than 5 in 100 000 change sides."""

USUAL_LEVEL, LOWEST_LEVEL = 0.25, 1e-3
"""The level of the paper, and one below which the cut-off of the kernels is too near for an interpolation."""

_TABLES: WeakKeyDictionary[Pieces, dict[Any, Any]] = WeakKeyDictionary()


def sampling_tables(pieces: Pieces) -> dict[Any, Any]:
    """Tables made to sample these kernels: patch banks and a catalog; it is freed with them.

    The level does not enter but for patches of sixteen bits, which are kept for one level at a time; microstructures
    that differ in nothing else share the tables.
    """
    return _TABLES.setdefault(pieces, {})


@dataclass(frozen=True, eq=False)
class Microstructure(KernelSum):
    """Kernels of K interiors and of colored faces, cut at one level (paper, eq. 3-5).

    With one interior and at most one color it is a periodic cell and can be sampled; with more it is the material
    of a tile set, which a tiling lays out.

    Attributes
    ----------
    cell : Cell
    graph : TunnelGraph
        The pores and tunnels the kernels stand for.
    pieces : Pieces
        Kernels by interior, face and connector; cell sizes.
    level : float
        The level C: solid where the sum is smaller.
    exact : bool
        Whether fine grids are summed, too, not interpolated from coarse ones.
    """

    reported: ClassVar[tuple[str, ...]] = (*PoreSet.reported, *TunnelGraph.reported, "level")
    follows_metric: ClassVar[bool] = True
    """Whether kernels may measure distances in metrics of their own."""
    counted: ClassVar[bool] = True
    """Whether more pores in a cell change its porosity."""
    is_sum: ClassVar[bool] = True
    """Whether G is a continuous sum; else `laid_values` is sampled, and nothing is interpolated."""

    cell: Cell
    graph: TunnelGraph
    pieces: Pieces
    level: float
    exact: bool = False

    def check(self) -> None:
        """The level is a positive number, and there are kernels of the right shapes for every piece."""
        if not 0 < self.level < np.inf:
            raise ValueError(f"the level must be positive and finite, got {self.level}")
        pieces, k = self.pieces, self.pieces.kernels
        if pieces.interiors != self.interiors or pieces.colors < max(self.colors):
            raise ValueError(
                f"the kernels are of {pieces.interiors} interiors and {pieces.colors} colors, the pores of "
                f"{self.interiors} and {max(self.colors)}"
            )
        for what, array, shape in (
            ("pore kernels", k.centers, (len(k.omega), 3)), ("tunnel starts", k.starts, (len(k.mu), 3)),
            ("tunnel ends", k.ends, (len(k.mu), 3)), ("pore widths", k.omega, (pieces.first_pore[-1],)),
            ("tunnel widths", k.mu, (pieces.first_tunnel[-1],)),
        ):  # fmt: skip
            if array.shape != shape or array.dtype != np.float64:
                raise ValueError(f"the {what} are {array.dtype} {array.shape}, expected float64 {shape}")
        if min(k.omega.min(initial=1), k.mu.min(initial=1)) <= 0:
            raise ValueError("the parameters omega and mu of kernels are positive")
        if (k.pore_metric is None) != (k.tunnel_metric is None):
            raise ValueError("pores and tunnels both have metrics, or none")
        for metric, n in ((k.pore_metric, len(k.omega)), (k.tunnel_metric, len(k.mu))):
            if metric is not None:
                check_metric(metric, n)

    @property
    def centers_mm(self) -> F64:
        """Centers of the pores, (n, 3) float64, mm; see `PoreSet.centers_mm`."""
        return self.graph.pores.centers_mm

    @property
    def cells(self) -> tuple[int, int, int]:
        return (1, 1, 1)

    @property
    def periodic(self) -> bool:
        return True

    @property
    def reach(self) -> float:
        """Largest reach of a pore or tunnel, cell sizes."""
        return max(float(reaches.max(initial=0)) for reaches in kernel_reaches(self.pieces.kernels, CUTOFF))

    @property
    def finest_radius(self) -> float | None:
        (_, mu), profile = steepest(self.pieces.kernels), self.pieces.kernels.profile
        # at a level of 1 or more not even the axis of a single tunnel is void
        return TUNNEL_PROFILES[profile].radius(mu, self.level) if mu and self.level < 1 else None

    @property
    def stretched(self) -> bool:
        """True if kernels measure distances in metrics of their own."""
        return self.pieces.kernels.pore_metric is not None

    @property
    def edge_mm(self) -> float | None:
        return self.cell.edge if self.cell.physical else None

    @property
    def interiors(self) -> int:
        """K."""
        return self.graph.pores.interiors

    @property
    def colors(self) -> tuple[int, int, int]:
        """Number of face patterns perpendicular to x, y, z."""
        return self.graph.pores.colors

    def face_ids(self, colors: tuple[int, int, int]) -> tuple[int, int, int]:
        """`colors` as tilings hold them: -1 along an axis without face patterns."""
        x, y, z = (k if there else -1 for k, there in zip(colors, self.colors, strict=True))
        return (x, y, z)

    def with_level(self, level: float) -> Microstructure:
        """The same kernels cut at another level."""
        return replace(self, level=float(level))

    def cut_at(self, value: float) -> Microstructure:
        """The same kernels, with `value` added to the level."""
        return self.with_level(self.level + value)

    @property
    def tunnel_order(self) -> slice | I64:
        """The tunnels of blocks without faces in the order of their kernels, (m,)."""
        order = _sorted_by(self.graph.pores.piece[self.graph.edges[:, 0]], self.interiors)[0]
        return slice(None) if order is None else order

    def only(self, pores: Bools, tunnels: Bools) -> Microstructure:
        """Some of the pores (n,) and tunnels (m,) of blocks without faces, as the graph counts them."""
        graph, pieces, kept = self.graph, self.pieces, tunnels[self.tunnel_order]
        left = replace(graph.pores, centers=graph.pores.centers[pores], piece=graph.pores.piece[pores])
        edges = (np.cumsum(pores) - 1)[graph.edges[tunnels]]
        before = (np.concatenate([[0], np.cumsum(mask)]) for mask in (pores, kept))
        first_pore, first_tunnel = (
            n[first] for n, first in zip(before, (pieces.first_pore, pieces.first_tunnel), strict=True)
        )
        pieces = replace(
            pieces, kernels=pieces.kernels.taken(pores, kept), first_pore=first_pore, first_tunnel=first_tunnel
        )
        return replace(self, graph=TunnelGraph(left, edges, graph.shift[tunnels]), pieces=pieces)

    def exactly(self) -> Microstructure:
        return replace(self, exact=True)

    def alone(self, interior: int, colors: tuple[int, int, int]) -> PeriodicTile:
        """Interior t with faces of the given colors on both opposite sides, repeated for ever."""
        return PeriodicTile(self, interior, colors)

    def laid_sums(
        self, arrays: TilingArrays, grid: Grid, start: int, stop: int, threads: int = 1, wanted: I32 | None = None
    ) -> F32:
        """The sum G of all kernels of a layout, which `KernelSum.kernel_sums` asks for."""
        from sppm_pipeline.method.assembly.gather import sample_exact

        return sample_exact(
            self.pieces, arrays, grid, CUTOFF, threads, start, stop, wanted=wanted, catalog=self._catalog()
        ).T

    def _catalog(self) -> Catalog:
        from sppm_pipeline.method.assembly.gather import make_catalog

        tables = sampling_tables(self.pieces)
        if "catalog" not in tables:
            tables["catalog"] = make_catalog(self.pieces, CUTOFF)
        catalog: Catalog = tables["catalog"]
        return catalog

    @property
    def solid_below(self) -> float:
        return self.level

    @property
    def coarse_pitch(self) -> float | None:
        if self.exact or not self.is_sum or not LOWEST_LEVEL <= self.level < 1:
            return None
        kernels = self.pieces.kernels
        return finest_pitch(*steepest(kernels), kernels.profile, self.level)

    @property
    def additive(self) -> bool:
        return self.is_sum

    def own_values(self, grid: Grid, start: int, stop: int, threads: int = 1) -> F32:
        if self.is_sum:
            return super().own_values(grid, start, stop, threads)
        return self.alone(0, (0, 0, 0)).own_values(grid, start, stop, threads)

    def kernel_sums(self, grid: Grid, start: int, stop: int, threads: int = 1, wanted: I32 | None = None) -> F32:
        if self.interiors > 1 or max(self.colors) > 1:
            raise ValueError("a microstructure with several interiors or colors has to be laid out to be sampled")
        return self.alone(0, (0, 0, 0)).kernel_sums(grid, start, stop, threads, wanted)

    def laid_values(self, arrays: TilingArrays, grid: Grid, start: int, stop: int, threads: int = 1) -> F32:
        """Samples of a layout whose field is not `additive`: a continuous field with the sign of G - C."""
        values = self.laid_sums(arrays, grid, start, stop, threads)
        values -= np.float32(self.level)
        return values

    def summary(self) -> dict[str, Any]:
        """Numbers of pores and tunnels and the level."""
        return {**self.graph.pores.summary(), **self.graph.summary(), "level": self.level}


def made_of_kernels(made: Any, recipe: str, what: str) -> Microstructure:
    """What a recipe has made; `ConfigError` if that has no pores and tunnels, which `what` needs."""
    if isinstance(made, Microstructure):
        return made
    raise ConfigError(
        f"the recipe {recipe!r} makes a {type(made).__name__}; {what} a Microstructure",
        hint="end the recipe with `field.gaussian` or another stage that sums kernels",
    )


def finest_pitch(omega: float, mu: float, profile: str, level: float) -> float:
    """The spacing from which pores and tunnels of these parameters can be interpolated, in their unit of length.

    Zero stands for no pores, and for no tunnels.
    """
    # lower levels make tunnels wider, but not their kernels smoother
    level = max(level, USUAL_LEVEL)
    sizes = ((TUNNEL_PROFILES[profile], mu), (PORE_PROFILE, omega))
    return COARSE_PITCH * min((kind.radius(value, level) for kind, value in sizes if value), default=math.inf)


@dataclass(frozen=True, eq=False)
class PeriodicTile(WrappedField, KernelSum):
    """One tile of a microstructure among copies of itself."""

    base: Microstructure
    interior: int
    colors: tuple[int, int, int]

    @property
    def solid_below(self) -> float:
        return self.base.level

    @property
    def coarse_pitch(self) -> float | None:
        return self.base.coarse_pitch

    def kernel_sums(self, grid: Grid, start: int, stop: int, threads: int = 1, wanted: I32 | None = None) -> F32:
        return self.base.laid_sums(self.arrays(), grid, start, stop, threads, wanted)

    @property
    def additive(self) -> bool:
        return self.base.additive

    def own_values(self, grid: Grid, start: int, stop: int, threads: int = 1) -> F32:
        return self.base.laid_values(self.arrays(), grid, start, stop, threads)

    def summary(self) -> dict[str, Any]:
        """Which interior and which faces."""
        return {"interior": self.interior, "colors": list(self.colors)}

    def arrays(self) -> TilingArrays:
        """The periodic tiling of this one tile."""
        return lone_periodic_cell(self.interior, self.base.face_ids(self.colors))


def pieces_from_graph(graph: TunnelGraph, omega: F64, mu: F64, profile: str) -> Pieces:
    """Sort the kernels of all pores and tunnels by the piece they belong to.

    `omega` (n,) is that of each pore, 1 / cell edge^2, `mu` (m,) that of each tunnel, 1 / cell edge^power of the
    profile.
    """
    pores = graph.pores
    axis_of_piece = pores.axis_of_piece()
    most = max(pores.colors)  # every axis is given as many colors, the missing ones without content
    first_of_axis = np.array([pores.face_piece(axis, 0) for axis in range(3)])
    of_face = np.arange(pores.interiors, len(axis_of_piece)) - first_of_axis[axis_of_piece[pores.interiors :]]
    number = np.arange(len(axis_of_piece), dtype=np.int32)
    number[pores.interiors :] = pores.interiors + axis_of_piece[pores.interiors :] * most + of_face
    first, second = (pores.piece[graph.edges[:, end]] for end in range(2))
    on_face = axis_of_piece >= 0
    # connectors make pieces of their own: which of them exist depends on the faces that meet
    crossing = np.flatnonzero(on_face[second] & ~on_face[first])
    face = second[crossing]
    axis, side = axis_of_piece[face], graph.shift[crossing].sum(1)
    code = connector_code(first[crossing], axis, side, face - first_of_axis[axis], colors=most)
    # those of one meeting follow each other, so that only the runs have to be sorted
    runs = np.flatnonzero(np.diff(code, prepend=-1))
    codes, which = np.unique(code[runs], return_inverse=True)
    of_tunnel = number[first]
    of_tunnel[crossing] = pores.interiors + 3 * most + np.repeat(which, np.diff(runs, append=len(code)))
    count = pores.interiors + 3 * most + len(codes)
    del first, second, face, axis, side, code, crossing  # there may be millions
    tunnels, first_tunnel = _sorted_by(of_tunnel, count)
    del of_tunnel
    # kernels by piece, so that a piece is a slice of all of them
    own, first_pore = _sorted_by(number[pores.piece], count)
    starts, ends = (frozen(points) for points in graph.sorted_segments(tunnels))

    def taken(array: F64, order: I64 | None) -> F64:
        return frozen(array if order is None else array[order])

    kernels = Kernels(taken(pores.centers, own), taken(omega, own), starts, ends, taken(mu, tunnels), profile)
    return Pieces(kernels, frozen(first_pore), frozen(first_tunnel), pores.interiors, most, frozen(codes))


def _sorted_by(piece: I32, pieces: int) -> tuple[I64 | None, I64]:
    """The order that sorts by piece, None if all is sorted, and where each piece begins."""
    first = np.concatenate([[0], np.cumsum(np.bincount(piece, minlength=pieces))])
    return None if (piece[1:] >= piece[:-1]).all() else np.argsort(piece, kind="stable"), first
