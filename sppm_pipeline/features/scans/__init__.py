"""Scans: images of micro-CT as fields, their statistics, twins made of them, and parts compared with their design."""

from sppm_pipeline.hookspecs import stages_in

sppm_stages = stages_in(__name__)
