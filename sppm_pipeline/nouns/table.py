"""The table of a sweep: one row a run."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sppm_pipeline.errors import ConfigError, did_you_mean
from sppm_pipeline.nouns.artifact import Artifact, escaped, optional_module, shown

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
    units : mapping of str to str
        Units of columns, as far as they are known.
    """

    columns: Mapping[str, tuple[Any, ...]]
    files: Mapping[str, tuple[RunFile | None, ...]] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict, compare=False, repr=False)  # no part of the value

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

    def to_pandas(self) -> Any:
        """A `pandas.DataFrame` with the columns as they are: seeds are integers, and NaN stands for no number.

        Units are in ``attrs["units"]`` of the frame, by column.

        Raises
        ------
        ResourceError
            If pandas is not installed.
        """
        frame = optional_module("pandas").DataFrame({name: list(values) for name, values in self.columns.items()})
        frame.attrs["units"] = dict(self.units)
        return frame

    def to_xarray(self) -> Any:
        """An `xarray.Dataset` over the runs, in which what was counted from 1 is an array again.

        ``elastic.C.1.1`` to ``elastic.C.6.6`` are the variable ``elastic.C``, of the shape (run, 6, 6). The name of the
        run, parameters and the seed are coordinates of ``run``; units are in ``attrs["units"]`` of each variable.

        Raises
        ------
        ResourceError
            If xarray is not installed.
        """
        xarray = optional_module("xarray")
        variables: dict[str, Any] = {}
        coordinates: dict[str, Any] = {}
        before_status = True
        for name, members in self._arrays().items():
            columns = [self.columns[member] for member in members]
            if not all(isinstance(value, (bool, int, float, type(None))) for column in columns for value in column):
                found = np.array(self.texts(members[0]))
            elif all(type(value) is int for column in columns for value in column):
                found = np.array(columns, np.int64).T
            else:
                found = np.array([self.numbers(member) for member in members]).T
            before_status &= name != "status"
            shape = _shape_of(members, name)
            values = found.reshape(self.rows, *shape) if shape else found.reshape(self.rows)
            dims = ("run", *(f"{'ijkl'[k]}{size}" for k, size in enumerate(shape)))
            unit = self.units.get(members[0])
            into = coordinates if before_status else variables
            into[name] = (dims, values, {"units": unit} if unit else {})
        return xarray.Dataset(variables, coordinates)

    def _arrays(self) -> dict[str, list[str]]:
        """Columns by the array that they are the entries of, in order; a column that is none is an array of its own."""
        groups: dict[str, list[str]] = {}
        for name in self.columns:
            groups.setdefault(_INDEX.sub("", name), []).append(name)
        found: dict[str, list[str]] = {}
        for base, members in groups.items():
            whole = len(members) == math.prod(_shape_of(members, base)) and base not in members
            # of an array that lacks entries, each stands for itself
            found |= {base: members} if whole and len(members) > 1 else {name: [name] for name in members}
        return found

    def __len__(self) -> int:
        return self.rows

    def __getitem__(self, name: str) -> tuple[Any, ...]:
        return self.column(name)

    def __iter__(self) -> Iterator[str]:
        """The names of the columns."""
        return iter(self.columns)

    def __repr__(self) -> str:
        return f"<Table of {self.rows} rows: {', '.join(self.columns)}>"

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
            raise ConfigError(f"the table has no column {name!r}", hint=did_you_mean(name, self.columns))
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


_INDEX = re.compile(r"(\.[1-9][0-9]*)+$")


def _shape_of(members: list[str], base: str) -> tuple[int, ...]:
    """The shape of the array whose entries these columns are: the largest index along each axis."""
    places = [[int(part) for part in name[len(base) :].split(".")[1:]] for name in members]
    return tuple(map(max, zip(*places, strict=True))) if len({len(place) for place in places}) == 1 else (0,)


def check_columns(columns: tuple[str, ...], headings: tuple[str, ...]) -> None:
    """Raise `ConfigError` if no column is named or headings and columns do not belong together."""
    if not columns:
        raise ConfigError("`columns` names no column", hint="write for instance columns: [elastic.E.1, elastic.nu.xy]")
    if headings and len(headings) != len(columns):
        raise ConfigError(f"there are {len(headings)} headings for {len(columns)} columns", hint="give one for each")
