"""Stages that draw a recipe for many interiors and face colors."""
