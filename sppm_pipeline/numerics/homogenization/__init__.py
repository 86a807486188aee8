"""Effective properties of periodic cells.

* `elasticity`, with `elastic_operator` and `elastic_energy`: stiffness on voxels.
* `conduction`: conductivity on voxels.
* `tetrahedral`, with `tetrahedral_assembly` and `mortar`: stiffness on tetrahedra.
* `multigrid`: the solver of all problems on voxels.
* `stiffness`: what follows from a stiffness matrix.

Another physics on voxels is a file beside `conduction`: a level (`multigrid.hierarchy.Level`) that applies its
operator, a function that builds the levels, and one that passes them and its energies to `multigrid.solver.load_cases`.
"""
