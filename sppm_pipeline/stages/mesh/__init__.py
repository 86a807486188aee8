"""Stages that make meshes of volumes, and surfaces of them."""
