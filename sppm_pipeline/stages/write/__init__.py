"""Stages that write artifacts to files."""
