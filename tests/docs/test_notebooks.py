"""The lessons in notebooks run from top to bottom, and show what they would show now."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

NOTEBOOKS = sorted((Path(__file__).resolve().parents[2] / "docs").rglob("*.ipynb"))

EXECUTE = """
import sys
import nbformat
from nbclient import NotebookClient

notebook = nbformat.read(sys.argv[1], as_version=4)
NotebookClient(notebook, timeout=600, kernel_name="python3", record_timing=False).execute()
nbformat.write(notebook, sys.argv[2])
"""


def outputs(path):
    """What the cells print and show, as text; pictures and warnings, whose bytes may differ, as their kind."""
    shown = []
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        for output in cell.get("outputs", ()):
            if output["output_type"] == "execute_result":
                shown.append(("shows", sorted(output["data"]), "".join(output["data"]["text/plain"])))
            elif output.get("name") == "stdout":
                shown.append(("prints", [], "".join(output["text"])))
    return shown


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_shows_what_it_says(path, tmp_path):
    again = tmp_path / path.name
    subprocess.run([sys.executable, "-c", EXECUTE, str(path), str(again)], check=True, cwd=tmp_path, timeout=600)
    stored, now = outputs(path), outputs(again)
    assert [kinds for _, kinds, _ in now] == [kinds for _, kinds, _ in stored]
    assert [text for _, _, text in now] == [text for _, _, text in stored]
    assert any("image/png" in kinds for _, kinds, _ in now)


def test_there_is_a_lesson():
    assert "python" in {path.stem for path in NOTEBOOKS}
