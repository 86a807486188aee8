"""Material cards of Abaqus and CalculiX."""

from __future__ import annotations

import numpy as np

from sppm_pipeline.services.arrays import F64

# Abaqus and CalculiX count 11, 22, 33, 12, 13, 23; these are the places in xx, yy, zz, yz, xz, xy
_VOIGT = (0, 1, 2, 5, 4, 3)


def abaqus_constants(stiffness: F64) -> list[float]:
    """The 21 constants D1111, D1122, D2222, D1133, ... D2323 of Abaqus and CalculiX, column by column.

    The stiffness (6, 6) is in Voigt order xx, yy, zz, yz, xz, xy.
    """
    ordered = stiffness[np.ix_(_VOIGT, _VOIGT)]
    return [float(ordered[row, column]) for column in range(6) for row in range(column + 1)]


def abaqus_card(name: str, stiffness: F64, comments: list[str]) -> str:
    """A ``*MATERIAL`` with ``*ELASTIC, TYPE=ANISO``, as Abaqus and CalculiX read it, below lines of comments.

    The name has letters, digits, ``_`` and ``-``, and begins with a letter.
    """
    if not (name[:1].isalpha() and name.isascii() and name.replace("_", "").replace("-", "").isalnum()):
        raise ValueError(f"a material is named by letters, digits, _ and -, got {name!r}")
    words = [f"{value:.9g}" for value in abaqus_constants(stiffness)]
    rows = [", ".join(words[start : start + 8]) for start in range(0, 21, 8)]
    return (
        "\n".join([*(f"** {line}" for line in comments), f"*MATERIAL, NAME={name}", "*ELASTIC, TYPE=ANISO", *rows])
        + "\n"
    )
