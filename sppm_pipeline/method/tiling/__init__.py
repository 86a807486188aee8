"""Tile rules: which content goes into which cell of an assembly (paper, section "Overall Stochasticity").

A tiling is a pair ``(interior, faces)`` of integer arrays. ``interior`` (nx, ny, nz) holds the interior of each cell
and -1 where there is no cell. ``faces`` holds one array for each axis, one longer than ``interior`` along that axis:
plane i is the low side of cell i, plane i + 1 its high side, so that two neighbors share one entry and can't disagree.
A face with no cell on either side is -1.

* `wang`: the paper's tile set with both of its rules.
* `hashed`: face colors and interiors drawn freely, any cell at random access.
* `corners`: colored lattice corners, from which faces and interiors follow.
* `lattice`: the lattice of cells and faces, the integer hash of its places, and a content of its own for every cell.
* `statistics`: broken rules, alike neighbors, scores of Rule 2, and the entropy that a rule leaves.
* `residual`: how much of an assembled image still repeats from cell to cell.
"""
