"""Stages that measure an artifact, and may reject it."""
