"""Stages that repeat a recipe until it meets a target."""
