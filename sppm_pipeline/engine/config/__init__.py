"""The text of a configuration: YAML with positions, its layout, parameters, options and their schema."""
