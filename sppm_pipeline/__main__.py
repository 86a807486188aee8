"""``python -m sppm_pipeline`` is ``sppm``."""

from sppm_pipeline.engine.cli.main import leave

if __name__ == "__main__":
    leave()
