"""Nouns become files."""
