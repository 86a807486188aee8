"""Files and primitives become nouns."""
