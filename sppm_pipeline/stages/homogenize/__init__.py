"""Effective properties are computed."""
