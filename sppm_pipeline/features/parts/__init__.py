"""Parts under load: load cases, simulation of the part that will be printed, and densities that suit the load."""

from sppm_pipeline.hookspecs import stages_in

sppm_stages = stages_in(__name__)
GROUPS = {"": "everyday"}
