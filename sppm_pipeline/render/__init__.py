"""Pictures of parts and charts of results without a display or a graphics driver: arrays in, RGB arrays out.

All pictures are (height, width, 3) uint8 arrays; the same input gives the same bytes.

* `mesh_view`: a triangle mesh, by a z-buffer.
* `plates`: several pictures on one sheet, with labels.
* `charts`, `series`: lines, points, box plots, and what they show.
* `cut_faces`: which triangles were made by cutting a microstructure, so that they may be tinted.
* `camera`, `shading`: what views share; `lettering`: text.
"""
