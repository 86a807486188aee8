"""Effective stiffness of periodic cells of voxels: `elasticity` solves, by the operators of
`sppm_pipeline.services.elastic` and the multigrid of `sppm_pipeline.services.multigrid`.
"""
