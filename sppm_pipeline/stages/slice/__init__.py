"""Stages that slice fields and meshes into layers."""
