"""Conjugate gradients with a geometric multigrid preconditioner on periodic voxel grids.

* `rows`: what passes over a grid do with rows of nodes.
* `transfer`: between a grid and the next coarser one.
* `vectors`: sums of vectors, with scalar products in double precision.
* `hierarchy`: the grids; a problem (elasticity, conduction) says how a pass over one of them looks.
* `pcg`: the iteration, and when it stops.
* `load_cases`: all constant loads of a cell, and their energies.
"""
