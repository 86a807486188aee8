"""Linear elasticity on tetrahedra of a periodic cell: stiffness matrices, periodicity, solution, homogenization."""
