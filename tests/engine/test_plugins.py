"""Plugins: how they are found, and every way in which they fail."""

from __future__ import annotations

import os
import sys
import types

import pytest

from sppm_pipeline.engine.plan import installed
from sppm_pipeline.engine.plan.plugins import import_file, load_plugins
from sppm_pipeline.engine.plan.registry import Registry
from sppm_pipeline.errors import ConfigError, PluginError
from sppm_pipeline.hookspecs import hookimpl
from tests import synthetic

BUILTINS = ("tests.synthetic", "sppm_pipeline.engine.run.executors")

ONE_FILE = '''
from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline.stage import Context, Stage, option
from tests.synthetic import Number


@dataclass(frozen=True, kw_only=True)
class Seven(Stage):
    """Seven, or some of it."""

    name: ClassVar[str] = "read.seven"
    share: float = option(1.0, help="how much of it", minimum=0)

    def run(self, context: Context) -> Number:
        return Number(7 * self.share)
'''


def write(work, text, name="mine.py"):
    return work.write(text, name)


class Distribution:
    name = "sppm-foreign"
    version = "1.2.3"


def pretend_installed(monkeypatch, *modules):
    """Entry points as installed distributions have them: (name, module or exception)."""

    class Entry:
        def __init__(self, name, target):
            self.name, self.target, self.dist = name, target, Distribution()

        def load(self):
            if isinstance(self.target, Exception):
                raise self.target
            return self.target

    entries = [Entry(name, target) for name, target in modules]
    monkeypatch.setattr(installed, "entry_points", lambda group: entries if group == "sppm" else [])


def module_with(**names):
    module = types.ModuleType("foreign")
    vars(module).update(names)
    return module


def stages_of(mapping):
    @hookimpl
    def sppm_stages():
        return mapping

    return module_with(sppm_stages=sppm_stages)


def test_a_file_needs_no_hook(work):
    path = write(work, ONE_FILE)
    plan = work.plan("pipeline: [{stage: read.seven, share: 0.5}]\n", plugins=[path])
    assert plan.steps[0].stage.share == 0.5
    assert str(plan.steps[0].owner) == f"the plugin {path}"


def test_a_configuration_can_name_its_plugins(work):
    write(work, ONE_FILE)
    text = "plugins: [mine.py]\npipeline: [read.seven]\n"
    assert work.run(text, distributions=True)["stages"][0]["summary"] == {"value": 7.0}


def test_a_file_can_have_hooks(work):
    hook = (
        "\nfrom sppm_pipeline.hookspecs import hookimpl\n\n@hookimpl\ndef sppm_stages():\n"
        "    return {'read.seven': Seven}\n"
    )
    plugins = load_plugins(BUILTINS, files=[write(work, ONE_FILE + hook)], distributions=False)
    plugins.raise_broken()
    assert list(plugins.plugins[-1].stages) == ["read.seven"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x = 1\nraise ValueError('no')\n", ":2 can't be loaded: ValueError: no"),
        ("x = (\n", ":1 can't be loaded: SyntaxError"),
        ("import no_such_module_anywhere\n", "the module 'no_such_module_anywhere' is not installed"),
    ],
)
def test_a_file_that_was_named_and_fails_stops_the_run(work, text, words):
    with pytest.raises(PluginError) as caught:
        work.plan("pipeline: [read.varied]\n", plugins=[write(work, text)])
    assert words in str(caught.value)


def test_a_file_that_is_not_there(work):
    with pytest.raises(PluginError, match="no plugin file"):
        work.plan("pipeline: [read.varied]\n", plugins=[work.folder / "none.py"])


def test_a_distribution_that_fails_to_import_is_listed_and_breaks_nothing(work, monkeypatch):
    pretend_installed(monkeypatch, ("bad", ImportError("libGL.so.1")), ("good", stages_of({"read.eight": "x:Y"})))
    session = work.session("pipeline: [read.varied]\n", distributions=True)
    (failed,) = session.plugins.failed()
    assert "sppm-foreign 1.2.3 (plugin 'bad') can't be loaded: ImportError: libGL.so.1" in str(failed.error)
    assert "read.eight" in session.registry
    session.plan()


