"""Reaching a target porosity (paper, section 2.3).

From coarse to fine: `sppm_pipeline.services.boolean_model` (expected before anything is drawn), `line` (the number of
pores from a fitted line), `level` (the level as a quantile of the field, exact in one pass, or a search on another
parameter); `fractions` are those of voxels that the surface cuts.
"""
