"""Where built-in stages, executors and verbs come from: features are found by looking which folders there are.

And which stages the plugins of this repository supply, so that an error can name the plugin to install.
"""

from __future__ import annotations

import os
from importlib import import_module
from typing import Any

import sppm_pipeline

_FOLDER = os.path.join(os.path.dirname(str(sppm_pipeline.__file__)), "features")

FEATURES = tuple(
    f"sppm_pipeline.features.{name}"
    for name in sorted(os.listdir(_FOLDER))
    if os.path.isfile(os.path.join(_FOLDER, name, "__init__.py"))
)
"""Modules of the features."""

BUILTINS = (
    "sppm_pipeline.method",
    *FEATURES,
    "sppm_pipeline.engine.run.executors",
    "sppm_pipeline.engine.cli.commands",
)
"""Modules whose hook implementations are always there."""


def stage_class(name: str) -> Any:
    """The class of a stage of the method or of a feature, by its name; `LookupError` if none of them has it."""
    for module in ("sppm_pipeline.method", *FEATURES):
        if place := import_module(module).sppm_stages().get(name):
            found = vars(import_module(place)).values()
            return next(cls for cls in found if isinstance(cls, type) and vars(cls).get("name") == name)
    raise LookupError(f"no built-in stage is called {name!r}")


PLUGINS = {
    "sppm-cad": ("read.cad",),
    "sppm-crushing": (
        "crush.voxel", "measure.compression", "read.compression", "tune.plateau", "write.curves", "write.frames",
    ),
    "sppm-even-tiles": ("tile.even_interiors",),
    "sppm-lattice-points": ("sample.lattice_points",),
    "sppm-lib3mf": ("write.3mf_beams", "write.3mf_slices"),
    "sppm-pymeshlab": ("mesh.decimate", "mesh.remesh", "mesh.repair", "mesh.smooth"),
    "sppm-structures": (
        "field.elastic_texture", "field.organic", "field.spinodoid", "field.stochastic_gyroid", "field.struts",
        "field.tpms", "field.voronoi_foam",
    ),
    "sppm-tetrahedra": (
        "check.volume_mesh", "homogenize.tet", "mesh.boundary", "mesh.isosurface_stuffing", "read.volume_mesh",
        "write.volume_mesh",
    ),
    "sppm-tetwild": ("mesh.tetwild",),
}  # fmt: skip
"""Stages of the distributions in the folder ``plugins`` of the repository, by distribution."""

PLUGIN_OF = {stage: distribution for distribution, stages in PLUGINS.items() for stage in stages} | dict.fromkeys(
    ("write.inp", "write.msh", "write.vtu"), "sppm-tetrahedra"
)
"""The distribution of each of these stages, and of names that some of them had."""

TYPES = {"CompressionCurve": "sppm_crushing", "CrushedBody": "sppm_crushing", "VolumeMesh": "sppm_tetrahedra"}
"""The module that has a type which these stages pass on."""


def install_words(distribution: str) -> str:
    """How one of the distributions in `PLUGINS` is installed."""
    return f"`pip install {distribution}`, or `pip install ./plugins/{distribution}` in a clone"
