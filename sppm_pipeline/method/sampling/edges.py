"""Pores on the edges and corners of a cell and few enough on its faces that no place of the lattice shows.

Each of the three edges that end in the low corner has one row of *sites*, the same in every cell: the corner, and
places between it and the next corner. Neighboring sites are between one and sqrt(3) spacings apart. Whatever else keeps
one spacing from all sites then lies half a spacing or more from the edge: patterns of any colors may meet there.

An edge belongs to the cells around it, and which face patterns meet at it differs from place to place. So the pores of
an edge are part of one of them: the pattern perpendicular to axis a holds those of its border where the coordinate
a + 1 (cyclic) is zero, and that perpendicular to x also the corner. Every edge and corner of a lattice has exactly one
owner in this way, and is counted once. Each color of the owner carries pores on a selection of sites of its own; all
together use every site equally often, up to rounding. Interiors and faces keep one spacing from all sites in use.

How many pores the sites, the faces and the interior get follows from the spacing l and the number of pores v of a cell,
so that the solid share of many cells is level: a share ``1.031 (v l^3)^(1/2)`` of the sites, two thirds at 60 % of the
packing limit, and ``0.69 v l (1 - 1.5 l)^2 m^0.2`` pores on each face, which are those that a homogeneous structure has
within 0.35 l of the plane, less a strip along the edges that is left to them. They have to be more where an interior
may meet m patterns on a side, as it then keeps away from all of them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.sampling.capacity import box_capacity
from sppm_pipeline.method.sampling.cell_list import new_stream
from sppm_pipeline.method.sampling.darts import throw
from sppm_pipeline.method.sampling.faces import FILLED, face_counts, patterns_in_turn
from sppm_pipeline.method.sampling.many import faces_apart
from sppm_pipeline.services.arrays import F64, Bools, distinct

MAX_GAP = math.sqrt(3.0)
"""Widest distance of two sites, spacings: what keeps one spacing from both lies half a spacing away from the edge."""
USUAL = 1.5
"""Mean distance of two sites, spacings: between the least, 1, and the widest."""

# Fitted to the folded solid share of assemblies such as those of configs/how_random.yaml, at porosity 0.70.
OCCUPIED, ON_FACE, STRIP, MET = 1.031, 0.69, 1.5, 0.2

MAX_TOGETHER = 16
"""Colors thrown against each other; more patterns keep a margin that makes them independent."""


REJECTED, SWEEPS = 1000, 50
"""Divisions of an edge that are thrown away before intervals are drawn in pairs, and how often each is: choices."""


def intervals(spacing: float) -> int:
    """Number of intervals that the sites divide an edge into."""
    most = math.floor(1.0 / spacing + 1e-9)
    least = math.ceil(1.0 / (MAX_GAP * spacing) - 1e-9)
    return max(1, min(most, max(least, round(1.0 / (USUAL * spacing)))))


def occupied_share(total: float, spacing: float) -> float:
    """Share of the sites that carry a pore, for a number of pores of a cell and their spacing in cell sizes."""
    return min(OCCUPIED * math.sqrt(total * spacing**3), 1.0, total / 4.0 / _sites(spacing))


def _sites(spacing: float) -> float:
    """Sites of one cell on its edges and its corner."""
    return 3.0 * intervals(spacing) - 2.0


CLOSEST = 1e-2
"""Smallest spacing, cell sizes, to bound memory: edges have a site for each spacing, and a cell of this one would hold
a million pores."""


def homogeneous_counts(total: float, spacing: float, met: int = 1) -> tuple[float, float]:
    """Pores of one cell inside its three faces, and on its edges and its corner, in the mean.

    `total` are the pores of a cell, `met` the patterns that an interior may meet on one side; equations in the module.
    """
    inside = 3.0 * ON_FACE * met**MET * total * spacing * max(0.0, 1.0 - STRIP * spacing) ** 2
    # a face without any pore would part the cells on its sides
    inside = min(max(inside, 3.0), total / 2.0)
    return inside, occupied_share(total, spacing) * _sites(spacing)


def homogeneous_design(
    *, total: int | None, face_count: int | None, spacing: float | None, share: float | None, met: int = 1
) -> tuple[float, float]:
    """Number of pores of a cell and their spacing (cell sizes), from two of a number, the spacing and the share.

    `face_count` are pores on the faces, edges and corner alone, each counted once, instead of `total`; `share` is of
    the packing limit, `met` the patterns that an interior may meet on one side. Raises DesignError if no spacing below
    half a cell gives that packing.
    """

    def in_cell(l: float) -> float:  # noqa: E741 - the paper's letter
        return FILLED * box_capacity(1.0, l, periodic=True)

    def counted(pores: float, l: float) -> float:  # noqa: E741
        return pores if face_count is None else sum(homogeneous_counts(pores, l, met))

    if spacing is not None:
        spacing = max(spacing, CLOSEST)
    wanted = total if face_count is None else face_count
    if wanted == 0:
        return 0.0, 0.5 if spacing is None else spacing
    if spacing is None:
        assert wanted is not None
        assert share is not None
        low, high = CLOSEST, 0.5
        if wanted < counted(share * in_cell(high), high):
            raise DesignError(
                f"{wanted} pores at a packing share of {share:g} would need a spacing above half a cell",
                hint="give more pores, a larger share, or the spacing itself",
            )
        for _ in range(60):  # the number falls with the spacing
            middle = (low + high) / 2
            low, high = (middle, high) if counted(share * in_cell(middle), middle) > wanted else (low, middle)
        return share * in_cell(low), low
    if wanted is None:
        assert share is not None
        return share * in_cell(spacing), spacing
    low, high = 0.0, max(in_cell(spacing), 1.0)
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if counted(middle, spacing) < wanted else (low, middle)
    return (float(total) if total is not None else high), spacing


def edge_sites(rng: np.random.Generator, spacing: float) -> F64:
    """Sites of an edge from 0 to 1, (m,) float64, ascending, for a spacing in (0, 1]; the first is the corner at 0."""
    number = intervals(spacing)
    spare = 1.0 - number * spacing
    # where even equal intervals are wider than the widest, any will do: faces keep half a spacing from the border
    widest = max(MAX_GAP * spacing, 1.0 / number + 1e-9)
    for _ in range(REJECTED):
        cuts = np.sort(rng.random(number - 1))
        widths = spacing + spare * np.diff(np.concatenate([[0.0], cuts, [1.0]]))
        if widths.max() <= widest or number == 1:
            return np.concatenate([[0.0], np.cumsum(widths)[:-1]])
    # of many intervals one is nearly always too wide; then two at a time redraw their parts of the sum, uniformly
    # within the bounds, which leaves the uniform distribution over all lawful divisions as it is (Gibbs sampling)
    widths = np.full(number, 1.0 / number)
    for _ in range(SWEEPS):
        order = rng.permutation(number)
        for i, j in zip(order[: number // 2], order[number // 2 :], strict=False):
            both = widths[i] + widths[j]
            widths[i] = rng.uniform(max(spacing, both - widest), min(widest, both - spacing))
            widths[j] = both - widths[i]
    return np.concatenate([[0.0], np.cumsum(widths)[:-1]])


def chosen_sites(rng: np.random.Generator, sites: int, colors: int, share: float) -> Bools:
    """Mask (colors, sites) of the sites that carry a pore in each color: a share of all, as even as possible."""
    steps = np.floor(np.arange(sites * colors + 1) * share + rng.random())
    return rng.permuted(np.diff(steps).astype(bool).reshape(sites, colors), axis=1).T


def homogeneous_faces(
    rng: np.random.Generator,
    total: float,
    spacing: float,
    colors: tuple[int, int, int],
    *,
    face_count: int | None = None,
    met: int = 1,
    totals: Sequence[NDArray[np.integer]] | None = None,
    threads: int = 1,
) -> list[list[F64]]:
    """Throw the pores of all face patterns, with those of the edges and corners that they own.

    `total` are the pores of one cell, `colors` the numbers of patterns perpendicular to x, y, z, and `met` the patterns
    that an interior may meet on one side. `face_count` replaces the number of pores on faces, edges and corner that
    makes a cell homogeneous. With `totals`, 3 arrays (colors,), each pattern gets as many pores as a face of a cell
    with that total; sites stay those of `spacing`, in (0, 1] cell sizes. The result does not depend on the threads.

    Returns, by axis and color, (n, 3) positions in cell sizes with 0 along the pattern's axis; pores with two or three
    zeros lie on edges and corners, and come first. Raises DesignError if the faces do not hold their number of pores.
    """
    if not 0.0 < spacing < 1.0:
        raise DesignError(f"the spacing of face pores must lie in (0, 1) cell sizes, got {spacing}")
    sites = _sites_by_owner(rng, spacing)
    if totals is not None:
        return _graded(rng, total, spacing, sites, totals, met)
    share = occupied_share(total, spacing)
    # sites are chosen before pores are thrown, so that faces keep away from all that any color uses
    chosen = [chosen_sites(rng, len(places), count, share) for places, count in zip(sites, colors, strict=True)]
    # edges and corners hold what the sites give; faces get the rest of what makes the structure level
    inside = homogeneous_counts(total, spacing, met)[0]
    if face_count is not None:
        inside = face_count - sum(float(which.sum(1).mean()) for which in chosen)
    wanted = face_counts(max(0, round(inside)), max(colors))
    everywhere = distinct(np.concatenate(sites), axis=0)
    if max(colors) <= MAX_TOGETHER and len(set(colors)) == 1:
        thrown = patterns_in_turn(rng, wanted, spacing, spacing / 2 if max(colors) > 1 else 0.0, everywhere)
    else:
        streams = [np.zeros(count, np.uint64) for count in colors]
        for own, counts in zip(streams, wanted, strict=True):
            used = counts[: len(own)] > 0
            # a pattern without pores draws no number
            own[used] = new_stream(rng, int(used.sum()))
        border = spacing / math.sqrt(2.0)
        thrown = faces_apart(streams, wanted, spacing, border, obstacles=everywhere, threads=threads)
    return [
        [np.concatenate([sites[axis][which], pores]) for which, pores in zip(chosen[axis], thrown[axis], strict=True)]
        for axis in range(3)
    ]


def _graded(
    rng: np.random.Generator,
    total: float,
    spacing: float,
    sites: list[F64],
    totals: Sequence[NDArray[np.integer]],
    met: int,
) -> list[list[F64]]:
    """Patterns of cells with different numbers of pores, packed alike: each with a spacing of its own."""
    border, everywhere = spacing / math.sqrt(2.0), np.unique(np.concatenate(sites), axis=0)
    patterns = []
    for axis, counts in enumerate(totals):
        low, high = np.full(3, border), np.full(3, 1.0 - border)
        low[axis] = high[axis] = 0.0
        made = []
        for count in counts.tolist():
            own = min(spacing * (total / count) ** (1 / 3), 0.5)
            inside, on_edges = homogeneous_counts(count, own, met)
            wanted, share = math.floor(inside / 3 + rng.random()), min(1.0, on_edges / _sites(spacing))
            chosen = rng.permutation(len(sites[axis])) < math.floor(share * len(sites[axis]) + rng.random())
            thrown = throw(rng, wanted, own, low, high, obstacles=everywhere, obstacle_images=True)
            made.append(np.concatenate([sites[axis][chosen], thrown]))
        patterns.append(made)
    return patterns


def _sites_by_owner(rng: np.random.Generator, spacing: float) -> list[F64]:
    """The sites on the edges and the corner that the patterns of each axis own, (m, 3) each."""
    owned = []
    for axis in range(3):
        along = (axis + 2) % 3
        places = edge_sites(rng, spacing)[0 if axis == 0 else 1 :]
        owned.append(np.zeros((len(places), 3)))
        owned[axis][:, along] = places
    return owned
