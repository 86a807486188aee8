"""Stages that measure curves."""
