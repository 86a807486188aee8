"""Pores and tunnels become a field."""
