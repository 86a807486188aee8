"""Design, verify, simulate and print stochastic porous microstructures."""

__version__ = "0.1.0"
