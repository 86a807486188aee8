"""Face patterns: pores in the faces of a cell, the same on opposite faces, for one or more face colors (section 2.1).

Each axis a and color k has one pattern in the plane where the coordinate a is 0; the opposite face at 1 carries the
same one. A pattern keeps the spacing against itself, periodically in its plane, and against the patterns of the two
other axes in every color and every image, because any of them may be a neighbor at a cell edge. Two colors of one
axis never lie on the same face, so they ignore each other; they may be neighbors across an edge of the face, which a
margin of half a spacing along the border makes safe.

The patterns are thrown in turn: in each round every pattern gets one pore, in an order drawn afresh. Thrown one after
another, the first pattern would take the room along the shared edges and the last would shrink from them: the three
faces of a cell would follow different laws (44 to 34 pores in the first and the last of three saturated faces at
l = 1/8). In turn, all patterns with equal counts follow the same law, and the saturated total is the same within 2 %.
"""

from __future__ import annotations

import math

import numpy as np

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.sampling.active_voxels import fill_active_voxels, throw_darts
from sppm_pipeline.method.sampling.capacity import box_capacity, check_capacity, face_capacity
from sppm_pipeline.method.sampling.cell_list import (
    CellList,
    add_points,
    empty_cell_list,
    new_stream,
    next_uniform,
)
from sppm_pipeline.services.arrays import F64, I64, U64
from sppm_pipeline.services.jit.compiled import jit

FILLED = 0.95
"""Pores of a cell filled up from its faces inward, as a share of those of a torus without faces (measured:
0.92-0.97)."""


def split_between_faces_and_interior(
    *, total: int | None, face_count: int | None, spacing: float | None, share: float | None, colors: int
) -> tuple[int, float]:
    """Number of face pores of a cell and spacing (cell sizes), at equal packing of faces and interior.

    The interior is taken to begin half a spacing away from the faces and to keep the spacing from their pores. Two of
    the number of pores, the spacing and the share of the packing limit have to be given; the number is `total`, three
    faces counted once each, or `face_count`, on the faces alone. Raises DesignError if no spacing below half a cell
    gives that packing.
    """

    def on_faces(l: float) -> float:  # noqa: E741 - the paper's letter
        return 3 * face_capacity(l, colors)

    def in_cell(l: float) -> float:  # noqa: E741
        return FILLED * box_capacity(1.0, l, periodic=True)

    requested = face_count if total is None else total
    if requested == 0:
        return 0, 0.5 if spacing is None else spacing
    capacity = on_faces if total is None else in_cell
    if spacing is None:
        assert requested is not None
        assert share is not None
        low, high = 1e-3, 0.5
        if requested < share * capacity(high):
            raise DesignError(
                f"{requested} pores at a packing share of {share:g} would need a spacing above half a cell",
                hint="give more pores, a larger share, or the spacing itself",
            )
        for _ in range(60):  # the capacity falls with the spacing
            middle = (low + high) / 2
            low, high = (middle, high) if share * capacity(middle) > requested else (low, middle)
        spacing = low
    elif requested is None:
        assert share is not None
        return round(share * on_faces(spacing)), spacing
    if face_count is not None:
        return face_count, spacing
    assert total is not None
    return min(total, round(total * on_faces(spacing) / in_cell(spacing))), spacing


# Darts a pore before a list of active voxels is made for it; both ways are exact, this only balances their cost.
_DARTS = 150
_ATTEMPTS = 20


