"""A plugin in one file: independent uniform pores without a minimum distance."""

from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline import Sampler, option


@dataclass(frozen=True, kw_only=True)
class Uniform(Sampler):
    """Throw pores independently of each other: the worst case for their spacing, and what thrown darts improve on."""

    name: ClassVar[str] = "sample.uniform"

    count: int = option(help="number of pores in a cell", minimum=1)

    def throw(self, rng, box):
        return box.lower + rng.random((self.count, 3)) * (box.upper - box.lower)
