"""How many pores belong on the faces, and how far apart, when only some of the numbers are given."""

from __future__ import annotations

from sppm_pipeline.errors import DesignError
from sppm_pipeline.numerics.sampling.capacity import box_capacity, face_capacity

FILLED = 0.95
"""Pores of a cell filled up from its faces inward, as a share of those of a torus without faces (measured: .92-.97)."""


def split_between_faces_and_interior(
    *, total: int | None, face_count: int | None, spacing: float | None, share: float | None, colors: int
) -> tuple[int, float]:
    """Number of face pores of a cell and spacing, at equal packing of faces and interior.

    The interior is taken to begin half a spacing away from the faces and to keep the spacing from their pores. Two of
    the number of pores, the spacing and the share have to be given.

    Parameters
    ----------
    total : int or None
        Pores of a cell, three faces counted once each.
    face_count : int or None
        Pores on the three faces alone, instead of `total`.
    spacing : float or None
        Cell edges.
    share : float or None
        Pores as a share of the packing limit.
    colors : int
        Number of face colors.

    Returns
    -------
    face_count : int
    spacing : float
        Cell edges.

    Raises
    ------
    DesignError
        If no spacing below half a cell gives that packing.
    """

    def on_faces(l: float) -> float:  # noqa: E741 - the paper's letter
        return 3 * face_capacity(l, colors)

    def in_cell(l: float) -> float:  # noqa: E741
        return FILLED * box_capacity(1.0, l, periodic=True)

    wished = face_count if total is None else total
    if wished == 0:
        return 0, 0.5 if spacing is None else spacing
    capacity = on_faces if total is None else in_cell
    if spacing is None:
        assert wished is not None
        assert share is not None
        low, high = 1e-3, 0.5
        if wished < share * capacity(high):
            raise DesignError(
                f"{wished} pores at a packing share of {share:g} would need a spacing above half a cell",
                hint="give more pores, a larger share, or the spacing itself",
            )
        for _ in range(60):  # the capacity falls with the spacing
            middle = (low + high) / 2
            low, high = (middle, high) if share * capacity(middle) > wished else (low, middle)
        spacing = low
    elif wished is None:
        assert share is not None
        return round(share * on_faces(spacing)), spacing
    if face_count is not None:
        return face_count, spacing
    assert total is not None
    return min(total, round(total * on_faces(spacing) / in_cell(spacing))), spacing
