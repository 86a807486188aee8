"""Consequences of a stiffness matrix: engineering constants, isotropy, bounds, directions, error bars.

Stiffness matrices are 6x6 in Voigt order xx, yy, zz, yz, xz, xy with engineering shear strains. Mechanisms have
singular ones: such a direction has modulus 0, never an error.
"""
