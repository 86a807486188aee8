"""Installed distributions and entry points, read from their folders as `importlib.metadata` reads them."""

import importlib.metadata
import os
import posixpath
import sys
from importlib.machinery import PathFinder

import pytest

from sppm_pipeline.engine.cache import identity
from sppm_pipeline.engine.plan import installed


def as_rows(entries):
    return sorted((e.name, e.value, e.dist.name, e.dist.version) for e in entries)


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder with distributions, before all others on the path."""
    monkeypatch.syspath_prepend(str(tmp_path))

    def put(folder, entries=None, metadata=None):
        (tmp_path / folder).mkdir()
        if entries is not None:
            (tmp_path / folder / "entry_points.txt").write_text(entries)
        if metadata is not None:
            (tmp_path / folder / "METADATA").write_text(metadata)

    return put


@pytest.mark.parametrize("group", ["sppm", "console_scripts", "pytest11", "no.such.group"])
def test_they_are_those_that_the_standard_library_finds(group):
    assert as_rows(installed.entry_points(group)) == as_rows(importlib.metadata.entry_points(group=group))


def test_every_way_of_writing_them(place):
    place(
        "my_thing-1.0.dist-info",
        "[other]\na = b\n\n[sppm]\n# a comment\n# none = none\n"
        "one = os\ntwo=posixpath:join\nthree = os : path.sep [extra]\n[x]\nc=d",
        "Metadata-Version: 2.1\nName: My.Thing\nVersion: 1.0.post1\n\nName: not this\n",
    )
    found = {e.name: e for e in installed.entry_points("sppm") if e.dist.name == "My.Thing"}
    assert list(found) == ["one", "two", "three"]
    assert [e.load() for e in found.values()] == [os, posixpath.join, os.path.sep]
    assert found["one"].dist.version == "1.0.post1"
    mine = [row for row in as_rows(importlib.metadata.entry_points(group="sppm")) if row[2] == "My.Thing"]
    assert mine == as_rows(found.values())


def test_an_empty_place_on_the_path_is_the_working_folder(place, tmp_path, monkeypatch):
    place("here-1.0.dist-info")
    monkeypatch.setattr(sys, "path", ["" if path == str(tmp_path) else path for path in sys.path])
    assert "here" not in installed.distributions()
    monkeypatch.chdir(tmp_path)
    assert installed.distributions()["here"].version == "1.0"


def test_names_are_compared_and_read_however_they_are_written(place, tmp_path):
    assert installed.normal("A.-b__c") == "a-b-c"
    place("cafe-1.0.dist-info")
    (tmp_path / "cafe-1.0.dist-info/METADATA").write_bytes(b"Name: caf\xe9\nVersion: 1.0\n")
    assert "Version: 1.0" in installed.metadata_of(installed.distributions()["cafe"])


@pytest.mark.parametrize("value", ["no target at all", "", "a:b:c"])
def test_what_is_no_target_is_an_import_error(place, value):
    entry = installed.EntryPoint("x", value, installed.Distribution("d", "1", ""))
    with pytest.raises(ImportError, match="neither `module` nor"):
        entry.load()


def test_the_first_on_the_path_counts(place):
    place("numpy-0.0.1.dist-info", "[sppm]\nfirst = os\n", "Name: numpy\nVersion: 0.0.1\n")
    assert installed.distributions()["numpy"].version == "0.0.1"
    assert ("first", "os", "numpy", "0.0.1") in as_rows(installed.entry_points("sppm"))


def test_what_lies_elsewhere_is_asked_of_the_standard_library(monkeypatch):
    class Finder:
        @staticmethod
        def find_spec(*args):
            return None

        @staticmethod
        def find_distributions(context=None):
            return ()

    asked = []
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: asked.append(group) or [])
    usual = [finder for finder in sys.meta_path if finder is PathFinder or not hasattr(finder, "find_distributions")]
    monkeypatch.setattr(sys, "meta_path", usual)  # without finders of libraries that other tests have imported
    installed.entry_points("sppm")
    assert asked == []
    monkeypatch.setattr(sys, "meta_path", [*sys.meta_path, Finder])
    assert installed.entry_points("sppm") == []
    assert asked == ["sppm"]


@pytest.mark.parametrize(
    ("folder", "name", "version"),
    [
        ("thing.egg-info", "thing", ""),
        ("my-thing.dist-info", "my", "thing"),
        ("thing-1.0-py3.12.egg-info", "thing", "1.0"),
        ("thing-1.0-py3.12-linux-x86_64.egg-info", "thing", "1.0"),
        ("my-thing-1.0.dist-info", "my-thing", "1.0"),
    ],
)
def test_names_of_folders(folder, name, version):
    match = installed._FOLDER.fullmatch(folder)
    assert (match[1], match[2] or "") == (name, version)


REQUIRES = """numpy>=2
Other_Thing

[:python_version < '3']
old.one

[fast]
quick

[dev]
pytest

[test:python_version > '1']
tox
"""


def test_an_egg_has_its_version_and_its_requirements_elsewhere(place, tmp_path, monkeypatch):
    monkeypatch.setattr(identity, "_installed", installed.distributions)
    place("My_egg.egg-info", "[sppm]\negg = os\n")
    about = "Metadata-Version: 2.1\nName: My-egg\nVersion: 2.5\n"
    (tmp_path / "My_egg.egg-info/PKG-INFO").write_text(about + "\nVersion: not this\n")
    (tmp_path / "My_egg.egg-info/requires.txt").write_text(REQUIRES)
    (tmp_path / "single-1.0-py3.12.egg-info").write_text(
        about + "Requires-Dist: numpy\nRequires-Dist: tox; extra == 'dev'\n"
    )
    assert identity.installed_version("my.egg") == "2.5"
    assert identity.requirements_of("my.egg") == ["numpy", "old-one", "other-thing", "quick"]
    assert identity.requirements_of("single") == ["numpy"]
    assert ("egg", "os", "My-egg", "2.5") in as_rows(installed.entry_points("sppm"))
    assert as_rows(installed.entry_points("sppm")) == as_rows(importlib.metadata.entry_points(group="sppm"))
