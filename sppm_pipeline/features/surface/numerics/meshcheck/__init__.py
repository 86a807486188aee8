"""Diagnosis of triangle meshes: adjacency, orientation, self-intersections, measures."""
