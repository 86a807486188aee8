"""A part is cut from the tiling."""
