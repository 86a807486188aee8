"""Arrays read from files, made ready."""
