"""Every ``sppm`` command line of README and docs parses, and its configuration takes its overrides.

The configuration is a file of the repository, a packaged example, or a YAML block of the same page with that ``name``.
"""

from __future__ import annotations

import argparse
import importlib
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from sppm_pipeline.engine.cli.commands import built_in_commands

VERBS = built_in_commands()
PLAIN = {"-h", "--help", "help", "-V", "--version"}


def parser_of(verb: str) -> argparse.ArgumentParser:
    """The verb's parser, which raises instead of ending the program."""
    parser = argparse.ArgumentParser(prog=f"sppm {verb}", allow_abbrev=False, exit_on_error=False)
    parser.add_argument("--debug", action="store_true")
    module, _, function = str(VERBS[verb].configure).partition(":")
    getattr(importlib.import_module(module), function)(parser)
    return parser


def test_command_parses(
    command,
    root: Path,
    texts_of: Callable[[Path, str], list[str]],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = command.words[1:]
    if not words or words[0] in PLAIN or words[0] == "VERB":
        return
    assert words[0] in VERBS
    parser = parser_of(words[0])
    if command.inline:  # a mention in a sentence may leave arguments out
        unknown = [word for word in words[1:] if word.startswith("-") and word not in parser._option_string_actions]
        assert unknown in ([], ["--help"])
        return
    try:
        arguments = parser.parse_args(words[1:])
    except (SystemExit, argparse.ArgumentError) as error:
        pytest.fail(f"{error}: {capsys.readouterr().err}")
    file = configuration_of(command, getattr(arguments, "file", None), root, texts_of, tmp_path)
    if file is not None:
        from sppm_pipeline.engine.cli.arguments import open_from

        arguments.file = str(file)
        open_from(arguments).plan()


def configuration_of(
    command, file: str | None, root: Path, texts_of: Callable[[Path, str], list[str]], folder: Path
) -> Path | None:
    """The configuration that a command names: one of the repository, or one that its page shows."""
    if file is None or file.endswith(".json"):
        return None  # a stage, or the record of a run
    if file.startswith(("configs/", "examples/")):
        return root / file
    if "." not in file:
        return next(root.glob(f"*/{file}.yaml"))  # in configs or examples
    stem = Path(file).stem
    shown = [text for text in texts_of(command.document, "yaml") if re.search(rf"^name: {stem}\b", text, re.MULTILINE)]
    assert shown, f"the page shows no configuration with `name: {stem}`"
    (folder / file).write_text(shown[0], encoding="utf-8")
    return folder / file


def test_there_are_commands_of_every_verb_in_the_reference(root: Path) -> None:
    text = (root / "docs" / "reference" / "cli.md").read_text(encoding="utf-8")
    assert [verb for verb in VERBS if f"## sppm {verb}\n" not in text] == []


@pytest.mark.parametrize(
    ("row", "calls"),
    [
        ("sppm run a.yaml -p cell='5 mm'  # a comment", [("sppm", "run", "a.yaml", "-p", "cell=5 mm")]),
        ("cd here && .venv/bin/sppm stages | less", [("sppm", "stages")]),
        ("X=1 sppm schema > schema.json; sppm doctor", [("sppm", "schema"), ("sppm", "doctor")]),
        ("make test", []),
    ],
)
def test_calls_are_found_in_a_line(
    row: str, calls: list[tuple[str, ...]], calls_in: Callable[[str], list[tuple[str, ...]]]
) -> None:
    assert calls_in(row) == calls
