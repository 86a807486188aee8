"""Triangle surfaces of a sampled field: marching cubes, sharp rims, caps at the border of the box, and Booleans."""
