"""Crushing: blocks of voxels compressed to large strains, and compression tests read, measured and compared."""

from sppm_pipeline.nouns import stages_in

sppm_stages = stages_in(__name__)
