"""``python -m sppm_pipeline`` is ``sppm``."""

from sppm_pipeline.cli.main import main

if __name__ == "__main__":
    raise SystemExit(main())
