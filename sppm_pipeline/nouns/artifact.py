"""Base of all artifacts: read-only arrays, a digest of their content, a summary for the run record."""

from __future__ import annotations

import base64
import hashlib
import html
import importlib
import io
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import ResourceError, did_you_mean
from sppm_pipeline.nouns.viewers import viewer_of

if TYPE_CHECKING:
    from sppm_pipeline.nouns.report import Box, Chart


def frozen(array: NDArray[Any]) -> NDArray[Any]:
    """A read-only, C-contiguous version of `array`; copies only if the data could still be written to."""
    array = np.ascontiguousarray(array)
    if array.flags.writeable:
        # a view can still be written to through its base
        if array.base is not None or not array.flags.owndata:
            array = array.copy()
        array.setflags(write=False)
    return array


def in_rows(array: NDArray[Any], width: int, what: str) -> NDArray[Any]:
    """`array` if it has the shape (n, width); an empty one as (0, width).

    Another shape is a `ValueError`: a transposed array would otherwise be taken apart in the wrong places.
    """
    if array.ndim == 2 and array.shape[1] == width:
        return array
    if array.size == 0:
        return np.zeros((0, width), array.dtype)
    raise ValueError(f"{what} have the shape {array.shape}, expected (n, {width}), a row for each")


def whole_numbers(values: Any, dtype: Any, what: str) -> NDArray[Any]:
    """`values` as integers of a type; `ValueError` if they are no whole numbers, which would be cut off silently, or
    too large for the type.
    """
    array = np.asarray(values)
    if array.size == 0:
        return array.astype(dtype)
    # booleans, complex numbers and strings count nothing
    if array.dtype.kind not in "iuf":
        raise ValueError(f"{what} are whole numbers, got {array.dtype}")
    if array.dtype.kind == "f" and (odd := array != np.floor(array)).any():
        raise ValueError(f"{what} are whole numbers, got {array[odd][0]}")
    if not np.can_cast(array.dtype, dtype):
        bounds = np.iinfo(dtype)
        if int(array.min()) < bounds.min or int(array.max()) > bounds.max:
            raise ValueError(f"{what} are {np.dtype(dtype)}, got {array.min()} to {array.max()}")
    return array.astype(dtype, copy=False)


def twin_rows(*columns: NDArray[Any]) -> tuple[int, int] | None:
    """Two rows that are equal in all columns, one number of 8 bytes each; None if all rows differ.

    Rows are sorted by a hash of theirs, which takes a tenth of the time of sorting rows, and only if two hashes are
    equal the rows are compared.
    """
    return twin_rows_of(len(columns[0]), lambda some: [column[some] for column in columns], max(len(columns[0]), 1))


def twin_rows_of(number: int, columns: Callable[[slice], Sequence[NDArray[Any]]], some: int) -> tuple[int, int] | None:
    """`twin_rows` of columns that are worked out for `some` rows at a time; their hashes alone are kept."""
    mixed = np.zeros(number, np.uint64)
    for start in range(0, number, some):
        rows = slice(start, start + some)
        part = mixed[rows]
        for column in columns(rows):
            part ^= np.ascontiguousarray(column).view(np.uint64)
            part *= np.uint64(0x9E3779B97F4A7C15)  # 2^64 over the golden ratio, as Fibonacci hashing has it
            part ^= part >> np.uint64(29)
    # equal rows have equal hashes, and stand side by side then
    mixed.sort()
    if not (mixed[1:] == mixed[:-1]).any():
        return None
    every = columns(slice(0, number))
    by_row = np.lexsort(every)
    # two hashes may be equal by chance: the rows themselves decide
    same = np.ones(max(len(by_row) - 1, 0), bool)
    for column in every:
        same &= column[by_row][1:] == column[by_row][:-1]
    if not same.any():
        return None
    at = int(np.argmax(same))
    first, second = sorted((int(by_row[at]), int(by_row[at + 1])))
    return first, second


