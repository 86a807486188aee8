"""Stages that sample pore positions."""
