"""Every YAML block of README and docs passes ``sppm check``.

A block that starts with ``sppm: 1`` is a whole configuration. Any other is a fragment: a list of stages, or some keys
of a configuration; its stages and options are checked, while what it takes from the rest of the file is not.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from sppm_pipeline.engine.plan.checking import checked
from sppm_pipeline.engine.plan.session import RunRequest, open_session
from sppm_pipeline.errors import ConfigError, ConfigErrors, WiringError

PLACEHOLDER = "pipeline:\n  - {stage: read.primitive, shape: box, size: [1, 1, 1]}\n"


def check(path: Path, plugins: tuple[Path, ...] = ()) -> list[ConfigError]:
    """What ``sppm check`` says against a file; a page that builds an installed plugin again does without them."""
    request = RunRequest(str(path), plugins=tuple(str(plugin) for plugin in plugins), distributions=not plugins)
    try:
        checked(open_session(request), inputs=False)
    except ConfigErrors as errors:
        return list(errors.errors)
    except ConfigError as error:
        return [error]
    return []


def completed(text: str) -> str:
    """A fragment as a whole file."""
    if re.match(r"(?:#.*\n|\s)*- ", text):
        return "sppm: 1\npipeline:\n" + "".join(f"  {line}\n" for line in text.splitlines())
    return "sppm: 1\n" + text + ("" if re.search(r"^pipeline:", text, re.MULTILINE) else PLACEHOLDER)


def test_block_passes_the_check(yaml_block, texts_of: Callable[[Path, str], list[str]], tmp_path: Path) -> None:
    plugins = []
    for number, code in enumerate(texts_of(yaml_block.document, "python")):
        if "ClassVar[str] =" in code:  # a page that defines stages may use them
            plugins.append(tmp_path / f"plugin_{number}.py")
            plugins[-1].write_text(code, encoding="utf-8")
    whole = re.search(r"^sppm:", yaml_block.text, re.MULTILINE) is not None
    text = yaml_block.text if whole else completed(yaml_block.text)
    path = tmp_path / "page.yaml"
    path.write_text(re.sub(r"^plugins:.*\n", "", text, flags=re.MULTILINE), encoding="utf-8")
    errors = check(path, tuple(plugins))
    if not whole:
        errors = [error for error in errors if not isinstance(error, WiringError)]
    assert not errors, "\n".join(map(str, errors))


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("- {stage: write.mesh, path: a.stl}\n", 0),
        ("- {stage: write.mesh, pat: a.stl}\n", 1),
        ("- {stage: write.slt}\n", 1),
        ("seed: 3\n", 0),
        ("sede: 3\n", 1),
    ],
)
def test_fragments_are_checked(tmp_path: Path, text: str, count: int) -> None:
    path = tmp_path / "fragment.yaml"
    path.write_text(completed(text), encoding="utf-8")
    assert len([error for error in check(path) if not isinstance(error, WiringError)]) == count