class Artifact:
    """Base of everything a stage may make. Subclasses are frozen dataclasses.

    Attributes
    ----------
    reported : tuple of str or None
        Places of the numbers that its summary may hold, as columns of sweeps are named: ``"porosity"``, ``"nu.xy"``;
        ``"C.#6.#6"`` for the entries of a list of six lists of six numbers, ``"solver.*"`` for whatever `solver` holds.
        None if they are not known. Subclasses state their own.
    """

    reported: ClassVar[tuple[str, ...] | None] = None

    def summary(self) -> dict[str, Any]:
        """Numbers that describe the artifact, JSON-ready, under plain names; they go into the run record."""
        return {}

    def check(self) -> None:
        """Raise `ValueError` if the parts contradict each other; the engine calls it on every result."""

    def attribute(self, fault: Callable[[str], Exception]) -> None:
        """Keep what makes an error that names stage and plugin, if what the artifact holds is computed when it is read.

        The engine calls it on every result of a plugin.
        """

    def digest(self) -> str:
        """SHA-256 of the artifact's public fields: type, names, array dtypes, shapes and bytes."""
        h = hashlib.sha256()
        _feed(h, self)
        return h.hexdigest()

    def __init_subclass__(cls) -> None:
        """Keep `__repr__` short: the one that `dataclass` would write prints whole arrays."""
        super().__init_subclass__()
        if "__repr__" not in vars(cls):
            setattr(cls, "__repr__", Artifact.__repr__)  # noqa: B010 - assigned for a reason that types can't follow

    if not TYPE_CHECKING:  # for which any name would be known then

        def __getattr__(self, name: str) -> Any:
            """An error that says what is known; attributes that are there never come here."""
            if hasattr(type(self), name):  # a property that has raised this error itself
                return object.__getattribute__(self, name)
            message = f"a {type(self).__name__} has no {name!r}"
            if name[0] != "_":
                known = [one for one in dir(self) if one[0] != "_"]
                more = ", ".join(f"{one}()" for one in known if one.startswith("to_") or one == "summary")
                message += f"; {did_you_mean(name, known)} (see also {more})"
            raise AttributeError(message)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """What `to_numpy` makes, for NumPy's functions; `TypeError` of what is no array."""
        make = getattr(self, "to_numpy", None)
        if make is None:
            # NumPy would make an array of one object
            raise TypeError(f"a {type(self).__name__} is no array")
        return np.array(make(), dtype, copy=copy)

    def __repr__(self) -> str:
        names: list[str] = [f.name for f in fields(self) if f.repr] if is_dataclass(self) else []
        parts = [f"{name}={_brief(getattr(self, name))}" for name in names]
        return f"{type(self).__name__}({', '.join(parts)})"

    def picture(self) -> NDArray[np.uint8] | None:
        """Picture for notebooks, (height, width, 3) uint8; None for types without one."""
        return None

    @classmethod
    def report_boxes(cls, summary: Mapping[str, Any], stage: str) -> Sequence[Box]:
        """Numbers at the top of a report, from a recorded summary; `stage` is the id of the stage that made it."""
        return ()

    @classmethod
    def report_charts(cls, summary: Mapping[str, Any]) -> Sequence[Chart]:
        """Charts of a report, from a recorded summary."""
        return ()

    def _repr_png_(self) -> bytes | None:
        """A picture, as notebooks show it; None for what has none."""
        viewer = viewer_of(type(self))
        if viewer is not None and viewer.picture:
            return cast("bytes | None", viewer.maker("picture")(self))
        picture = self.picture()
        return None if picture is None else png_of(picture)

    def _picture_html(self) -> str:
        """The picture, or what moves in its place, for notebooks; empty for what has none."""
        viewer = viewer_of(type(self))
        if viewer is not None and viewer.frame and (frame := viewer.maker("frame")(self)):
            return str(frame)
        png = self._repr_png_()
        return f'<img src="data:image/png;base64,{base64.b64encode(png).decode()}">' if png else ""

    def _repr_html_(self) -> str:
        """Picture and summary, as notebooks show them."""
        table = f"<table><caption>{escaped(type(self).__name__)}</caption>{_rows(self.summary())}</table>"
        return self._picture_html() + table


class Surface(NamedTuple):
    """Triangles that stand for an artifact in a live view.

    Attributes
    ----------
    vertices : (n, 3) float
    faces : (m, 3) int
    title : str
        What they are.
    unit : str
        Of the coordinates, such as "mm".
    still : (n, 3) float, optional
        Where the vertices were before they moved; a live view then has a slider of what they move.
    magnified : float
        Factor of these displacements in `vertices`.
    """

    vertices: NDArray[np.floating[Any]]
    faces: NDArray[np.integer[Any]]
    title: str
    unit: str
    still: NDArray[np.floating[Any]] | None = None
    magnified: float = 1.0


class Viewable(Artifact, ABC):
    """Base of artifacts that a live view shows as a surface: ``write.view`` and reports take them.

    What can't be shown as triangles has a viewer of its own, see `sppm_live_views`.
    """

    @abstractmethod
    def live_view(self) -> Surface:
        """The triangles that stand for it."""


