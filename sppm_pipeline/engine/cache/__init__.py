"""Results of stages, kept between runs under a key of everything that they depend on."""
