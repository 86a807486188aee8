"""The table of a sweep: one row a run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sppm_pipeline.errors import ConfigError
from sppm_pipeline.nouns.artifact import Artifact, escaped, shown

MAX_ROWS = 20
"""Rows that notebooks show."""


class RunFile(NamedTuple):
    """A file that a run of a sweep wrote.

    Attributes
    ----------
    path : str
        Where it lies.
    sha256 : str
        Digest of its content.
    """

    path: str
    sha256: str


@dataclass(frozen=True, eq=False)
class Table(Artifact):
    """Named columns of equal length.

    Attributes
    ----------
    columns : mapping of str to tuple
        Numbers, strings, or None where a run has no value. The columns of a sweep are ``run``, its parameters,
        ``status``, ``error``, then ``<stage id>.<number>``.
    files : mapping of str to tuple of RunFile or None
        Of a sweep, the files that its runs wrote, by the name that they have in the folder of each run.
    """

    columns: Mapping[str, tuple[Any, ...]]
    files: Mapping[str, tuple[RunFile | None, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "columns", {name: tuple(values) for name, values in self.columns.items()})
        object.__setattr__(self, "files", {name: tuple(values) for name, values in self.files.items()})

    @classmethod
    def from_arrays(cls, columns: Mapping[str, ArrayLike]) -> Table:
        """A table of columns of equal length: arrays or sequences of numbers or strings.

        Raises
        ------
        ValueError
            If the lengths differ.
        """
        table = cls({name: tuple(np.asarray(values).tolist()) for name, values in columns.items()})
        table.check()
        return table

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Each column as an array: of float with NaN where there is no number, or of str if it holds strings."""
        return {
            name: np.array(self.texts(name)) if any(isinstance(v, str) for v in values) else self.numbers(name)
            for name, values in self.columns.items()
        }

    def _repr_html_(self) -> str:
        """The first rows, as notebooks show them."""
        head = "".join(f"<th>{escaped(name)}</th>" for name in self.columns)
        rows = zip(*(values[:MAX_ROWS] for values in self.columns.values()), strict=True)
        body = "".join("<tr>" + "".join(f"<td>{escaped(shown(v))}</td>" for v in row) + "</tr>" for row in rows)
        more = f"<p>{self.rows - MAX_ROWS} more rows</p>" if self.rows > MAX_ROWS else ""
        return f"<table><tr>{head}</tr>{body}</table>{more}"

    def check(self) -> None:
        """Equal length of all columns."""
        lengths = {len(values) for values in (*self.columns.values(), *self.files.values())}
        if len(lengths) > 1:
            raise ValueError(f"columns of different lengths: {sorted(lengths)}")

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(next(iter(self.columns.values()), ()))

    def column(self, name: str) -> tuple[Any, ...]:
        """The values of a column.

        Raises
        ------
        ConfigError
            If there is none of that name.
        """
        if name not in self.columns:
            raise ConfigError(f"the table has no column {name!r}", hint="there are " + ", ".join(sorted(self.columns)))
        return self.columns[name]

    def numbers(self, name: str) -> NDArray[np.float64]:
        """The values of a column, NaN where there is no number.

        Raises
        ------
        ConfigError
            If there is no such column.
        """
        return np.array([float(v) if isinstance(v, (bool, int, float)) else np.nan for v in self.column(name)], float)

    def texts(self, name: str) -> list[str]:
        """The values of a column as strings, empty where there is nothing.

        Raises
        ------
        ConfigError
            If there is no such column.
        """
        return ["" if value is None else str(value) for value in self.column(name)]

    def order(self, name: str, *, descending: bool = False) -> list[int]:
        """Rows sorted by the numbers of a column, equal ones as they stand, those without a number last.

        Raises
        ------
        ConfigError
            If there is no such column.
        """
        values = self.numbers(name)
        return [int(i) for i in np.argsort(-values if descending else values, kind="stable")]

    def summary(self) -> dict[str, Any]:
        """Rows and names of the columns."""
        return {"rows": self.rows, "columns": list(self.columns)}


def check_columns(columns: tuple[str, ...], headings: tuple[str, ...]) -> None:
    """Raise `ConfigError` if no column is named or headings and columns do not belong together."""
    if not columns:
        raise ConfigError("`columns` names no column", hint="write for instance columns: [elastic.E.1, elastic.nu.xy]")
    if headings and len(headings) != len(columns):
        raise ConfigError(f"there are {len(headings)} headings for {len(columns)} columns", hint="give one for each")
