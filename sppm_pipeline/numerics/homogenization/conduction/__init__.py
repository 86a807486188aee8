"""Effective conductivity of periodic voxel cells: heat, charge, or what diffuses.

* `sweep`: the conductivity of all voxels, applied without a matrix.
* `homogenize`: from voxels to the effective conductivity.
"""
