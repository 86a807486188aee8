"""Data of the live view of a field: the kernels of a cell, which the browser sums, or samples of eight bits."""

from __future__ import annotations

import html
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.features.browser.live.page import encode_view, live_page
from sppm_pipeline.method.assembly.contents import lone_periodic_cell, site_pieces, sites_between
from sppm_pipeline.method.fields.microstructure import CUTOFF, Microstructure
from sppm_pipeline.method.fields.scalar_field import ScalarField
from sppm_pipeline.method.fields.tileset import TileSet
from sppm_pipeline.method.fields.tiling import Tiling
from sppm_pipeline.method.kernels.kernels import Kernels, concatenated
from sppm_pipeline.method.kernels.profiles import TUNNEL_PROFILES
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.services.arrays import F32, U8
from sppm_pipeline.services.grid import Grid, cell_centers

DEPTH = 3.0
"""Sums are kept up to so many levels C: beyond, a byte would be too coarse a step."""

SUMMED = 64
"""Samples along a cell edge at which the browser sums kernels, in about 0.3 s; twice as many take eight times as
long."""

FINE = 24
"""Samples along a cell edge at which the browser sums a few cells of a tiling that was sampled more coarsely."""

COARSE, OVERVIEW = 8, 600_000
"""Samples along a cell edge below which they only give an overview, and how many of them are enough for one."""

NO_PIECE = 255
"""Byte that stands for no interior, and for no face."""

MAX_FRAME_KERNELS = 600
"""Kernels of a live view in a notebook, which then takes 60 kB at most."""

MAX_KERNELS = 40_000
"""Kernels of a tile set that are handed to the browser."""


def structure_view(what: ScalarField | TileSet, samples: int, threads: int) -> bytes:
    """The view file of a field or tile set.

    A periodic cell, and the tiles of a set, are handed over as kernels: pore and tunnel radii can then be changed in
    the browser. Any other field is sampled, at no more than so many samples as far as it fills its box.
    """
    tiles = _tiles(what)
    if tiles and sum(len(tile.omega) + len(tile.mu) for tile in tiles) <= MAX_KERNELS:
        return _kernel_view(what, tiles, threads)
    return _sampled_view(what.micro.alone(0, (0, 0, 0)) if isinstance(what, TileSet) else what, samples, threads)


def live_frame(what: ScalarField | TileSet) -> str:
    """The live view as a frame for notebooks; empty for what is too large for one, or has to be sampled."""
    tiles = _tiles(what)
    if not tiles or sum(len(tile.omega) + len(tile.mu) for tile in tiles) > MAX_FRAME_KERNELS:
        return ""
    page = html.escape(live_page(_kernel_view(what, tiles, 1)))
    return f'<iframe sandbox="allow-scripts" srcdoc="{page}" width="640" height="510" style="border:0"></iframe>'


def _tiles(what: ScalarField | TileSet) -> list[Kernels]:
    """The kernels of each tile among copies of itself, shared faces once; none of what is no sum of its own."""
    micro = what.micro if isinstance(what, TileSet) else what
    if not isinstance(micro, Microstructure) or not micro.additive or micro.stretched:
        return []  # the browser sums round kernels alone
    if not isinstance(what, TileSet) and (micro.interiors > 1 or max(micro.colors) > 1):
        return []
    combinations = what.combinations() if isinstance(what, TileSet) else None
    made = []
    for tile in range(micro.interiors):
        colors = (0, 0, 0) if combinations is None else tuple(int(v) for v in combinations[tile][1::2])
        x, y, z = micro.face_ids((colors[0], colors[1], colors[2]))
        site = sites_between(lone_periodic_cell(tile, (x, y, z)), np.zeros(3, np.int64), np.ones(3, np.int64))
        numbers = site_pieces(micro.pieces.numbers, site).reshape(-1)
        made.append(concatenated([micro.pieces[int(number)] for number in numbers if number >= 0]))
    return made


