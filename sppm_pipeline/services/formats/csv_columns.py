"""Columns of numbers of a CSV file, by their names."""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sppm_pipeline.errors import InputError, did_you_mean
from sppm_pipeline.services.arrays import F64
from sppm_pipeline.services.formats.input_file import require_file

LARGEST_FILE = 2**33
"""Bytes; larger files are refused before they are read."""

MAX_ROWS = 5_000_000
"""Rows that are held; a file of more is refused as soon as one more has been read."""

_LONGEST_LINE = 1 << 16


def read_columns(path: Path, names: Sequence[str], *, gaps: bool = False) -> F64:
    """Numbers of named columns, (rows, len(names)); with `gaps`, a field may be empty, which makes it NaN.

    The first line names the columns, in any case; commas, semicolons, tabs or blanks separate them. An error names a
    column that is missing or there twice, or a field that is no number.
    """
    require_file(path, LARGEST_FILE)
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        number, line = 0, ""
        while not line:
            text = file.readline(_LONGEST_LINE)
            number += 1
            if not text:
                raise InputError(
                    f"{path.name} is empty", hint="its first line names the columns, for example x,y,z,value"
                )
            if len(text) == _LONGEST_LINE:
                raise InputError(
                    f"{path.name}: line {number} is longer than {_LONGEST_LINE} characters: is it a table?"
                )
            line = text.partition("#")[0].strip()
        separator = next((mark for mark in (";", "\t", ",") if mark in line), None)
        found = [word.strip().strip('"').lower() for word in (line.split(separator) if separator else line.split())]
        places = [_place(path.name, found, name) for name in names]
        converters: Any = dict.fromkeys(places, lambda text: float(text) if text.strip() else np.nan) if gaps else None
        try:
            with warnings.catch_warnings():  # of lines without data
                warnings.simplefilter("ignore")
                rows: F64 = np.loadtxt(
                    file, delimiter=separator, comments="#", usecols=places, ndmin=2, max_rows=MAX_ROWS + 1,
                    quotechar='"', converters=converters,
                )  # fmt: skip
        except (ValueError, IndexError) as error:
            raise InputError(
                f"{path.name}: {_explained(str(error), number)}", hint="fields of these columns are numbers"
            ) from error
    if not rows.size:
        raise InputError(f"{path.name} names columns, but holds no rows")
    if len(rows) > MAX_ROWS:
        raise InputError(
            f"{path.name} has more than {MAX_ROWS} rows", hint="average some of them, or make an image of them"
        )
    return rows


def _place(file: str, found: list[str], name: str) -> int:
    """The place of a column."""
    count = found.count(name.lower())
    if count == 1:
        return found.index(name.lower())
    if count:
        listed = ", ".join(word[:40] for word in found[:20])
        raise InputError(f"{file} has {count} columns {name!r}", hint=f"its columns are {listed}")
    raise InputError(f"{file} has no column {name[:40]!r}", hint=did_you_mean(name, [word[:40] for word in found]))


def _explained(message: str, above: int) -> str:
    """Numpy's message about a field, reworded; numpy counts rows from 0."""
    first = (message.splitlines() or [""])[0]
    first = re.sub(r"at row (\d+), column", lambda match: f"at row {int(match[1]) + 1}, column", first)
    return re.sub(r"at row (\d+)", rf"at row \1 below line {above}", first)[:200]
