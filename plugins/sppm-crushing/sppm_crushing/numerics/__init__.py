"""Compression of voxel bodies to large strains: elements, material, self-contact, plates, and the march in time.

Everything is in units of the voxel's edge and of the first phase: its Young's modulus and density are 1, so that waves
in a bar of it travel one edge in a unit of time. The density of other phases is such that theirs are as fast.
"""
