"""Sheets: solid between two random networks of void, relaxed until it is nearly a minimal surface."""

from __future__ import annotations

from sppm_pipeline.hookspecs import Preset, hookimpl

STAGES = {"field.sheet": "SheetStage"}
"""Stage name -> class; the module is `stages`, with an underscore for the dot."""


@hookimpl
def sppm_stages() -> dict[str, str]:
    """The stages of this feature."""
    return {name: f"{__name__}.stages.{name.replace('.', '_')}:{cls}" for name, cls in STAGES.items()}


@hookimpl
def sppm_presets() -> dict[str, Preset]:
    """The preset of an open and stiff structure."""
    return {
        "open": Preset(
            "open, stiff and isotropic: a sheet between two random networks, one of them wider than the other",
            [
                {"stage": "sample.dart_throwing", "edge": "${edge}", "total": "${total}"},
                {"stage": "field.sheet", "density": "${density}", "balance": "${balance}"},
            ],
            {"total": 95, "edge": None, "density": 0.3, "balance": 0.57},
        )
    }