def _kernel_view(what: ScalarField | TileSet, tiles: list[Kernels], threads: int) -> bytes:
    micro = what.micro if isinstance(what, TileSet) else what
    assert isinstance(micro, Microstructure)
    pores = [np.column_stack([tile.centers, tile.omega]).astype(np.float32) for tile in tiles]
    tunnels = [np.column_stack([tile.starts, tile.ends, tile.mu]).astype(np.float32) for tile in tiles]
    profile = TUNNEL_PROFILES[micro.pieces.kernels.profile]
    porosity = list(what.porosity) if isinstance(what, TileSet) else []
    if not isinstance(what, TileSet):
        porosity = [1 - float(micro.solid(SUMMED, threads).mean())]
    edge = micro.edge_mm
    head: dict[str, Any] = {
        "kind": "kernels", "title": type(what).__name__, "n": SUMMED, "cells": [1, 1, 1], "edge_mm": edge,
        "unit": "cell" if edge is None else "mm", "size": [edge or 1.0] * 3, "origin": [0.0, 0.0, 0.0],
        "level": micro.level, "top": DEPTH * micro.level, "base": 0.0, "level_name": "level C", "domain": False,
        "periodic": True, "power": profile.power, "cutoff": CUTOFF,
        "pores": [len(p) for p in pores], "tunnels": [len(t) for t in tunnels],
        "porosity": porosity[0] if len(porosity) == 1 else None, "tile_porosity": porosity, "explore": None,
    }  # fmt: skip
    return encode_view(head, {"pores": np.concatenate(pores), "tunnels": np.concatenate(tunnels)})


def _sampled_view(field: ScalarField, samples: int, threads: int) -> bytes:
    """G / (3 C), or a field without a level about its zero, and the distance from the domain in samples; both bytes."""
    grid = _view_grid(field, samples)
    if grid.spacing[0] * COARSE > 1:
        grid = _view_grid(field, min(samples, OVERVIEW))
    inner, outer, level, top = _sampled(field, grid, threads)
    base = 0.0 if level else -top
    edge = field.edge_mm or 1.0
    low, extent = (np.array(v, float) for v in (grid.origin, grid.spacing))
    step = edge * extent
    head: dict[str, Any] = {
        "kind": "grid", "title": type(field).__name__, "shape": list(grid.shape), "cells": list(field.cells),
        "edge_mm": field.edge_mm, "unit": "cell" if field.edge_mm is None else "mm",
        "size": (step * grid.shape).tolist(), "origin": (np.array(field.origin_mm) + edge * low - step / 2).tolist(),
        "level": level, "top": top - base, "base": base, "level_name": "level C" if level else "offset",
        "domain": outer is not None, "periodic": field.periodic and outer is None, "per_cell": 1 / grid.spacing[0],
        "lattice_mm": list(field.origin_mm), "explore": None,
        "marks": [["drain", *drain[3:6]] for drain in field.drains] if isinstance(field, Part) else [],
    }  # fmt: skip
    inside = np.ones(inner.shape, np.float32) if outer is None else np.clip(0.5 - outer, 0, 1)
    whole = float(inside.sum(dtype=np.float64))
    # samples of the border count by how much of them lies inside
    head["porosity"] = float((inside * (inner >= level)).sum(dtype=np.float64)) / whole if whole else None
    if outer is not None:
        area = inside.sum(axis=(1, 2), dtype=np.float64) * step[0] * step[1]
        head |= {"inside_mm2": area.tolist(), "z_mm": [field.origin_mm[2] + edge * low[2], step[2]]}
    arrays: dict[str, NDArray[Any]] = {"field": _bytes((inner - base) / (top - base))}
    if outer is not None:
        from scipy.ndimage import binary_dilation

        near = binary_dilation(outer < 0.999, np.ones((3, 3, 3), bool))
        arrays["field"][~near] = 0  # nothing is seen of it, and equal bytes take no room
        # six bits place a rim within 1/32 of a sample, and take three quarters of the room of eight
        arrays["domain"] = np.minimum(4 * np.rint(64 * np.clip(0.5 + outer / 2, 0, 1)), 255).astype(np.uint8)
    found = _lattice(field) if grid.spacing[0] * FINE > 1 else None
    if found is not None:
        head["explore"] = found[0]
        arrays |= found[1]
    return encode_view(head, arrays)


