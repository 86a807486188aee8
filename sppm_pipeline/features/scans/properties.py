"""Stiffness and permeability of images, by the stages that anybody runs."""

from __future__ import annotations

from typing import Any, cast

import numpy as np

from sppm_pipeline import Context, Voxels
from sppm_pipeline.engine.api.registering import registry
from sppm_pipeline.errors import DesignError


class _Silent:
    """A context whose warnings and numbers go nowhere."""

    def __init__(self, context: Context) -> None:
        self._context = context

    def __getattr__(self, name: str) -> Any:
        return getattr(self._context, name)

    def warn(self, message: str) -> None:
        """Drop a message."""

    def report(self, **values: Any) -> None:
        """Drop numbers."""


def properties_of(context: Context, image: Voxels, sides: str) -> dict[str, Any]:
    """Stiffness of the solid and permeability of the void, whose voxels count as whole.

    Returns
    -------
    dict
        `stiffness`, the mean of C11, C22 and C33 over Young's modulus of the solid; `C`, these three; `permeability`,
        the mean along the axes, mm^2; `k`, these three. All 0 where nothing carries or flows.
    """
    silent = cast(Context, _Silent(context))
    found: dict[str, Any] = {"sides": sides}
    for name, number, stage, scale in (
        ("stiffness", "C", "homogenize.voxel", 1.0), ("permeability", "k", "homogenize.permeability", 1e6),
    ):  # fmt: skip
        try:
            made: Any = registry().get(stage)
            report = made(sides=sides, grids=1).run(silent, image)
            tensor = report.stiffness[:3, :3] if name == "stiffness" else report.m2
            values = [scale * float(value) for value in np.diag(tensor)]
        except DesignError:  # no way through along any axis
            values = [0.0, 0.0, 0.0]
        found |= {name: sum(values) / 3, number: values}
    return found
