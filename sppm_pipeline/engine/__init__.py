"""The engine: YAML with positions, options, wiring, plugin loading, the runner, its record, sweeps and executors.

It knows nothing of geometry: it meets stages and artifacts only through `sppm_pipeline.stage` and their annotations.
"""
