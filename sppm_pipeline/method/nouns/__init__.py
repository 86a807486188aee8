"""Artifacts that pass between the stages of the method: pores, tunnels, meshes, voxels, printers, stiffness."""
