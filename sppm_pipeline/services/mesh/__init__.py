"""Triangles: measures, inside and outside, marching cubes; what every user of a mesh needs."""
