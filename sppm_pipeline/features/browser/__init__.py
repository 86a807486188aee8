"""Reports, the live view, the studio, charts, sheets and tables."""

from __future__ import annotations

from sppm_pipeline.hookspecs import Command, hookimpl, stages_in
from sppm_pipeline.nouns.viewers import Viewer

sppm_stages = stages_in(__name__)
GROUPS = {"": "everyday"}


@hookimpl
def sppm_commands() -> dict[str, Command]:
    """The verbs of this feature."""
    return {
        "report": Command(
            "write one HTML file that shows a run directory, to be mailed", f"{__name__}.report.command:configure",
            f"{__name__}.report.command:execute", f"{__name__}.report.command:shown_stages",
            f"{__name__}.report.command:after_run",
        ),
        "view": Command(
            "show a run directory in the browser", f"{__name__}.live.serving:configure",
            f"{__name__}.live.serving:execute",
        ),
        "studio": Command(
            "design a cell or fill a part in the browser, and save it as a configuration",
            f"{__name__}.studio.server:configure", f"{__name__}.studio.server:execute",
        ),
    }  # fmt: skip


@hookimpl
def sppm_live_views() -> dict[str, Viewer]:
    """Viewers of fields and tile sets; those that a browser can sum itself move in notebooks."""
    view, picture = f"{__name__}.live.structures:structure_view", f"{__name__}.live.pictures:notebook_png"
    moving = Viewer(view, picture, f"{__name__}.live.structures:live_frame")
    return {
        "sppm_pipeline.method.fields.scalar_field:ScalarField": Viewer(view, picture),
        "sppm_pipeline.method.fields.microstructure:Microstructure": moving,
        "sppm_pipeline.method.fields.tileset:TileSet": moving,
    }
