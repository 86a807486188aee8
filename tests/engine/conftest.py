"""Configurations made of the synthetic stages."""

from __future__ import annotations

from pathlib import Path

import pytest

from sppm_pipeline.engine.config.parameters import Overrides
from sppm_pipeline.engine.plan.planning import Plan
from sppm_pipeline.engine.plan.session import RunRequest, Session, open_session
from sppm_pipeline.engine.run.runner import run_plan
from sppm_pipeline.errors import ConfigError, ConfigErrors

BUILTINS = ("tests.synthetic", "sppm_pipeline.engine.run.executors")


class Workplace:
    """Writes configurations into a folder, plans and runs them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def write(self, text: str, name: str = "config.yaml") -> Path:
        path = self.folder / name
        path.write_text(text, encoding="utf-8")
        return path

    def session(
        self, text: str, *, p=(), s=(), seed=None, plugins=(), distributions=False, builtins=BUILTINS
    ) -> Session:
        path = self.write(text if text.startswith("sppm:") else f"sppm: 1\n{text}")
        overrides = Overrides(tuple(p), tuple(s), seed)
        return open_session(RunRequest(str(path), builtins, tuple(map(str, plugins)), distributions, overrides))

    def plan(self, text: str, **how) -> Plan:
        return self.session(text, **how).plan()

    def run(self, text: str, *, to: str = "out", threads: int = 1, until=None, **how) -> dict:
        return run_plan(self.plan(text, **how), self.folder / to, threads=threads, until=until)

    def errors(self, text: str, **how) -> list[ConfigError]:
        """All errors of a configuration that must not be accepted."""
        with pytest.raises(ConfigError) as caught:
            self.plan(text, **how)
        error = caught.value
        return list(error.errors) if isinstance(error, ConfigErrors) else [error]

    def error(self, text: str, **how) -> ConfigError:
        """The only error."""
        errors = self.errors(text, **how)
        assert len(errors) == 1, [str(error) for error in errors]
        return errors[0]

    def place(self, error: ConfigError) -> tuple[int, int]:
        """Line and column."""
        assert error.where is not None
        assert error.where.file == str(self.folder / "config.yaml")
        return error.where.line, error.where.column


@pytest.fixture
def work(tmp_path: Path) -> Workplace:
    return Workplace(tmp_path)
