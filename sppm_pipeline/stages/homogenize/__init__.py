"""Effective properties of a periodic structure."""
