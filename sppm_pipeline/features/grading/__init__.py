"""Grading: parameters that vary in space, bent and joined cells."""

from sppm_pipeline.hookspecs import stages_in

sppm_stages = stages_in(__name__)
GROUPS = {"": "everyday"}
