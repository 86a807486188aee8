"""Stages that read files, and make primitives."""
