"""Pores are joined by tunnels."""
