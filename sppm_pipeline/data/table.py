"""The table of a sweep: one row a run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sppm_pipeline.data.noun import Noun

__all__ = ["Table"]


@dataclass(frozen=True, eq=False)
class Table(Noun):
    """Named columns of equal length.

    Attributes
    ----------
    columns : mapping of str to tuple
        Numbers, texts, or None where a run has no value. The columns of a sweep are ``run``, its parameters,
        ``status``, ``error``, then ``<stage id>.<number>``.
    """

    columns: Mapping[str, tuple[Any, ...]]

    def __post_init__(self) -> None:
        object.__setattr__(self, "columns", {name: tuple(values) for name, values in self.columns.items()})

    def check(self) -> None:
        """Equal length of all columns."""
        lengths = {len(values) for values in self.columns.values()}
        if len(lengths) > 1:
            raise ValueError(f"columns of different lengths: {sorted(lengths)}")

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(next(iter(self.columns.values()), ()))

    def summary(self) -> dict[str, Any]:
        """Rows and names of the columns."""
        return {"rows": self.rows, "columns": list(self.columns)}
