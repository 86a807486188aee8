"""``check.my_word``: pores that only one tunnel reaches."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sppm_pipeline import Context, Headline, Rejected, Stage, TunnelGraph, option


@dataclass(frozen=True, kw_only=True)
class CheckDeadEnds(Stage):
    """Count pores with one tunnel, through which nothing flows; reject a design with too many, which is drawn again."""

    name: ClassVar[str] = "check.my_word"
    reported: ClassVar[tuple[str, ...]] = ("dead_ends", "share")  # so that a wrong column is refused before a sweep
    headline: ClassVar[tuple[Headline, ...]] = (Headline("dead_ends", "dead ends"), Headline("share"))

    maximum: float = option(1.0, help="largest share of the pores that is accepted", minimum=0, maximum=1)

    def run(self, context: Context, graph: TunnelGraph) -> None:
        """Count the tunnels at each pore."""
        degrees = np.bincount(graph.edges.ravel(), minlength=len(graph.pores.centers))
        count = int((degrees == 1).sum())
        share = count / len(degrees)
        context.report(dead_ends=count, share=share)
        if share > self.maximum:
            raise Rejected(f"{100 * share:g} % of the pores are dead ends; accepted are {100 * self.maximum:g} %")
