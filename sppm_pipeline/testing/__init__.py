"""For authors of plugins: a context for unit tests, contracts that stages keep, and synthetic stages.

`plain_context` lets a stage run outside of a pipeline, `contracts` holds suites to inherit from in pytest classes,
`synthetic` has stages and artifacts without any geometry, by which the engine itself is tested.
"""
