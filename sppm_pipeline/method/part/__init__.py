"""The part to fill: what a mesh measures, which voxels are inside, gray edges, the solid skin, and primitive bodies.

Positions are in the unit of the caller (mm for parts); occupancies are (nz, ny, nx) uint8, 1 inside, and are made slab
by slab, so that memory does not grow with the number of layers.
"""
