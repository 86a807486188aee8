"""``sample.elimination``: exactly n well-spaced pores, without a requested spacing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sppm_pipeline import Sampler, option, options
from sppm_pipeline.method.families.interiors import InteriorBox
from sppm_pipeline.services.arrays import F64


@dataclass(frozen=True, kw_only=True)
class Elimination(Sampler):
    """Weighted sample elimination (Yuksel 2015): remove from many uniform candidates those with near neighbors.

    It always ends with the requested number and needs no spacing; it keeps away from face pores only through `gap`.
    """

    name: ClassVar[str] = "sample.elimination"
    sources: ClassVar[tuple[str, ...]] = (
        "C. Yuksel: Sample elimination for generating Poisson disk sample sets. Computer Graphics Forum "
        "34(2), 2015. https://doi.org/10.1111/cgf.12538",
    )
    needs_whole_cell: ClassVar[str] = "it weighs the pores of a whole cell against each other"

    count: int = options.count(note="in one interior", minimum=1)
    candidates: float = option(5.0, help="candidates thrown for each pore kept", minimum=2, maximum=100)

    def throw(self, rng: np.random.Generator, box: InteriorBox) -> F64:
        from sppm_pipeline.method.sampling.elimination import eliminate

        return eliminate(
            rng, self.count, box.lower, box.upper, periodic=(box.periodic,) * 3, oversampling=self.candidates
        )
