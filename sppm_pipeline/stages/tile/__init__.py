"""Cells are laid into a part."""
