"""The stages of the feature: the file of a stage has its name, with an underscore for the dot."""
