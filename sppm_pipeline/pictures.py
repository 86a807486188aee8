"""Pictures and charts for reports, notebooks and files: renderers, sheets, and the style of charts.

A public sub-face of `sppm_pipeline`: names here stay, and are loaded when they are first used.
"""

from __future__ import annotations

from sppm_pipeline import lazily

TYPE_CHECKING = False  # as type checkers understand it
if TYPE_CHECKING:  # the same names as in `_PLACES`, which a test compares
    from sppm_pipeline.nouns.artifact import NOTEBOOK_SIZE as NOTEBOOK_SIZE
    from sppm_pipeline.services.pictures.camera import Camera as Camera
    from sppm_pipeline.services.pictures.chart_style import COLORS as _CHART_COLORS
    from sppm_pipeline.services.pictures.chart_style import check_chart as check_chart
    from sppm_pipeline.services.pictures.chart_style import figure_file as figure_file
    from sppm_pipeline.services.pictures.chart_style import plain_text as plain_text
    from sppm_pipeline.services.pictures.chart_style import styled as styled
    from sppm_pipeline.services.pictures.charts import Series as Series
    from sppm_pipeline.services.pictures.charts import chart as chart
    from sppm_pipeline.services.pictures.mesh_view import render_mesh as render_mesh
    from sppm_pipeline.services.pictures.shading import BONE as BONE
    from sppm_pipeline.services.pictures.sheets import colors_of as colors_of
    from sppm_pipeline.services.pictures.sheets import contact_sheet as contact_sheet
    from sppm_pipeline.services.pictures.sheets import with_scale as with_scale

    CHART_COLORS = _CHART_COLORS

_PLACES = {
    "nouns.artifact": "NOTEBOOK_SIZE",
    "services.pictures.camera": "Camera",
    "services.pictures.chart_style": "CHART_COLORS=COLORS check_chart figure_file plain_text styled",
    "services.pictures.charts": "Series chart",
    "services.pictures.mesh_view": "render_mesh",
    "services.pictures.shading": "BONE",
    "services.pictures.sheets": "colors_of contact_sheet with_scale",
}
"""Modules below `sppm_pipeline`, and what is taken from each: ``name``, or ``public name=name there``."""

__all__, __getattr__, __dir__ = lazily(__name__, _PLACES)
