"""Verbs of plugins: `sppm_commands`."""

from __future__ import annotations

import sys
import types

import pytest

from sppm_pipeline.engine.cli.commands import built_in_commands
from sppm_pipeline.engine.cli.main import main
from sppm_pipeline.errors import DesignError
from sppm_pipeline.hookspecs import Command, hookimpl


class Distribution:
    name = "sppm-show"
    version = "1.2.3"


def configure(parser):
    parser.add_argument("what")
    parser.add_argument("--twice", action="store_true")


def execute(args):
    print(args.what * (2 if args.twice else 1))
    return 0


@pytest.fixture
def install(monkeypatch):
    """Pretend that a distribution supplies these verbs."""

    def pretend(commands, name="show"):
        module = types.ModuleType("show_plugin")

        @hookimpl
        def sppm_commands():
            return commands

        module.sppm_commands = sppm_commands

        class Entry:
            def __init__(self):
                self.name, self.dist = name, Distribution()

            def load(self):
                return module

        monkeypatch.setattr("sppm_pipeline.engine.plan.installed.entry_points", lambda group: [Entry()])

    return pretend


def test_a_verb_of_a_plugin_has_arguments_and_help(install, capsys):
    install({"show": Command("show a thing", configure, execute)})
    assert main(["show", "cell", "--twice"]) == 0
    assert capsys.readouterr().out == "cellcell\n"
    assert main(["show"]) == 2
    assert "usage: sppm show" in capsys.readouterr().err
    assert main(["show", "--help"]) == 0
    assert "Show a thing." in capsys.readouterr().out


def test_its_functions_may_be_named_by_their_place(install, capsys, monkeypatch):
    module = types.ModuleType("lazy_show")
    module.configure, module.execute = configure, execute
    monkeypatch.setitem(sys.modules, "lazy_show", module)
    install({"show": Command("show a thing", "lazy_show:configure", "lazy_show:execute")})
    assert main(["show", "cell"]) == 0
    assert capsys.readouterr().out == "cell\n"


def test_help_loads_no_plugin_unless_it_is_to_list_all(install, capsys):
    install({"show": Command("show a thing", configure, execute)})
    assert main(["--help"]) == 0
    assert "show a thing" not in capsys.readouterr().out
    assert main(["help", "--all"]) == 0
    assert "  show       show a thing  [sppm-show 1.2.3 (plugin 'show')]\n" in capsys.readouterr().out


def test_plugins_check_lists_verbs(install, capsys):
    install({"show": Command("show a thing", configure, execute)})
    assert main(["plugins", "--check"]) == 0
    assert "  commands: show\n" in capsys.readouterr().out


def test_a_near_miss_of_a_plugin_verb_is_noticed(install, capsys):
    install({"show": Command("show a thing", configure, execute)})
    assert main(["shwo"]) == 2
    assert "did you mean 'show" in capsys.readouterr().err
    assert main(["show", "--no-plugins"]) == 2


@pytest.mark.parametrize("verb", built_in_commands())
def test_no_plugin_takes_a_built_in_verb(install, capsys, verb):
    install({verb: Command("something else", configure, execute)})
    assert main(["show", "x"]) == 4
    err = capsys.readouterr().err
    assert f"the verb {verb!r} comes from sppm itself and from sppm-show 1.2.3 (plugin 'show')" in err


@pytest.mark.parametrize(
    ("command", "code", "words"),
    [
        (Command("x", configure, lambda args: 1 / 0), 4, "the verb 'show' raised ZeroDivisionError"),
        (Command("x", configure, lambda args: None), 4, "must return an exit code, got nothing"),
        (Command("x", configure, "not_there:execute"), 4, "can't be imported: ModuleNotFoundError"),
        (Command("x", "no colon", execute), 4, "must be given as 'module:name'"),
        (Command("x", lambda parser: parser.nope(), execute), 4, "the verb 'show' raised AttributeError"),
        ("a string", 4, "sppm_commands must name a Command, which 'show' is not"),
    ],
)
def test_what_goes_wrong_names_the_plugin(install, capsys, command, code, words):
    install({"show": command})
    assert main(["show", "x"]) == code
    err = capsys.readouterr().err
    assert words in err
    assert "sppm-show 1.2.3" in err


def test_errors_for_the_user_pass_as_they_are(install, capsys):
    def refuse(args):
        raise DesignError("too dense")

    install({"show": Command("x", configure, refuse)})
    assert main(["show", "x"]) == 3
    assert capsys.readouterr().err == "sppm: too dense\n"


def test_editors_find_the_schema_of_a_new_pipeline(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["new", "pipeline", "first"]) == 0
    first = (tmp_path / "first.yaml").read_text().splitlines()[0]
    key, _, place = first.partition("$schema=")
    assert key == "# yaml-language-server: "
    capsys.readouterr()
    assert main(["schema"]) == 0
    assert (tmp_path / place).read_text() == capsys.readouterr().out
    (tmp_path / place).write_text("{}")
    assert main(["new", "pipeline", "second"]) == 0
    assert (tmp_path / place).read_text() == "{}"  # nothing is overwritten but on request
    assert main(["schema", "-o", place]) == 0
    assert "sample.dart_throwing" in (tmp_path / place).read_text()
    assert f"$schema={place}" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("verb", "there"), [("init", "sppm new"), ("list", "stages"), ("slice", "stages slice"), ("mesh", "stages extract")]
)
def test_verbs_of_other_programs_are_answered(verb, there, capsys):
    assert main([verb]) == 2
    assert there in capsys.readouterr().err
