"""Stages that compute effective properties of a periodic structure."""