def _brief(value: Any) -> str:
    """A field of an artifact: arrays by type and shape, other artifacts whole if they are short, else by name."""
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{list(value.shape)}"
    if isinstance(value, (bool, int, float, str, type(None))) or is_dataclass(value):
        text = repr(value) if not is_dataclass(value) or isinstance(value, Artifact) else ""
        return text if text and (len(text) <= MAX_BRIEF or isinstance(value, str)) else f"{type(value).__name__}(...)"
    return repr(value) if isinstance(value, tuple) and len(value) <= 3 and not hasattr(value, "_fields") else "..."


MAX_BRIEF = 100
"""Characters of an artifact within another one."""


def _rows(summary: dict[str, Any]) -> str:
    return "".join(f"<tr><th>{escaped(str(name))}</th><td>{_cell(value)}</td></tr>" for name, value in summary.items())


def _cell(value: Any) -> str:
    """A value of a summary; a small matrix as a table of its own."""
    array = value if isinstance(value, np.ndarray) else None
    if array is None or array.ndim != 2 or max(array.shape) > 6:
        return escaped(shown(value))
    rows = ("".join(f"<td>{escaped(shown(v))}</td>" for v in row) for row in array.tolist())
    return "<table>" + "".join(f"<tr>{row}</tr>" for row in rows) + "</table>"


MAX_SHOWN = 200
"""Characters of a value that notebooks show."""


def shown(value: Any) -> str:
    """A value of a summary for people: numbers to six digits, long lists cut."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    # before numbers, as a bool is an int
    if isinstance(value, bool) or value is None:
        return str(value)
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, dict):
        text = ", ".join(f"{key}: {shown(item)}" for key, item in value.items())
    elif isinstance(value, (list, tuple)):
        text = f"[{', '.join(shown(item) for item in value)}]"
    else:
        text = str(value)
    return text if len(text) <= MAX_SHOWN else f"{text[: MAX_SHOWN - 3]}..."


def escaped(text: str, most: int = 400) -> str:
    """A name or value as HTML shows it, cut if it is very long."""
    # cut first, so that no entity is cut in two
    return html.escape(text[:most])


NOTEBOOK_SIZE: tuple[int, int] = (320, 260)
"""Width and height of pictures in notebooks."""


def png_of(picture: NDArray[np.uint8]) -> bytes:
    """A picture (height, width, 3) as a PNG file."""
    from PIL import Image

    data = io.BytesIO()
    Image.fromarray(picture).save(data, "PNG", optimize=True)
    return data.getvalue()


def optional_module(name: str) -> Any:
    """A library that is used only where it is installed; `ResourceError` if it is not."""
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        library = (error.name or name).partition(".")[0]
        raise ResourceError(f"this needs {library}, which is not installed", hint=f"pip install {library}") from error


def _feed(h: Any, value: Any) -> None:
    """Hash `value` with its type and length in front, so that different structures can't collide by concatenation."""
    record = isinstance(value, tuple) and hasattr(value, "_fields")
    if record or (is_dataclass(value) and not isinstance(value, type)):
        # fields with `compare=False` are caches, and no part of the value
        names = _given(value) if record else [f.name for f in fields(value) if f.compare]
        h.update(f"{type(value).__name__}{len(names)};".encode())
        for name in names:
            h.update(f"{name}=".encode())
            _feed(h, getattr(value, name))
    elif isinstance(value, np.ndarray):
        # `dtype.str` names the byte order, on which the bytes depend
        h.update(f"array{value.dtype.str}{value.shape};".encode())
        h.update(np.ascontiguousarray(value).data)
    elif isinstance(value, (tuple, list)):
        h.update(f"sequence{len(value)};".encode())
        for item in value:
            _feed(h, item)
    elif isinstance(value, dict):
        h.update(f"map{len(value)};".encode())
        # by their text, since keys of different types do not compare
        for key in sorted(value, key=repr):
            _feed(h, key)
            _feed(h, value[key])
    elif value is None or isinstance(value, (bool, int, float, str)):
        h.update(f"{type(value).__name__}:{value!r};".encode())
    elif isinstance(value, np.generic):
        _feed(h, value.item())
    else:
        raise TypeError(f"{type(value).__name__} has no digest")


def _given(record: Any) -> list[str]:
    """Names of the fields of a named tuple, without those that are None if left out: absent ones change no digest."""
    return [n for n in record._fields if getattr(record, n) is not None or record._field_defaults.get(n, 0) is not None]
