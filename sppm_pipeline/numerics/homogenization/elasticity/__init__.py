"""Effective stiffness of periodic voxel cells.

* `sweep`: the stiffness of all voxels, applied without a matrix; `rows`: its work on rows of nodes.
* `levels`: the grids of a multigrid cycle.
* `energy`: mutual energies of the load cases.
* `homogenize`: from voxels and materials to the effective stiffness.
"""
