"""Effective stiffness of periodic cells of voxels.

`elasticity` solves, with `elastic_operator`, `elastic_level` and `elastic_energy`, by the multigrid of
`sppm_pipeline.services.multigrid`.
"""