def test_an_unknown_stage_hints_at_plugins_that_failed(work, monkeypatch):
    pretend_installed(monkeypatch, ("bad", ImportError("libGL.so.1")))
    with pytest.raises(PluginError) as caught:
        work.plan("pipeline: [scan.laser]\n", distributions=True)
    assert "sppm-foreign 1.2.3 (plugin 'bad') could not be loaded and may supply it" in str(caught.value)
    # a slip of the pen is no fault of the plugin
    assert "did you mean" in str(work.error("pipeline: [read.varyed]\n", distributions=True))


def test_without_plugins_nothing_is_looked_for(work, monkeypatch):
    pretend_installed(monkeypatch, ("bad", ImportError("libGL.so.1")))
    write(work, "raise ValueError", "mine.py")
    work.plan("plugins: [mine.py]\npipeline: [read.varied]\n", distributions=False)
    assert "--no-plugins" in str(work.error("pipeline: [scan.laser]\n", distributions=False))


def test_a_misspelt_hook_is_an_error_that_names_it(work, monkeypatch):
    @hookimpl
    def sppm_stage():
        return {}

    pretend_installed(monkeypatch, ("misspelt", module_with(sppm_stage=sppm_stage)))
    with pytest.raises(PluginError) as caught:
        work.plan("pipeline: [read.varied]\n", distributions=True)
    assert "unknown hook 'sppm_stage'" in str(caught.value)
    assert "did you mean 'sppm_stages'" in str(caught.value)


def test_a_hook_with_unknown_arguments_is_an_error(work, monkeypatch):
    @hookimpl
    def sppm_stages(color):
        return {}

    pretend_installed(monkeypatch, ("odd", module_with(sppm_stages=sppm_stages)))
    with pytest.raises(PluginError, match="odd"):
        work.plan("pipeline: [read.varied]\n", distributions=True)


@pytest.mark.parametrize("supplied", [None, ["read.x"], {1: "x:Y"}])
def test_a_hook_that_returns_nonsense_is_an_error(work, monkeypatch, supplied):
    pretend_installed(monkeypatch, ("odd", stages_of(supplied)))
    with pytest.raises(PluginError, match="must return a map of names"):
        work.plan("pipeline: [read.varied]\n", distributions=True)


def test_a_hook_that_raises_is_an_error(work, monkeypatch):
    @hookimpl
    def sppm_stages():
        raise KeyError("x")

    pretend_installed(monkeypatch, ("odd", module_with(sppm_stages=sppm_stages)))
    with pytest.raises(PluginError, match="sppm_stages raised KeyError"):
        work.plan("pipeline: [read.varied]\n", distributions=True)


def test_two_plugins_with_one_stage_are_an_error_that_names_both(work, monkeypatch):
    pretend_installed(monkeypatch, ("foreign", stages_of({"read.number": "x:Y"})))
    with pytest.raises(PluginError) as caught:
        work.plan("pipeline: [read.varied]\n", distributions=True)
    assert "'read.number' comes from sppm itself and from sppm-foreign 1.2.3" in str(caught.value)


class Abstract(synthetic.Stage):
    """Does not implement run."""

    name = "read.x"


class Undecorated(synthetic.ReadWhole):
    """Is no dataclass of its own."""

    name = "read.x"


@pytest.mark.parametrize(
    ("target", "words"),
    [
        ("no_such_module_anywhere:X", "'no_such_module_anywhere' is not installed"),
        ("tests.synthetic:Nothing", "can't be imported"),
        ("tests.synthetic", "'module:name'"),
        (synthetic.ReadNumber, "has the name 'read.number'"),
        (dict, "no subclass of Stage"),
        (Abstract, "does not implement run"),
        (Undecorated, "must be decorated"),
    ],
)
def test_stages_that_break_the_contract(work, monkeypatch, target, words):
    pretend_installed(monkeypatch, ("foreign", stages_of({"read.x": target})))
    with pytest.raises(PluginError) as caught:
        work.plan("pipeline: [read.x]\n", distributions=True)
    assert words in str(caught.value)
    assert "sppm-foreign 1.2.3" in str(caught.value)


