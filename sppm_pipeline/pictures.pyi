# What the module of this name loads when it is first used (`sppm_pipeline.lazily`), and type checkers read.
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
