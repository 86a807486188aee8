"""Design: structures from the numbers that one needs."""

from __future__ import annotations

from sppm_pipeline.hookspecs import Command, Preset, hookimpl, stages_in

sppm_stages = stages_in(__name__)
GROUPS = {"": "everyday"}


@hookimpl
def sppm_presets() -> dict[str, Preset]:
    """The preset whose stiffness is dialed."""
    return {
        "dialed": Preset(
            "softer or stiffer at one porosity: walls between thrown pores that turn into the paper's struts",
            [
                {"stage": "sample.dart_throwing", "edge": "${edge}", "total": "${total}", "spacing": "${spacing}"},
                {"stage": "connect.mbdst", "degree": "${degree}", "mode": "greedy"},
                {"stage": "field.walls", "struts": "${struts}", "tunnel_radius": "${tunnel_radius}"},
            ],
            {"total": 60, "edge": None, "spacing": 0.05, "degree": [3, 5], "struts": 0.4, "tunnel_radius": 0.06},
        ),
    }


@hookimpl
def sppm_commands() -> dict[str, Command]:
    """The verbs of this feature."""
    words, where = "find designs by their properties, in the atlas of measured ones", f"{__name__}.commands"
    return {"find": Command(words, f"{where}:configure", f"{where}:execute")}


@hookimpl
def sppm_design_finders() -> dict[str, str]:
    """The atlas."""
    return {"atlas": f"{__name__}.atlas:find"}
