"""A field becomes a stack of layers."""
