"""Scripts of ``sppm completion`` complete in the shells that are here."""

import shutil
import subprocess

import pytest

from sppm_pipeline.engine.cli.commands import VERBS
from sppm_pipeline.engine.cli.main import main

LINES = {
    "sppm ch": {"check"},
    "sppm stages simulate.": {"simulate.part"},
    "sppm run x -s simulate.part.crit": set(),
    "sppm run x -s connect.mbdst.mo": {
        "connect.mbdst.mode=exact",
        "connect.mbdst.mode=greedy",
        "connect.mbdst.mode=lp_fix",
    },
    "sppm run x --until y --aud": {"--audit"},
    "sppm run quicks": {"quickstart"},
    "sppm printers elegoo_saturn_3_": {"elegoo_saturn_3_ultra"},
    "sppm run x --set slice.field.printer=elegoo_saturn_3_": {"slice.field.printer=elegoo_saturn_3_ultra"},
}
"""Line -> all words that complete it."""

BASH = """
compopt() { :; }
while IFS= read -r line; do
    COMP_LINE=$line COMP_POINT=${#line} COMP_WORDBREAKS=; COMPREPLY=(); _sppm; echo "${COMPREPLY[@]}"
done
"""
ZSH = """
compdef() { :; }; _files() { :; }
compadd() { local -a given; given=(${@[${@[(i)--]}+1,-1]}); reply+=(${(M)given:#${words[CURRENT]}*}); }
"""
ZSH_LOOP = """
while IFS= read -r line; do words=(${=line}); CURRENT=${#words}; reply=(); _sppm; print -r -- $reply; done
"""


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_words_complete(shell, tmp_path, capsys):
    if shutil.which(shell) is None:
        pytest.skip(f"{shell} is not installed")
    assert main(["completion", shell, "--no-plugins"]) == 0
    (tmp_path / "script").write_text(capsys.readouterr().out)
    read = f"source {tmp_path / 'script'}\n"
    program = {
        "bash": read + BASH,
        "zsh": ZSH + read + ZSH_LOOP,
        "fish": read + "while read line; echo (complete -C $line | string replace -r '\\t.*' ''); end",
    }[shell]
    done = subprocess.run(
        [shell, "-c", program], input="\n".join(LINES) + "\n", capture_output=True, text=True, cwd=tmp_path, timeout=60
    )
    assert done.stderr == ""
    assert [set(line.split()) for line in done.stdout.splitlines()] == list(LINES.values())


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_every_verb_is_named(shell, capsys):
    assert main(["completion", shell]) == 0
    script = capsys.readouterr().out
    assert all(verb in script for verb in (*VERBS, "report", "studio"))


def test_bash_replaces_what_follows_the_equals_sign(tmp_path, capsys):
    assert main(["completion", "bash", "--no-plugins"]) == 0
    (tmp_path / "script").write_text(capsys.readouterr().out)
    line = "sppm run x -s connect.mbdst.mode=ex"
    program = (
        f"source {tmp_path / 'script'}\ncompopt() {{ :; }}\nCOMP_LINE='{line}' COMP_POINT={len(line)}\n"
        'COMP_WORDBREAKS="="; _sppm; echo "${COMPREPLY[@]}"'
    )
    assert subprocess.run(["bash", "-c", program], capture_output=True, text=True).stdout.split() == ["exact"]
