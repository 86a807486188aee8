"""Argument types of compiled kernels as JSON values, and compiling a kernel for types before there is an argument.

A number is written as Numba calls it (``"int64"``), an array as ``"float32 3 C"`` with its dimensions and its order in
memory, and ``"float32 3 C readonly"`` if it can't be written to; a tuple as a list that begins with its class, which is
empty for a plain one; None as ``"none"``.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from typing import Any

from numba.core import types

KernelType = str | list[Any]
"""One argument type, as a JSON value."""


def signature_as_json(kind: types.Type) -> KernelType:
    """A Numba type as a JSON value; `ValueError` but for numbers, arrays of numbers, None, and tuples of these."""
    if isinstance(kind, types.Array):
        text = f"{signature_as_json(kind.dtype)} {kind.ndim} {kind.layout}"
        text += "" if kind.mutable else " readonly"
    elif isinstance(kind, types.BaseTuple):
        made, parts = getattr(kind, "instance_class", tuple), getattr(kind, "types", ())
        return ["" if made is tuple else f"{made.__module__}.{made.__qualname__}", *map(signature_as_json, parts)]
    else:
        text = str(kind)
    try:
        same = read(text) == kind
    except ValueError:
        same = False
    if not same:
        raise ValueError(f"kernels are not compiled ahead for {kind}")
    return text


def read(kind: KernelType) -> types.Type:
    """The Numba type of a JSON value; `ValueError` if there is no such type."""
    if isinstance(kind, list):
        module, _, name = kind[0].rpartition(".")
        made = getattr(importlib.import_module(module), name) if name else None
        joined: types.Type = types.BaseTuple.from_types(tuple(map(read, kind[1:])), made)  # type: ignore[no-untyped-call]
        return joined
    if kind == "none":
        return types.none
    name, *array = kind.split()
    number = types.boolean if name == "bool" else getattr(types, name, None)
    if not isinstance(number, types.Number | types.Boolean):
        raise ValueError(f"there is no number {name!r}")
    if not array:
        return number
    dimensions, order, *readonly = array
    made_of: Any = types.Array  # whose annotations know its orders one by one
    filled: types.Type = made_of(number, int(dimensions), order, readonly=bool(readonly))
    return filled


def compile_kernel(place: str, signatures: Sequence[Sequence[KernelType]]) -> None:
    """Compile the kernel ``package.module:name`` for the argument types of each signature, or load it from the disk."""
    module, _, name = place.partition(":")
    kernel = getattr(importlib.import_module(module), name).dispatcher
    kernel._cache.keep_from_now(kernel.overloads)
    for signature in signatures:
        kernel.compile(tuple(map(read, signature)))
