"""Slow flow through the pores of a periodic cell on a staggered grid, and what follows from it for sound."""