def _lattice(field: ScalarField) -> tuple[dict[str, Any], dict[str, NDArray[Any]]] | None:
    """Data to sum the kernels of any few cells of a tiling; None if the browser can't, or nothing repeats."""
    tiling = field.base if isinstance(field, Part) else field
    if not isinstance(tiling, Tiling) or tiling.tileset.kind in ("fresh", "scattered") or not tiling.additive:
        return None
    if isinstance(field, Part) and (field.has_skin or len(field.drains) or len(field.fills) or field.border):
        return None
    pieces, arrays = tiling.tileset.micro.pieces, tiling.arrays
    if tiling.tileset.micro.stretched:
        return None
    k = pieces.kernels
    if max(pieces.interiors, pieces.colors) >= NO_PIECE or len(k.omega) + len(k.mu) > MAX_KERNELS:
        return None
    head = {
        "shape": list(arrays.interior.shape), "halo": arrays.halo, "periodic": arrays.periodic,
        "cutoff": CUTOFF, "power": TUNNEL_PROFILES[k.profile].power,
        "interiors": pieces.interiors, "colors": pieces.colors, "codes": pieces.codes.tolist(),
        "first_pore": pieces.first_pore.tolist(), "first_tunnel": pieces.first_tunnel.tolist(),
    }  # fmt: skip
    listed = {"interior": arrays.interior, **{f"faces{axis}": faces for axis, faces in enumerate(arrays.faces)}}
    packed: dict[str, NDArray[Any]] = {
        name: np.where(numbers < 0, NO_PIECE, numbers).astype(np.uint8) for name, numbers in listed.items()
    }
    packed["pores"] = np.column_stack([k.centers, k.omega]).astype(np.float32)
    packed["tunnels"] = np.column_stack([k.starts, k.ends, k.mu]).astype(np.float32)
    return head, packed


def _view_grid(field: ScalarField, samples: int) -> Grid:
    """Cubic samples, a whole number along a cell edge where there are enough; a part with a margin of one."""
    low, high = np.zeros(3), np.array(field.cells, float)
    if isinstance(field, Part):
        edge = field.physical_edge()
        low = (field.domain.lower - field.origin_mm) / edge
        high = (field.domain.upper - field.origin_mm) / edge
    n = (samples / float((high - low).prod())) ** (1 / 3)
    n = float(math.floor(n)) if n >= 4 else n
    if not isinstance(field, Part) and n >= 4:
        return cell_centers(int(n), field.cells)
    first = np.floor(low * n + 1e-6).astype(int) - 1
    nx, ny, nz = (int(v) for v in np.ceil(high * n - 1e-6).astype(int) + 2 - first)
    x, y, z = (float(v) / n for v in first)
    return Grid((x, y, z), (1 / n,) * 3, (nx, ny, nz))


def _sampled(field: ScalarField, grid: Grid, threads: int) -> tuple[F32, F32 | None, float, float]:
    """Samples (nz, ny, nx), distance from the domain in samples or None, the level, and the largest value kept."""
    outer = None
    if isinstance(field, Part):
        inner, outer = field.apart_zyx(grid, threads)
        outer /= np.float32(grid.spacing[0])
        level = field.inner_level
    else:
        inner, level = field.sample_zyx(grid, 0, grid.shape[2], threads), field.sum_level
    if level is not None:
        inner = inner + np.float32(level)
        return inner, outer, level, DEPTH * level
    # a field of another kind has no natural end; values beyond nearly all others share one byte
    near = np.abs(inner if outer is None else inner[outer < 0.999])
    return inner, outer, 0.0, float(np.quantile(near, 0.98)) or 1.0


def _bytes(values: NDArray[Any]) -> U8:
    found: U8 = np.rint(255 * np.clip(values, 0, 1)).astype(np.uint8)
    return found
