"""What is wrong with a triangle mesh, and what it encloses: adjacency, orientation, self-intersections, measures."""
