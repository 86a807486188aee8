"""Voronoi cells of pores, the distance to their faces, and tunnels as capsules: what walls are made of."""
