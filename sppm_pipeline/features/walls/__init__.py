"""Walls: solid between Voronoi cells of the pores."""

from sppm_pipeline.hookspecs import stages_in

sppm_stages = stages_in(__name__)
