"""Parts under load: conditions on a body of voxels, laws of stiffness over density, and densities that suit a load."""
