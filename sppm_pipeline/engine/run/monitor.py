"""What a run tells while it goes; the command line shows it, by default nobody does."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


class Monitor:
    """Receives the events of a run; this one ignores them. Calls may come from several threads."""

    def stage_started(self, stage: str, number: int, total: int) -> None:
        """Stage `number`, counted from 1, of `total` begins."""

    def progress(self, stage: str, inner: bool, done: float, total: float, what: str) -> None:
        """The stage, or if `inner` a stage of a recipe that it repeats, has done so much."""

    def stage_finished(self, stage: str, seconds: float, summary: Mapping[str, Any]) -> None:
        """The stage ended well."""

    def warning(self, stage: str | None, message: str) -> None:
        """Something that does not stop the run."""

    def row_finished(self, done: int, total: int, row: Mapping[str, Any]) -> None:
        """One run of a sweep ended, well or not."""
