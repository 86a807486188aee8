"""The JSON part of a glTF file, read within bounds; every value is checked where it is taken."""

from __future__ import annotations

import json
import math
from typing import Any, NoReturn

from sppm_pipeline.errors import InputError

_LARGEST, _MOST_VALUES = 2**24, 2**20


def read_document(text: bytes, name: str) -> Entry:
    """Read the JSON part of a file.

    Raises
    ------
    InputError
        If it is no JSON object, or a very large one.
    """
    values = text.count(b",") + text.count(b"[") + text.count(b"{")
    if len(text) > _LARGEST or values > _MOST_VALUES:
        raise InputError(
            f"{name}: its JSON has {len(text)} bytes and about {values} values; read are up to {_LARGEST} and "
            f"{_MOST_VALUES}",
            hint="export fewer objects: join them to one mesh",
        )
    try:
        document = json.loads(text.decode("utf-8"), parse_constant=_no_number)
    except RecursionError as error:
        raise InputError(f"{name}: its JSON is nested too deep") from error
    except ValueError as error:
        raise InputError(
            f"{name}: its JSON cannot be read: {str(error)[:100]}", hint="the file is damaged: export it again"
        ) from error
    if not isinstance(document, dict):
        raise InputError(f"{name}: its JSON is no object")
    return Entry(document, name, "")


def _no_number(word: str) -> NoReturn:
    raise ValueError(f"{word} is no number")


class Entry:
    """An object of the document, which knows where it stands.

    Parameters
    ----------
    values : dict
    name : str
        How to call the file in messages.
    where : str
        ``accessor 3``; empty for the document itself.
    """

    def __init__(self, values: dict[str, Any], name: str, where: str) -> None:
        self._values = values
        self._name = name
        self.where = where

    def __contains__(self, key: str) -> bool:
        return key in self._values

    def fail(self, message: str, hint: str | None = None) -> NoReturn:
        """Raise the InputError for this place."""
        where = f"{self.where}: " if self.where else ""
        raise InputError(f"{self._name}: {where}{message}", hint=hint)

    def whole(self, key: str, default: int | None = None) -> int:
        """A whole number >= 0; required without a default."""
        value = self._values.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int) or value < 0:
            self._refuse(key, value, "a whole number >= 0")
        return value

    def numbers(self, key: str, count: int | None) -> list[float] | None:
        """Finite numbers, as many as `count` says; None if there are none."""
        if key not in self._values:
            return None
        value = self._values[key]
        wanted = "finite numbers" if count is None else f"{count} finite numbers"
        if not isinstance(value, list) or (count is not None and len(value) != count):
            self._refuse(key, value, wanted)
        for number in value:
            if isinstance(number, bool) or not isinstance(number, (int, float)) or not _finite(number):
                self._refuse(key, value, wanted)
        return [float(number) for number in value]

    def wholes(self, key: str) -> list[int]:
        """Whole numbers >= 0, perhaps none."""
        value = self._values.get(key, [])
        if not isinstance(value, list) or any(isinstance(v, bool) or not isinstance(v, int) or v < 0 for v in value):
            self._refuse(key, value, "a list of whole numbers >= 0")
        return value

    def words(self, key: str) -> list[str]:
        """Words, perhaps none."""
        value = self._values.get(key, [])
        if not isinstance(value, list) or not all(isinstance(word, str) for word in value):
            self._refuse(key, value, "a list of words")
        return value

    def word(self, key: str) -> str:
        """A word; empty if there is none."""
        value = self._values.get(key, "")
        if not isinstance(value, str):
            self._refuse(key, value, "a word")
        return value

    def entry(self, key: str) -> Entry:
        """An object inside this one; without values if there is none."""
        value = self._values.get(key, {})
        if not isinstance(value, dict):
            self._refuse(key, value, "an object")
        return Entry(value, self._name, f"{self.where} {key}".lstrip())

    def entries(self, key: str) -> list[Entry]:
        """Objects in a list, perhaps none."""
        value = self._values.get(key, [])
        if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
            self._refuse(key, value, "a list of objects")
        place = f"{self.where} {key}".lstrip()
        return [Entry(item, self._name, f"{place}[{k}]") for k, item in enumerate(value)]

    def flag(self, key: str) -> bool:
        """True or false; false if it is not given."""
        value = self._values.get(key, False)
        if not isinstance(value, bool):
            self._refuse(key, value, "true or false")
        return value

    def _refuse(self, key: str, value: object, wanted: str) -> NoReturn:
        self.fail(f"{key!r} must be {wanted}, not {repr(value)[:60]}" if key in self else f"{key!r} is missing")


def _finite(number: int | float) -> bool:
    try:
        return math.isfinite(number)
    except OverflowError:
        return False
