"""Design: structures from the numbers that one needs."""

from __future__ import annotations

from sppm_pipeline.hookspecs import hookimpl

STAGES = {
    "design.sizes": "DesignSizes",
}
"""Stage name -> class; the module is `stages`, with an underscore for the dot."""


@hookimpl
def sppm_stages() -> dict[str, str]:
    """The stages of this feature."""
    return {name: f"{__name__}.stages.{name.replace('.', '_')}:{cls}" for name, cls in STAGES.items()}
