"""``tune.retry``: draw a recipe again until no check rejects it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from sppm_pipeline import Context, DesignError, Recipe, Rejected, Stage, option


@dataclass(frozen=True, kw_only=True)
class Retry(Stage):
    """Run a recipe that ends in a check, with new random numbers each time, until it is accepted.

    "Our generation method is randomized, thus capable of producing legitimate outcomes within a finite number of
    attempts" (paper, "Solid Structure Connectivity Verification").
    """

    name: ClassVar[str] = "tune.retry"
    reported: ClassVar[tuple[str, ...]] = ("attempts",)

    attempts: int = option(20, help="maximum number of draws", minimum=1, maximum=100_000)

    def run(self, context: Context, recipe: Recipe) -> Any:
        """Draw until accepted."""
        reason = ""
        for attempt in range(self.attempts):
            context.progress(attempt, self.attempts, "draws")
            try:
                made = recipe.run(context, palette=context.palette, attempt=attempt)
            except Rejected as rejection:
                reason = rejection.message
                continue
            context.report(attempts=attempt + 1)
            return made
        raise DesignError(
            f"none of {self.attempts} draws was accepted; the last one: {reason}",
            hint="raise `attempts`, lower the porosity, or remove islands instead of rejecting the cell "
            "(`check.connectivity` with `islands: remove`)",
        )
