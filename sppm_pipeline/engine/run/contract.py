"""The promises of every stage, checked while it runs: numbers in what it makes, and inputs left as they are.

Arrays of plugins' stages are looked at in every run; ``SPPM_CONTRACT=1`` (`--contract`) adds the costly checks.
"""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from sppm_pipeline.nouns.artifact import Artifact

CONTRACT = "SPPM_CONTRACT"
"""Environment variable that switches the costly checks on, for those who write plugins."""


def is_strict() -> bool:
    """True if inputs are digested before and after each stage, and results of built-in stages looked at, too."""
    return os.environ.get(CONTRACT, "") not in ("", "0")


def no_numbers(made: Any) -> str | None:
    """A NaN, an infinity or an object in the arrays and numbers of an artifact, with its place; None if there is none.

    Infinities in private fields, and in fields that no comparison looks at, are the artifact's own business.
    """
    for place, value in _parts(made, type(made).__name__):
        if isinstance(value, np.ndarray):
            # objects would need pickle, which the cache does not read
            if value.dtype.hasobject:
                return f"an array of objects, which can't be kept: {place}"
            if value.dtype.kind in "fc" and not np.isfinite(value).all():
                # the first place is found only when there is one: this is slower than the test
                bad = np.argwhere(~np.isfinite(value))
                first = f"{place}{bad[0].tolist()} is {value[tuple(bad[0])]}"
                return f"numbers that are not finite: {first} ({len(bad)} of {value.size} are not finite)"
        elif isinstance(value, float) and not math.isfinite(value):
            return f"numbers that are not finite: {place} is {value}"
    return None


def _parts(value: Any, place: str) -> Iterator[tuple[str, Any]]:
    """Arrays and numbers of artifacts, tuples and lists, with their places; tables may hold NaN where a run failed."""
    if isinstance(value, Artifact):
        for field in dataclasses.fields(value):  # type: ignore[arg-type]
            if field.compare and not field.name.startswith("_"):
                yield from _parts(getattr(value, field.name), f"{place}.{field.name}")
    elif isinstance(value, (tuple, list)):
        names: Any = getattr(value, "_fields", range(len(value)))
        for name, item in zip(names, value, strict=True):
            yield from _parts(item, f"{place}.{name}" if isinstance(name, str) else f"{place}[{name}]")
    else:
        yield place, value


def digests(inputs: Mapping[str, Any]) -> dict[str, str]:
    """The digest of each input that has one."""
    found = {}
    for port, value in inputs.items():
        if isinstance(value, Artifact):
            try:
                found[port] = value.digest()
            except (TypeError, AttributeError):  # an artifact that computes what it holds while it is read
                continue
    return found


def changed(inputs: Mapping[str, Any], before: Mapping[str, str]) -> list[str]:
    """The ports whose artifacts are not what they were."""
    return [port for port, digest in digests({name: inputs[name] for name in before}).items() if digest != before[port]]


def writable_ports(inputs: Mapping[str, Any]) -> set[str]:
    """The ports whose artifacts have an array that can be written to; to unlock one is the way to change it."""
    return {
        port
        for port, artifact in inputs.items()
        if isinstance(artifact, Artifact)
        and any(isinstance(value, np.ndarray) and value.flags.writeable for _, value in _parts(artifact, port))
    }
