"""Something is measured, and may be rejected."""
