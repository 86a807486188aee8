"""Stages that compress a block between plates."""
