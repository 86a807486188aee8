"""Tetrahedral meshes: isosurface stuffing, quality, boundaries, copies on opposite faces of a periodic cell."""
