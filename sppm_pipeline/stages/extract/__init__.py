"""A field becomes a triangle mesh."""
