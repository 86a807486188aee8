"""Conjugate gradients with a geometric multigrid preconditioner on periodic voxel grids.

* `rows`: kernels on rows of nodes, for the operators.
* `transfer`: interpolation and restriction between a grid and the next coarser one.
* `vectors`: vector operations, with scalar products in double precision.
* `hierarchy`: the grids and the cycle; a physics supplies the operator of a level.
* `solver`: the iteration, when it stops, and all load cases of a cell.
"""
