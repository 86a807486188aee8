"""Stages that extract meshes and voxel images from fields."""
