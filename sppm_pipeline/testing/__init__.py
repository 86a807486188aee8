"""For authors of plugins: a context for unit tests, and contracts that stages keep.

`plain_context` lets a stage run outside of a pipeline, `contracts` holds suites to inherit from in pytest classes.
"""
