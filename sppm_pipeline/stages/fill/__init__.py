"""Stages that intersect a microstructure with a part."""
