"""What a stage foretells of its work without doing it: facts about its result, memory, disk and time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from sppm_pipeline.data.palette import Palette

Facts = Mapping[str, Any]
"""What is known of an artifact before it exists, by plain names that stages agree on, for instance `triangles`."""


@dataclass(frozen=True)
class Estimate:
    """Foretold costs of one stage, for one thread.

    Attributes
    ----------
    makes : Facts
        Known of the result; the stages that take it find it in `Given`.
    keeps : float
        Bytes of the result.
    memory : float
        Bytes needed beside inputs and result while the stage runs.
    disk : float
        Bytes written into the run directory.
    seconds : float
        On one core of an ordinary machine, compiled kernels there already.
    voxels : float
        Samples of a field that are evaluated.
    layers : int
    advice : str
        What makes the work smaller.
    """

    makes: Facts = field(default_factory=dict)
    keeps: float = 0.0
    memory: float = 0.0
    disk: float = 0.0
    seconds: float = 0.0
    voxels: float = 0.0
    layers: int = 0
    advice: str = ""


@dataclass(frozen=True)
class Given:
    """What a stage may foretell from.

    A fact that is missing raises `KeyError`; a stage lets it pass, and its result is then unknown, too.

    Attributes
    ----------
    palette : Palette
        How many interiors and face colors are wanted.
    ports : mapping of port to Facts or None
        None for an optional port that is left open.
    recipes : mapping of port to function of palette to Estimate
        The sum of all stages of the recipe; `makes` is that of its last stage.
    """

    palette: Palette
    ports: Mapping[str, Facts | None]
    recipes: Mapping[str, Callable[[Palette], Estimate]]

    def __getitem__(self, port: str) -> Facts:
        """The facts of a port that is wired."""
        facts = self.ports[port]
        if facts is None:
            raise KeyError(port)
        return facts
