"""A plan is run: stages and recipes, the run directory, its record, sweeps."""
