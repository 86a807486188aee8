"""The engine: YAML with positions, options, wiring, plugin loading, the runner, its record, sweeps and executors.

It does not depend on geometry: it meets stages and artifacts only through `sppm_pipeline.stage` and their annotations.
"""
