"""Connected components of voxel masks: on a box, on the torus, and on a part that comes slab by slab.

A part that is printed must be connected, and its void must let resin or powder out. The modules: `runs` (a mask
as runs of voxels), `components` (union-find over the runs, periodic seams included, and what a phase looks like),
`islands` (of one cell), `streaming` (of a part without the whole array, `layer_ids` for each layer),
`slab_union` (of slabs that were labeled apart), `laid_graph` (of pores and tunnels instead of voxels).
"""
