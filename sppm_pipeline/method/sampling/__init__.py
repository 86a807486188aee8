"""Sampling of pore positions: dart throwing, maximal sampling, mirrored faces, sample elimination (paper, section 2.1).

All lengths are in cell sizes; one periodic cell is the unit cube.
"""
