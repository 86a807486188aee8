"""A benchmark of programs that make stochastic porous structures; see README.md."""