def test_a_broken_stage_disturbs_only_those_who_use_it(work, monkeypatch):
    pretend_installed(monkeypatch, ("foreign", stages_of({"read.x": "no_such_module_anywhere:X"})))
    work.plan("pipeline: [read.varied]\n", distributions=True)


def test_modules_are_imported_only_when_used(work, monkeypatch):
    path = work.folder / "late_module_of_a_plugin.py"
    path.write_text(ONE_FILE)
    monkeypatch.syspath_prepend(work.folder)
    pretend_installed(monkeypatch, ("late", stages_of({"read.seven": "late_module_of_a_plugin:Seven"})))
    session = work.session("pipeline: [read.seven]\n", distributions=True)
    assert "late_module_of_a_plugin" not in sys.modules
    session.plan()
    assert sys.modules.pop("late_module_of_a_plugin").Seven.name == "read.seven"


def test_stages_are_listed_by_family_in_the_order_of_work():
    names = list(Registry(load_plugins(BUILTINS, distributions=False)))
    assert names.index("read.whole") < names.index("sample.random") < names.index("tune.repeat")
    assert names.index("tune.repeat") < names.index("write.number")


def test_an_unknown_stage_is_a_configuration_error():
    with pytest.raises(ConfigError):
        Registry(load_plugins(BUILTINS, distributions=False)).get("x.y")


FAILING_FILE = ONE_FILE.replace("return Number(7 * self.share)", "raise RuntimeError('broken')")


def test_what_a_plugin_raises_is_its_fault(work):
    path = write(work, FAILING_FILE)
    with pytest.raises(PluginError) as caught:
        work.run("pipeline: [read.seven]\n", plugins=[path])
    assert f"the plugin {path}: raised RuntimeError: broken" in str(caught.value)
    assert caught.value.exit_code == 4
    assert caught.value.stage == "read.seven"
    assert isinstance(caught.value.__cause__, RuntimeError)


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ("def run", "def rnu", "Seven in .*mine.py is no stage yet: it lacks the method `run`"),
        ("    name: ClassVar", "    nmae: ClassVar", "Seven in .*mine.py is no stage yet: it lacks `name: ClassVar"),
    ],
)
def test_what_a_class_of_a_file_lacks_to_be_a_stage_is_said(work, before, after, words):
    assert before in ONE_FILE
    with pytest.raises(PluginError, match=words):
        work.plan("pipeline: [read.seven]\n", plugins=[write(work, ONE_FILE.replace(before, after))])


def test_what_a_stage_of_a_file_is_built_upon_lacks_nothing(work):
    base = "\nclass Base(Stage):\n    pass\n\n@dataclass(frozen=True, kw_only=True)\nclass Seven"
    text = ONE_FILE.replace("(Stage)", "(Base)").replace("\n@dataclass(frozen=True, kw_only=True)\nclass Seven", base)
    with pytest.raises(ConfigError, match="there is no stage") as caught:
        work.plan("pipeline: [qqqq.zzzz]\n", plugins=[write(work, text)])
    assert "Base" not in str(caught.value)


def test_a_name_is_looked_up_in_files_as_they_were_loaded(work):
    path = write(work, ONE_FILE)
    registry = Registry(load_plugins(BUILTINS, files=[path], distributions=False))
    write(work, "def broken(:")
    with pytest.raises(ConfigError, match="there is no stage"):
        registry.get("qqqq.zzzz")


def test_a_file_that_is_changed_twice_within_a_second_is_read_again(tmp_path, monkeypatch):
    """Python takes bytecode that it kept for that of a file with the same second and size."""
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    path = tmp_path / "mine.py"
    for number in (1, 2):
        path.write_text(f"NUMBER = {number}\n", encoding="utf-8")
        os.utime(path, (0, 0))
        assert number == import_file(path).NUMBER
    assert list(tmp_path.iterdir()) == [path]
