"""Curves of tests and simulations: measures, corrections, spread."""
