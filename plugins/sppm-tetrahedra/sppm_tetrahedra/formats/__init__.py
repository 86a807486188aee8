"""Formats of volume meshes: arrays in, pieces of a file out."""
