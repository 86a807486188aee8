"""Flow and transport: permeability, acoustics and conductivity of a cell, and its pore network."""

from sppm_pipeline.nouns import stages_in

sppm_stages = stages_in(__name__)
