"""Stages that lay cells into a part."""
