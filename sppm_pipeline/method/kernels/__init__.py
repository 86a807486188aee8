"""Pore and tunnel kernels and their sum (paper, section 2.1)."""
