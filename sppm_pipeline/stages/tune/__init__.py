"""A recipe is repeated until it meets a target."""
