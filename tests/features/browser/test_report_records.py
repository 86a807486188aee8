"""Reports hold no folder of the disk of their author."""

import json

import pytest

from sppm_pipeline.engine.strict_json import json_text, sealed
from sppm_pipeline.features.browser.report.build import report_html
from sppm_pipeline.features.browser.report.records import read_record, without_folders


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("/home/jane/part.stl", "…/part.stl"),
        ("/home/jane doe/my part.stl", "…/my part.stl"),
        (r"C:\Users\jane\part.stl", "…/part.stl"),
        (r"\\server\share\jane\part.stl", "…/part.stl"),
        ("can't read '/home/jane doe/my part.stl': no such file", "can't read '…/my part.stl': no such file"),
        ("part.stl in /home/jane/files, and /tmp/x/y.png", "part.stl in …/files, and …/y.png"),
        ("/home/jane/a.yaml:3:5: no such stage", "…/a.yaml:3:5: no such stage"),
        ("meshes/part.stl", "meshes/part.stl"),
        ("../part.stl", "../part.stl"),
        ("density in g/cm3 and 1/2 of it, and/or more", "density in g/cm3 and 1/2 of it, and/or more"),
        ("https://example.org/a/b", "https://example.org/a/b"),
    ],
)
def test_absolute_paths_are_cut_to_their_last_name(text, shown):
    assert without_folders({"path": [text]}) == {"path": [shown]}


def test_a_report_holds_no_folder_of_its_author(copied):
    record = json.loads((copied / "run.json").read_bytes())
    assert not record["config"]["folder"].startswith("/")
    record["config"]["folder"] = "/home/jane doe/work"  # as records of former versions have it
    record["stages"][0]["options"]["path"] = "/home/jane doe/scan.nrrd"
    record["warnings"] = ["'/home/jane doe/scan.nrrd' is coarse"]
    record["status"] = "failed"
    record["error"] = {
        "kind": "input", "message": "can't read /home/jane/b.stl", "hint": None, "stage": None, "exit_code": 3,
        "where": "/home/jane/a.yaml:1:1",
    }  # fmt: skip
    (copied / "run.json").write_text(json_text(sealed(record)), encoding="utf-8")
    html = report_html(copied, read_record(copied))
    assert "jane" not in html
    assert str(copied.parent) not in html
    assert record["config"]["folder"] not in html
    assert "…/scan.nrrd" in html
