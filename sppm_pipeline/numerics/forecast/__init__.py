"""Sizes and times foretold from counts, without computing anything."""
