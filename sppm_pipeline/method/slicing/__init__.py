"""Layers of a part, computed slab by slab, without a mesh (paper, section 3.4)."""
