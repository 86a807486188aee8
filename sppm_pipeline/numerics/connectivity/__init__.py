"""Connected components of voxel masks: on a box, on the torus, and on a part that comes slab by slab.

A part that is printed must hang together, and its void must let resin or powder out. The rooms' files: `runs` (a mask
as runs of voxels), `components` (union-find over the runs, periodic seams included), `torus` (label images),
`percolation` (what a phase looks like), `islands` (keep the largest), `streaming` (the same without the whole array).
"""
