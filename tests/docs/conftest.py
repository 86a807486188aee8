"""What the documents contain: links, command lines and YAML blocks, each as a case of its own."""

from __future__ import annotations

import importlib.util
import re
import shlex
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]
DOCUMENTS = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]

_FENCE = re.compile(
    r"^(?P<indent> *)```(?P<language>\w*)[^\n]*\n(?P<text>.*?)^(?P=indent)```", re.MULTILINE | re.DOTALL
)
_LINK = re.compile(r"!?\[[^\]]*\]\(\s*<?([^)\s>]+)[^)]*\)|<(?:img|a)\b[^>]*?(?:src|href)=\"([^\"]+)\"")
_INLINE = re.compile(r"(?<!`)`(sppm [^`\n]+)`(?!`)")


def script(name: str) -> ModuleType:
    """A script of ``docs/`` as a module."""
    spec = importlib.util.spec_from_file_location(name, ROOT / "docs" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@dataclass(frozen=True)
class Block:
    """A fenced block of a document."""

    document: Path
    line: int
    language: str
    text: str

    @property
    def name(self) -> str:
        """Where it stands, for the test's id."""
        return f"{self.document.relative_to(ROOT).as_posix()}:{self.line}"


@dataclass(frozen=True)
class Command:
    """A command line of a document; `words` begin with ``sppm``."""

    name: str
    document: Path
    words: tuple[str, ...]
    inline: bool


def blocks(document: Path) -> Iterator[Block]:
    """Fenced blocks of a document, their indentation taken away."""
    text = document.read_text(encoding="utf-8")
    for match in _FENCE.finditer(text):
        line = text.count("\n", 0, match.start()) + 1
        indent = len(match["indent"])
        lines = [row[indent:] if row[:indent].isspace() else row for row in match["text"].splitlines()]
        yield Block(document, line, match["language"], "\n".join(lines) + "\n")


def links(document: Path) -> Iterator[str]:
    """Targets of links and pictures outside of fenced blocks."""
    text = _FENCE.sub("", document.read_text(encoding="utf-8"))
    for match in _LINK.finditer(re.sub(r"`[^`\n]*`", "", text)):
        yield match[1] or match[2]


def commands(document: Path) -> Iterator[Command]:
    """Lines of shell blocks that call ``sppm``, and calls that the text mentions between backticks."""
    for block in blocks(document):
        if block.language in ("bash", "sh", "shell", "console"):
            for row in block.text.replace("\\\n", " ").splitlines():
                for words in _calls(row.removeprefix("$ ")):
                    yield Command(f"{block.name}: {row.strip()}", document, words, inline=False)
    text = _FENCE.sub("", document.read_text(encoding="utf-8"))
    for match in _INLINE.finditer(text):
        name = f"{document.relative_to(ROOT).as_posix()}: {match[1]}"
        yield Command(name, document, tuple(match[1].split()), inline=True)


def _calls(row: str) -> Iterator[tuple[str, ...]]:
    """The calls of ``sppm`` in one line of a shell, without what the shell itself takes."""
    lexer = shlex.shlex(row, posix=True, punctuation_chars=True)
    lexer.whitespace_split = True
    call: list[str] = []
    skip = False
    for word in [*lexer, ";"]:
        if word in (";", "|", "||", "&&", "&"):
            while call and re.fullmatch(r"\w+=.*", call[0]):  # variables of the environment
                call.pop(0)
            if call and Path(call[0]).name == "sppm":
                yield ("sppm", *call[1:])
            call = []
        elif word in (">", ">>", "<", "2>"):
            skip = True
        elif skip:
            skip = False
        else:
            call.append(word)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """One case for each document, link, command line or YAML block."""
    if "link" in metafunc.fixturenames:
        cases = [(document, target) for document in DOCUMENTS for target in dict.fromkeys(links(document))]
        ids = [f"{document.relative_to(ROOT).as_posix()} -> {target}" for document, target in cases]
        metafunc.parametrize("link", cases, ids=ids)
    if "command" in metafunc.fixturenames:
        found = {command.name: command for document in DOCUMENTS for command in commands(document)}
        metafunc.parametrize("command", list(found.values()), ids=list(found))
    if "yaml_block" in metafunc.fixturenames:
        every = [block for document in DOCUMENTS for block in blocks(document) if block.language == "yaml"]
        metafunc.parametrize("yaml_block", every, ids=[block.name for block in every])


@pytest.fixture
def root() -> Path:
    """The folder of the repository."""
    return ROOT


@pytest.fixture
def texts_of() -> Callable[[Path, str], list[str]]:
    """Function from a document and a language to the texts of its blocks."""
    return lambda document, language: [block.text for block in blocks(document) if block.language == language]


@pytest.fixture
def calls_in() -> Callable[[str], list[tuple[str, ...]]]:
    """Function from a line of a shell to the calls of ``sppm`` in it."""
    return lambda row: list(_calls(row))
