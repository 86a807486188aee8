"""The artifacts that pass between stages: frozen, with read-only arrays, a summary, a digest and a check."""
