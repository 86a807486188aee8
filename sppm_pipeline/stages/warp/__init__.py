"""Stages that bend a tiling to another shape."""