def face_counts(total: int, colors: int) -> I64:
    """Pores of each pattern, (3, colors), when the three faces of a cell share `total` pores as evenly as possible.

    Where the total is no multiple of three, the axes that get one pore more rotate with the color. A cell whose faces
    have one color holds exactly `total`; with mixed colors it may hold up to two pores more or fewer.
    """
    axis, color = np.arange(3)[:, None], np.arange(colors)[None, :]
    return (total // 3 + ((axis - color) % 3 < total % 3)).astype(np.int64)


@jit
def throw_in_turn(cells: CellList, stream: U64, margin: float, wanted: I64) -> I64:
    """Throw the patterns pore by pore; return how many of the `wanted` (3, colors) pores each one got.

    A pattern that is full before its count is reached gives up; the others go on, so that the best count is known.
    """
    axes, colors = wanted.shape
    patterns = axes * colors
    placed = np.zeros((axes, colors), dtype=np.int64)
    full = np.zeros((axes, colors), dtype=np.bool_)
    order = np.arange(patterns)
    lower, side = np.empty(3), np.empty(3)
    one, darts = np.int64(1), np.int64(_DARTS)  # typed: literals would compile a second version of the kernels
    thrown = True
    while thrown:
        thrown = False
        # Fisher-Yates shuffle, in each round
        for last in range(patterns - 1, 0, -1):
            other = min(int(next_uniform(stream) * (last + 1)), last)
            held = order[last]
            order[last] = order[other]
            order[other] = held
        for turn in range(patterns):
            axis, color = order[turn] // colors, order[turn] % colors
            if full[axis, color] or placed[axis, color] == wanted[axis, color]:
                continue
            for i in range(3):
                lower[i] = margin
                side[i] = 1.0 - 2.0 * margin
            lower[axis] = 0.0
            side[axis] = 0.0
            got = throw_darts(cells, stream, lower, side, one, darts, axis, color)
            if got == 0:
                got = fill_active_voxels(cells, stream, lower, side, one, axis, color)
            if got == 0:
                full[axis, color] = True
            placed[axis, color] += got
            thrown = True
    return placed


def mirrored_faces(
    rng: np.random.Generator, total: int, spacing: float, colors: int = 1, margin: float | None = None
) -> list[list[F64]]:
    """Throw the pore patterns of the faces of a cell, or of a set of cells with colored faces.

    The three faces of a cell get `total` pores, spread by `face_counts`, and patterns keep `margin` < 1/2 from the
    border of the face: by default 0 for one color, where the pattern repeats in its plane, and half the spacing for
    several, the least that keeps faces of different colors apart. One 64-bit number is drawn from `rng`.

    Returns, by axis and color, (count, 3) positions in cell sizes with 0 along the pattern's axis. Raises DesignError
    if the spacing leaves no face, or a face does not hold its pores.
    """
    if not 0.0 < spacing <= 1.0:
        raise DesignError(f"the spacing of face pores must lie in (0, 1] cell sizes, got {spacing}")
    border = (0.0 if colors == 1 else spacing / 2.0) if margin is None else margin
    if border >= 0.5:
        raise DesignError(
            f"with {colors} face colors the face pores keep {border:.4g} from the border, which leaves no face",
            hint="choose a spacing below 1 cell size",
        )
    wanted = face_counts(total, colors)
    edge = 1.0 - 2.0 * border
    check_capacity(int(wanted.max()), spacing, (edge, edge), periodic=True, what="face of a cell")
    return patterns_in_turn(rng, wanted, spacing, border, np.zeros((0, 3)))


def patterns_in_turn(
    rng: np.random.Generator, wanted: I64, spacing: float, margin: float, sites: F64
) -> list[list[F64]]:
    """Patterns of `wanted` (3, colors) pores, clear of `sites` (k, 3) and of the patterns of the two other axes.

    All are thrown again when one is full; the DesignError after some attempts has the best total.
    """
    stream, rows, first = new_stream(rng), int(wanted.sum()), len(sites)
    best = throws = 0
    # as in `throw`: beyond five standard deviations more attempts are futile
    while throws < _ATTEMPTS and (not throws or rows - best <= 1.5 * math.sqrt(rows)):
        throws += 1
        cells = empty_cell_list(rows + first, spacing, np.zeros(3), np.ones(3), (True, True, True))
        add_points(cells, sites, -1, 0)
        placed = int(throw_in_turn(cells, stream, margin, wanted).sum())
        if placed == rows:
            found, family, member = (a[first : first + rows] for a in (cells.points, cells.family, cells.member))
            return [[found[(family == axis) & (member == k)] for k in range(wanted.shape[1])] for axis in range(3)]
        best = max(best, placed)
    per_face = best / wanted.size
    raise DesignError(
        f"only {best} of {rows} face pores fit with a spacing of {spacing:.6g} ({wanted.shape[1]} colors, "
        f"{throws} throws, each until no free spot was left): about {per_face:.1f} on each face"
        + (", beside those of the edges" if first else ""),
        hint=f"ask for at most {math.floor(0.95 * per_face)} pores a face, or for a spacing of about "
        f"{0.97 * spacing * math.sqrt(best / rows):.4g} (cell sizes)"
        + (", or take `faces_margin: paper`" if first else ""),
    )
