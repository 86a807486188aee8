"""How many layouts a tiling rule allows: a measure of the stochasticity that the rule leaves."""

from __future__ import annotations

import math

from sppm_pipeline.numerics.tiling.lattice import check_count

#: Rules that `layout_count_log` knows.
RULES = ("opposite_equal", "free_faces", "corners")


def layout_count_log(
    cells: tuple[int, int, int], rule: str, colors: int, interiors: int = 1, *, periodic: bool = False
) -> float:
    """Natural logarithm of the number of layouts of a full box of cells.

    * ``opposite_equal``: the paper's tile set under Rule 1. Every row of cells along an axis has one color, so a box
      has ``c^(ny nz + nz nx + nx ny)`` layouts, ``3^(3 N^2)`` for N^3 cells and three colors: the exponent grows with
      the surface, and the entropy of a cell falls to zero as 1 / N. Rule 2 chooses among these layouts, it adds none.
    * ``free_faces``: every lattice face has a color of its own.
    * ``corners``: every lattice corner has one.

    Each cell also has one of `interiors` interiors, independent of its borders.

    Parameters
    ----------
    cells : (nx, ny, nz)
        Size of the box.
    rule : str
        One of `RULES`.
    colors : int
        Number of face or corner colors c.
    interiors : int
        Number of interiors K that a cell may have for given colors.
    periodic : bool
        Whether opposite ends of the box are the same planes.

    Returns
    -------
    float
        ln of the number of layouts.

    Raises
    ------
    DesignError
        If `colors` or `interiors` is below 1.
    ValueError
        If the rule is unknown.
    """
    check_count("colors", colors)
    check_count("interiors", interiors)
    nx, ny, nz = cells
    end = 0 if periodic else 1
    if rule == "opposite_equal":
        colored = ny * nz + nz * nx + nx * ny
    elif rule == "free_faces":
        colored = (nx + end) * ny * nz + nx * (ny + end) * nz + nx * ny * (nz + end)
    elif rule == "corners":
        colored = (nx + end) * (ny + end) * (nz + end)
    else:
        raise ValueError(f"unknown rule {rule!r}, known are {', '.join(RULES)}")
    return colored * math.log(colors) + nx * ny * nz * math.log(interiors)


def entropy_per_cell(
    cells: tuple[int, int, int], rule: str, colors: int, interiors: int = 1, *, periodic: bool = False
) -> float:
    """Bits of choice per cell: the binary logarithm of the number of layouts, divided by the number of cells.

    Parameters, rules and errors are those of `layout_count_log`. For large boxes it tends to log2(K) plus 0 for
    ``opposite_equal``, 3 log2(c) for ``free_faces``, log2(c) for ``corners``.
    """
    nats = layout_count_log(cells, rule, colors, interiors, periodic=periodic)
    return nats / math.log(2.0) / (cells[0] * cells[1] * cells[2])
