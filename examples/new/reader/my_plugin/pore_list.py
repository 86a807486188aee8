"""``read.my_word``: pores from a list of their centers."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from sppm_pipeline import Context, InputError, Length, PoreSet, Stage, option, options
from sppm_pipeline.formats import content_of


@dataclass(frozen=True, kw_only=True)
class ReadPores(Stage):
    """Read pores from a text file with x, y and z of one center in a line, in millimeters from a corner of the cell."""

    name: ClassVar[str] = "read.my_word"

    path: Path = options.read_path(note="three numbers in a line, separated by commas")
    edge: Length = option(help="edge of the cell, in which all centers lie")

    def run(self, context: Context) -> PoreSet:
        """Every way in which a file of others can be wrong ends in an `InputError` that names it."""
        lines = content_of(self.path, 1 << 24).decode("utf-8", "replace").split("\n")
        try:
            centers = np.array([[float(x) for x in line.split(",")] for line in lines if line.strip()])
            pores = PoreSet.from_array(centers, edge=self.edge.mm())
        except ValueError as error:
            raise InputError(f"{self.path.name} is no list of pores: {error}") from error
        if not len(centers):
            raise InputError(f"{self.path.name} holds no pore")
        return pores
