"""Documents, code, and comments of configurations and scripts use the standard terms of engineering and Python.

What is searched: Markdown and notebooks without code, comments of YAML, comments and strings of Python.
"""

from __future__ import annotations

import io
import json
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.docs.conftest import ROOT

SEARCHED = (
    "*.md",
    ".ci/*.py",
    "docs/**/*.md",
    "docs/**/*.ipynb",
    "docs/*.py",
    "configs/**/*.yaml",
    "configs/**/*.py",
    "examples/*.yaml",
    "examples/*.py",
    "sppm_pipeline/**/*.py",
)
"""Patterns of files."""

NOT_SEARCHED = (
    "docs/reference/*/*.md",  # written from docstrings, which are searched where they stand
    "docs/reference/cli.md",
    "docs/reference/README.md",
)

WORDS = (
    # pattern (a space stands for any white space), a phrase that it must find, what to write instead
    (r"\bhangs? (on nothing|together|nowhere|on the)", "solid that hangs on nothing", "disconnected, connected"),
    (r"\b(told|tells)\b", "what is told", "reported, reports, shows"),
    (r"\bwish(ed|es)?\b", "a wished property", "target"),
    (r"\b(who|which|what)soever\b|\bwhoever\b", "whoever wrote it", "the writer, any reader"),
    (r"\bsaid of\b|\bsay of\b", "what is said of a block", "summary of, properties of"),
    (r"\blook(s|ed)? (\w+ ){1,3}over\b", "looks the installation over", "check, inspect"),
    (r"\ba choice\b", "that number is a choice", "a heuristic, and why; one of"),
    (r"\bby us\b|\bours\b", "no printer was fed by us", "not verified; this program"),
    (r"\bfed with\b", "a printer was fed with it", "printed, loaded"),
    (r"(?<![\w.:+%)\]}*/-])-?\.\d(?!\w*mf)", "a ratio of .28", "0.28"),
    (r"\b(alike|same) (in|from) all (directions|sides)\b", "alike in all directions", "isotropic, symmetric"),
    (r"\b(no|some)body\b", "nobody can tell", "undefined, another user"),
    (r"\bg[ia]ves? way\b", "connect.mbdst gives way", "yield, fall back, deflect"),
    (r"\b(comes?|came) apart\b", "the block came apart", "lose its load path, fracture, stop"),
    (r"\bwarned of\b", "are warned of", "trigger a warning"),
    (r"\bdraws? a warning\b", "it draws a warning", "triggers a warning"),
    (r"\buser can cure\b", "what the user can cure", "fix"),
    (r"\bgoe?s? over into\b", "goes over into another", "blends into"),
    (r"\brivals?\b", "next to its rivals", "the structures compared"),
    (r"\bsome (ten|tens)\b", "some ten seconds", "about 10"),
    (r"\bnot usual\b", "what is not usual", "what sets it apart"),
    (r"\bthe obvious way\b", "the obvious way with numpy", "a straightforward script"),
    (r"\b(residual|this) over the right-hand side\b", "residual over the right-hand side", "relative residual"),
    (r"\banew\b", "drawn anew", "again, redrawn"),
    (r"\bslips? of the pen\b", "slips of the pen", "typing errors"),
    (r"\b(found|finds?) out\b", "is found out", "detected, determined"),
    (r"\bgoes with\b", "time goes with the square", "scales with"),
    (r"\blone\b", "a lone cell", "single, isolated"),
    (r"\bknows? (no|nothing)\b", "knows no fracture", "does not model, does not support"),
    (r"\bwho got what\b", "who got what from whom", "which stage feeds which"),
    (r"\b(honest|honestly)\b", "honest limits", "limits"),
    (r"\bper cent\b", "some per cent", "percent, %"),
    (r"\b(colou?r|neighbou?r|behaviou?r)\b(?<=our)|(?<!\")\bgrey\b|\bmould", "a grey colour", "American spelling"),
    (r"\b(mode|labe|cance|trave)ll(er|ed|ing)\b", "your modeller", "American spelling: modeler"),
)


def prose(path: Path) -> str:
    """The text of a file with all that is no prose left out, its lines where they were."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        blank = re.sub(r"(?ms)^ *```.*?^ *```", lambda block: "\n" * block[0].count("\n"), text)
        return re.sub(r"`[^`]*`|\]\([^)]*\)|\$[^$\n]*\$", lambda code: "_" + "\n" * code[0].count("\n"), blank)
    if path.suffix == ".ipynb":
        cells = json.loads(text)["cells"]
        return "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")
    if path.suffix == ".yaml":
        return "\n".join(line.partition("#")[2] for line in text.splitlines())
    return "".join(python_prose(text))


def python_prose(text: str) -> Iterator[str]:
    """Comments and strings of a module, each on its line."""
    line = 1
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type in (tokenize.COMMENT, tokenize.STRING):
            yield "\n" * (token.start[0] - line) + " " + token.string
            line = token.end[0]


def outlawed(text: str) -> Iterator[tuple[int, str, str]]:
    """Line, phrase and better words of each phrase that is to be mended."""
    for pattern, _, better in WORDS:
        for match in re.finditer(pattern.replace(" ", r"\s+"), text, re.IGNORECASE):
            yield text.count("\n", 0, match.start()) + 1, " ".join(match[0].split()), better


def files() -> list[Path]:
    """All files that are searched."""
    left_out = {path for pattern in NOT_SEARCHED for path in ROOT.glob(pattern)}
    return sorted({path for pattern in SEARCHED for path in ROOT.glob(pattern)} - left_out)


@pytest.mark.parametrize("path", files(), ids=lambda path: path.relative_to(ROOT).as_posix())
def test_words_are_standard_terms(path: Path) -> None:
    found = [f"line {line}: `{phrase}` (write: {better})" for line, phrase, better in sorted(outlawed(prose(path)))]
    assert not found, "\n".join(found)


@pytest.mark.parametrize(("pattern", "phrase", "better"), WORDS, ids=[phrase for _, phrase, _ in WORDS])
def test_each_pattern_finds_its_phrase(pattern: str, phrase: str, better: str) -> None:
    assert any(words == better for _, _, words in outlawed(phrase)), pattern


@pytest.mark.parametrize(
    "text", ["a ratio of 0.28", "a `.3mf` file or .3mf", "from 0.1 to 0.9", "f'{x:.3g}'", "its modeler", "a neighbor"]
)
def test_good_words_pass(text: str) -> None:
    assert list(outlawed(text)) == []


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("page.md", "```text\nwished\n```\n`wished` and [a](wished.md)\n\nwished\n"),
        ("run.yaml", "a: wished\n\n\n\n\nb: 1  # wished\n"),
        ("code.py", "wished = 1\n\n\n\n\nb = 'wished'\n"),
        ("code.py", "wished = 1\n\n\n\n\nb = 1  # wished\n"),
    ],
)
def test_only_prose_is_searched(name: str, text: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text, encoding="utf-8")
    assert [line for line, _, _ in outlawed(prose(tmp_path / name))] == [6]
