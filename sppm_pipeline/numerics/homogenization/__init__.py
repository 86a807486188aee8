"""Effective properties of periodic cells: elasticity and conduction on voxels, elasticity on tetrahedra."""
