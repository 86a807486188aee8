"""Surfaces: meshes extracted from fields, checked, and combined."""

from sppm_pipeline.hookspecs import stages_in

sppm_stages = stages_in(__name__)
GROUPS = {"": "everyday"}
