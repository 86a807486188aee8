"""Triangle surfaces of a sampled field: marching cubes, caps at the border of the box, and measures of a mesh."""
