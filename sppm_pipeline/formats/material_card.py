"""Material cards of finite element programs for an anisotropic elastic material."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Abaqus and CalculiX count 11, 22, 33, 12, 13, 23; these are the places in xx, yy, zz, yz, xz, xy
_ORDER = (0, 1, 2, 5, 4, 3)


def abaqus_constants(stiffness: NDArray[np.float64]) -> list[float]:
    """The 21 constants D1111, D1122, D2222, D1133, ... D2323 of Abaqus and CalculiX, column by column.

    Parameters
    ----------
    stiffness : (6, 6)
        Voigt order xx, yy, zz, yz, xz, xy.
    """
    ordered = stiffness[np.ix_(_ORDER, _ORDER)]
    return [float(ordered[row, column]) for column in range(6) for row in range(column + 1)]


def abaqus_card(name: str, stiffness: NDArray[np.float64], comments: list[str]) -> str:
    """A ``*MATERIAL`` with ``*ELASTIC, TYPE=ANISO``, as Abaqus and CalculiX read it.

    Parameters
    ----------
    name : str
        Letters, digits, ``_`` and ``-``; begins with a letter.
    stiffness : (6, 6)
    comments : list of str
        Lines above the card.

    Raises
    ------
    ValueError
        If the name would not be one.
    """
    if not (name[:1].isalpha() and name.isascii() and name.replace("_", "").replace("-", "").isalnum()):
        raise ValueError(f"a material is named by letters, digits, _ and -, got {name!r}")
    words = [f"{value:.9g}" for value in abaqus_constants(stiffness)]
    rows = [", ".join(words[start : start + 8]) for start in range(0, 21, 8)]
    return (
        "\n".join([*(f"** {line}" for line in comments), f"*MATERIAL, NAME={name}", "*ELASTIC, TYPE=ANISO", *rows])
        + "\n"
    )
