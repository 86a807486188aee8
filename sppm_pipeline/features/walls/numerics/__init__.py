"""Voronoi cells of pores, distances from their faces, and tunnels as capsules."""
