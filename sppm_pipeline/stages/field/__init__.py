"""Stages that make a scalar field of pores and tunnels."""
