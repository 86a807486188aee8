"""The stages of the method: the file of a stage has its name, with an underscore for the dot."""
