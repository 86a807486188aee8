"""The field of a tiling: the sum of all kernels of all cells, each shared face counted once.

`gather` lists the kernels near a box: the exact way, for any grid. `patches` and `overlap_add` are the fast way for
grids whose spacing divides the cell edge: each piece is sampled once, and the samples are added where they overlap.
"""
