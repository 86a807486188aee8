"""Python files that a configuration names run only if the user has agreed to it."""

import json
import stat

import pytest

from sppm_pipeline.engine.cli.main import main
from sppm_pipeline.engine.plan import session
from sppm_pipeline.engine.plan.session import RunRequest, open_session

PLUGIN = "from pathlib import Path\nPath(__file__).with_name('ran').touch()\n"


@pytest.fixture
def stranger(tmp_path, monkeypatch):
    """A folder from somebody else, and a user who has agreed to nothing yet."""
    monkeypatch.delenv(session.FOLDERS, raising=False)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.py").write_text(PLUGIN)
    box = "{stage: read.primitive, shape: box, size: [1 mm, 1 mm, 1 mm]}"
    (tmp_path / "part.yaml").write_text(f"sppm: 1\nplugins: [own.py]\npipeline: [{box}]\n")
    return tmp_path


@pytest.mark.parametrize("verb", ["check", "run", "explain", "estimate", "graph"])
def test_nothing_runs_unasked(stranger, capsys, verb):
    assert main([verb, "part.yaml"]) == 2
    err = capsys.readouterr().err
    assert "names Python code that has not run for you before, or was changed since: '" in err
    assert "`sppm check FILE --trust` remembers" in err
    assert not (stranger / "ran").exists()
    assert main([verb, "part.yaml", "--no-plugins"]) == 0
    assert not (stranger / "ran").exists()


def test_what_is_trusted_is_remembered_by_its_content(stranger, capsys):
    assert main(["check", "part.yaml", "--trust"]) == 0
    assert (stranger / "ran").exists()
    remembered = stranger / "state" / "sppm" / "trusted.json"
    assert len(json.loads(remembered.read_text())["sha256"]) == 1
    assert stat.S_IMODE(remembered.stat().st_mode) == 0o600
    assert main(["check", "part.yaml"]) == 0
    (stranger / "copy").mkdir()
    for name in ("own.py", "part.yaml"):
        (stranger / "copy" / name).write_bytes((stranger / name).read_bytes())
    assert main(["check", "copy/part.yaml"]) == 0
    (stranger / "own.py").write_text(PLUGIN + "# another\n")
    assert main(["check", "part.yaml"]) == 2
    assert "or was changed since" in capsys.readouterr().err


def test_files_in_a_folder_of_ones_own_may_be_edited(stranger, monkeypatch):
    monkeypatch.setenv(session.FOLDERS, f"/nowhere:{stranger}")
    for text in (PLUGIN, PLUGIN + "# edited\n"):
        (stranger / "own.py").write_text(text)
        assert main(["check", "part.yaml"]) == 0


def test_what_the_user_names_himself_is_trusted(stranger):
    assert main(["check", "part.yaml", "--plugin", "own.py"]) == 0
    assert main(["check", "part.yaml", "--allow-plugins", "own.py"]) == 0
    open_session(RunRequest("part.yaml").absolute())  # as a worker does, whose driver was asked


def test_examples_of_the_program_are_trusted(stranger):
    assert main(["check", "single_file_plugin"]) == 0


def test_a_user_at_a_terminal_is_asked(stranger, monkeypatch, capsys):
    class Terminal:
        def __init__(self, answer):
            self.answer = answer

        def isatty(self):
            return True

        def readline(self):
            return self.answer

    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    monkeypatch.setattr("sys.stdin", Terminal("\n"))
    assert main(["check", "part.yaml"]) == 2
    monkeypatch.setattr("sys.stdin", Terminal("yes\n"))
    assert main(["check", "part.yaml"]) == 0
    assert "It runs with all your rights. Run it? [y/N]" in capsys.readouterr().err


def test_trust_that_can_not_be_written_down_holds_for_once(stranger, capsys):
    (stranger / "state").write_text("a file where a folder should be")
    assert main(["check", "part.yaml", "--trust"]) == 0
    assert "can't be remembered" in capsys.readouterr().err


@pytest.mark.parametrize("content", ["", "[]", '{"sha256": 3}', "{"])
def test_a_damaged_memory_trusts_nothing(stranger, content):
    (stranger / "state" / "sppm").mkdir(parents=True)
    (stranger / "state" / "sppm" / "trusted.json").write_text(content)
    assert main(["check", "part.yaml"]) == 2
    assert main(["check", "part.yaml", "--trust"]) == 0
