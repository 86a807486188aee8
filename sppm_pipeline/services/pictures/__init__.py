"""Pictures of meshes and charts of results without a display or a graphics driver.

Pictures are (height, width, 3) uint8 arrays, charts are the bytes of a file; the same input gives the same bytes.

* `mesh_view`: triangle meshes, by a z-buffer; `rays`, `camera` and `shading` are what views share.
* `sheets`: several pictures on one sheet, labels, and the scale of the colors of a surface.
* `charts`: points, lines, box plots and bars, by matplotlib.
"""
