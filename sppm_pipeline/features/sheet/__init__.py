"""Sheets: solid between two random networks of void, relaxed until it is nearly a minimal surface."""

from __future__ import annotations

from sppm_pipeline.hookspecs import Preset, hookimpl, stages_in

sppm_stages = stages_in(__name__)


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
