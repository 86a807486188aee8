"""Files and primitives become artifacts."""
