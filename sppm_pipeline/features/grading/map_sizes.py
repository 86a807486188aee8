"""Sizes and shapes of kernels that follow maps: radii, stretch and its direction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sppm_pipeline.errors import ConfigError
from sppm_pipeline.method.assembly.contents import TilingArrays
from sppm_pipeline.method.fields.tiling import Tiling
from sppm_pipeline.method.kernels.profiles import PORE_PROFILE, TUNNEL_PROFILES
from sppm_pipeline.method.nouns.maps import Grading
from sppm_pipeline.nouns.artifact import frozen
from sppm_pipeline.services.arrays import F64, I64
from sppm_pipeline.services.metric import PLAIN, stretched_metric

_AT_A_TIME = 1 << 18
"""Kernels whose places are evaluated together: 6 MB of places."""

DIRECTION = ("direction_x", "direction_y", "direction_z")
"""Maps of the vector along which pores are stretched, of any length."""

ACROSS = ("stretch_across", "across_x", "across_y", "across_z")
"""Maps of a second stretch, along the part of a vector that is perpendicular to the direction."""

_PARALLEL = 1e-6
"""Sine of the angle between both vectors below which the second one has no direction of its own."""


def check_round(grading: Grading, stage: str) -> None:
    """Check that no map asks for what only scattered cells have; `ConfigError` names it."""
    for name in ("stretch", "stretch_across", "spacing"):
        if name in grading:
            raise ConfigError(
                f"`{stage}` lays cells whose faces fit each other, and can't follow the map {name!r}",
                hint="scatter the pores by `tile.scattered`, or leave the map out",
            )


def metric_at(grading: Grading, points: F64) -> F64 | None:
    """Metrics (n, 6) by the maps `stretch` and `direction_x`, `_y`, `_z` at points (n, 3) mm; None without them.

    A component of the direction that has no map is 0. Where all are 0 nothing is stretched. A second stretch s2
    (`ACROSS`) along a unit vector e perpendicular to the direction d makes it
    ``I + (s^-2 - 1) d d^T + (s2^-2 - 1) e e^T``.
    `ConfigError` if there is a stretch without a direction, or a direction without a stretch.
    """
    given = [name in grading for name in DIRECTION]
    if "stretch" not in grading:
        if second := [name for name in ACROSS if name in grading]:
            raise ConfigError(
                f"there is a map {second[0]!r}, but no map `stretch`",
                hint="give it and its direction by `grade` stages",
            )
        if any(given):
            raise ConfigError("there is a direction, but no map `stretch`", hint="give it by a `grade` stage")
        return None
    if not any(given):
        raise ConfigError(
            "there is a map `stretch`, but no direction",
            hint="give one of the maps direction_x, direction_y, direction_z, or more, by `grade` stages",
        )
    direction = _vectors(grading, DIRECTION, points)
    metric = stretched_metric(grading["stretch"].at(points), direction)
    name, *components = ACROSS
    given = [component in grading for component in components]
    if name not in grading and not any(given):
        return metric
    if name not in grading or not any(given):
        missing = f"`{name}`" if name not in grading else f"of {', '.join(components)}"
        raise ConfigError(f"the second stretch lacks a map {missing}", hint="give it by a `grade` stage")
    across = _vectors(grading, components, points)
    length = np.linalg.norm(across, axis=1, keepdims=True)
    squared = (direction**2).sum(1, keepdims=True)
    along = (across * direction).sum(1, keepdims=True)
    across = across - np.divide(along, squared, out=np.zeros_like(along), where=squared > 0) * direction
    across[np.linalg.norm(across, axis=1) <= _PARALLEL * length[:, 0]] = 0.0
    return np.asarray(metric + stretched_metric(grading[name].at(points), across) - PLAIN)


def _vectors(grading: Grading, names: Sequence[str], points: F64) -> F64:
    """Vectors (n, 3) of three maps at points, 0 where there is no map."""
    return np.stack([grading[n].at(points) if n in grading else np.zeros(len(points)) for n in names], axis=1)


def sites_of(arrays: TilingArrays) -> I64:
    """The cell of each interior, (interiors, 3), counted from that of the box; that within the box, if in many."""
    interior = arrays.interior
    sites = np.zeros((int(interior.max()) + 1, 3), np.int64)
    place = np.argwhere(interior >= 0)
    inside = ((place >= arrays.halo) & (place < np.array(interior.shape) - arrays.halo)).all(1)
    for some in (place[~inside], place[inside]):
        sites[interior[tuple(some.T)]] = some - arrays.halo
    return sites


def graded_radii(tiling: Tiling, grading: Grading, *, faces_differ: bool) -> Tiling:
    """The tiling with pores and tunnels of the sizes and shapes that maps say, every interior of it in one place.

    These are `pore_radius`, `tunnel_radius`, `scale`, and `stretch` with its direction: a kernel measures distances in
    the metric at its center or, if it is that of a tunnel, in the middle between its ends. Radii are those across the
    direction. Unless every face pattern is in one place, too (`faces_differ`), those keep their sizes. `ConfigError`
    if walls are to be stretched.
    """
    maps = [
        name for name in ("pore_radius", "tunnel_radius", "scale", "stretch", *DIRECTION, *ACROSS) if name in grading
    ]
    if not maps or tiling.edge is None:
        return tiling
    grading, edge = grading.in_cells(tiling.edge, tiling.origin), tiling.edge
    micro, arrays = tiling.tileset.micro, tiling.arrays
    pieces, kernels = micro.pieces, micro.pieces.kernels
    sites = np.full((len(pieces), 3), np.nan)
    sites[: pieces.interiors] = sites_of(arrays)
    if faces_differ:
        for axis, faces in enumerate(arrays.faces):
            place = np.argwhere(faces >= 0)
            sites[pieces.interiors + axis * pieces.colors + faces[tuple(place.T)]] = place - arrays.halo
    # tunnels from an interior to a face are where the interior is
    sites[pieces.interiors + 3 * pieces.colors :] = sites[pieces.codes // (6 * pieces.colors)] if pieces.colors else 0
    box = np.array(arrays.shape, np.float64)

    def shaped(first: I64, ends: tuple[F64, ...], name: str, usual: float) -> tuple[F64, F64 | None]:
        """Factors of the radii of kernels in the middle of `ends`, and metrics; 1 and plain where no place is known."""
        n = len(ends[0])
        factor, metric = np.ones(n), np.tile(PLAIN, (n, 1)) if "stretch" in grading else None
        for begin in range(0, n, _AT_A_TIME):  # there may be millions
            part = slice(begin, min(begin + _AT_A_TIME, n))
            piece = np.searchsorted(first, np.arange(n)[part], side="right") - 1
            place = np.mean([end[part] for end in ends], axis=0) + sites[piece]
            known = begin + np.flatnonzero(np.isfinite(place[:, 0]))
            # what lies beyond the box is like its border
            at = np.clip(place[known - begin], 0.0, box) * edge + np.array(tiling.origin)
            if "scale" in grading:
                factor[known] = grading["scale"].at(at)
            if name in grading:
                factor[known] = grading[name].at(at) / (usual * edge)
            found = metric_at(grading, at)
            if metric is not None and found is not None:
                metric[known] = found
        return factor, None if metric is None else frozen(metric)

    if not micro.follows_metric and "stretch" in grading:
        raise ConfigError(
            "walls can't be stretched", hint="stretch structures that end with `field.gaussian` or `field.sheet`"
        )
    # maps give radii in mm: they are relative to the median kernel, about which those of the recipe may vary
    profile = TUNNEL_PROFILES[kernels.profile]
    usual = PORE_PROFILE.radius(float(np.median(kernels.omega)), micro.level) if len(kernels.omega) else 1.0
    factor, metric = shaped(pieces.first_pore, (kernels.centers,), "pore_radius", usual)
    kernels = kernels._replace(omega=frozen(kernels.omega * PORE_PROFILE.scaled_radius(factor)), pore_metric=metric)
    usual = profile.radius(float(np.median(kernels.mu)), micro.level) if len(kernels.mu) else 1.0
    factor, metric = shaped(pieces.first_tunnel, (kernels.starts, kernels.ends), "tunnel_radius", usual)
    kernels = kernels._replace(mu=frozen(kernels.mu * profile.scaled_radius(factor)), tunnel_metric=metric)
    changed = replace(pieces, kernels=kernels)
    return replace(tiling, tileset=replace(tiling.tileset, micro=replace(micro, pieces=changed)))
