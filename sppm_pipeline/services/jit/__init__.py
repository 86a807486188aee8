"""Compiled kernels: Numba when it is needed, kept machine code when it is not."""
