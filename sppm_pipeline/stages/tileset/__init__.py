"""A recipe is drawn for many interiors and face colors."""
