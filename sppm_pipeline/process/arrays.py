"""Arrays on their way to the child and back: plain .npy files, checked against what was announced."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


class ArraySpec(NamedTuple):
    """What an array that the child returns has to be.

    Attributes
    ----------
    dtype : str
        Exactly this type: ``"float64"``.
    shape : tuple of int or None
        Length of each axis; None stands for any.
    """

    dtype: str
    shape: tuple[int | None, ...]

    def __str__(self) -> str:
        return f"{self.dtype} of shape ({', '.join('any' if n is None else str(n) for n in self.shape)})"

    def problem(self, array: NDArray[Any]) -> str | None:
        """What is wrong with `array`, or None."""
        fits = len(array.shape) == len(self.shape) and all(
            wanted in (None, there) for wanted, there in zip(self.shape, array.shape, strict=True)
        )
        if array.dtype != np.dtype(self.dtype) or not fits:
            return f"is {array.dtype} of shape {array.shape}, announced is {self}"
        if array.dtype.kind in "fc" and not np.isfinite(array).all():
            return f"has {int(np.count_nonzero(~np.isfinite(array)))} values that are not finite"
        return None


def write_arrays(folder: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write each array to ``<name>.npy``.

    Raises
    ------
    ValueError
        If a name is no identifier, or a value no array of numbers.
    """
    for name, array in arrays.items():
        if not name.isidentifier():
            raise ValueError(f"the name of an array must be an identifier, got {name!r}")
        if not isinstance(array, np.ndarray) or array.dtype.kind not in "biufc":
            kind = f"an array of {array.dtype}" if isinstance(array, np.ndarray) else f"a {type(array).__name__}"
            raise ValueError(f"{name!r} must be an array of numbers, got {kind}")
        np.save(folder / f"{name}.npy", array, allow_pickle=False)


def read_arrays(folder: Path, returns: Mapping[str, ArraySpec]) -> dict[str, NDArray[Any]]:
    """Read and check the announced arrays.

    Raises
    ------
    ValueError
        If one is missing, is no complete .npy file, or is not as announced.
    """
    arrays = {}
    for name, spec in returns.items():
        path = folder / f"{name}.npy"
        if not path.is_file():
            raise ValueError(f"the array {name!r} is missing")
        try:
            # mapped first: header and size of the file are compared before memory is asked for
            array = np.array(np.lib.format.open_memmap(path, mode="r")) if path.stat().st_size > 4096 else np.load(path)
        except (ValueError, OSError, EOFError) as error:
            raise ValueError(f"the array {name!r} can't be read: {error}") from None
        wrong = spec.problem(array)
        if wrong is not None:
            raise ValueError(f"the array {name!r} {wrong}")
        arrays[name] = array
    return arrays
