"""Base classes of families of stages: a new sampler, connector, formula or tile rule is one method."""
