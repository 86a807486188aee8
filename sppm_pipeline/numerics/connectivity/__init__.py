"""Connected components of voxel masks: on a box, on the torus, and on a part that comes slab by slab.

A part that is printed must be connected, and its void must let resin or powder out. The modules: `runs` (a mask
as runs of voxels), `components` (union-find over the runs, periodic seams included), `torus` (label images),
`percolation` (what a phase looks like), `islands` (keep the largest), `streaming` (the same without the whole
array, `layer_ids` for each layer).
"""
