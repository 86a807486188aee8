"""``sppm completion``: completion of verbs, options, stages and their values for a shell, as a script of plain words.

The script holds all words that there are when it is written, so that a shell that completes starts no Python.
"""

from __future__ import annotations

import importlib
from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING, NamedTuple

from sppm_pipeline.engine.cli.arguments import add_plugins, plugins_from

if TYPE_CHECKING:
    from sppm_pipeline.engine.plan.registry import Registry

_NAMING_STAGES = ("explain", "stages")


class _Verb(NamedTuple):
    """What may follow a verb."""

    help: str
    options: dict[str, str]  # name with dashes -> help
    words: list[str]


def configure_completion(parser: ArgumentParser) -> None:
    """Arguments of the verb."""
    parser.add_argument("shell", choices=("bash", "zsh", "fish"), help="shell that the script is for")
    add_plugins(parser)


def execute_completion(args: Namespace) -> int:
    """Print the script."""
    from sppm_pipeline.engine.plan.registry import Registry

    registry = Registry(plugins_from(args))
    verbs = _verbs(registry)
    settings = _settings(registry, verbs)
    print(_fish(verbs, settings) if args.shell == "fish" else _script(args.shell, verbs, settings), end="")
    return 0


def _settings(registry: Registry, verbs: dict[str, _Verb]) -> list[str]:
    """``STAGE.OPTION=`` of all options, with each word that an option allows.

    What the verb `printers` lists is what an option `printer` takes; so for any other verb and option.
    """
    from sppm_pipeline.engine.config.options import options_of
    from sppm_pipeline.errors import PluginError

    found = []
    for name in registry:
        try:
            options = options_of(registry.get(name)).values()
        except PluginError:  # `sppm plugins --check` says why; the others are completed
            continue
        for option in options:
            words = [*option.spec.choices, *(("true", "false") if option.kind is bool else ())]
            words = words or (verbs[f"{option.name}s"].words if f"{option.name}s" in verbs else [""])
            found += [f"{name}.{option.name}={word}" for word in words]
    return sorted(found)


def _verbs(registry: Registry) -> dict[str, _Verb]:
    """All verbs, those of plugins as well, with what their parsers declare."""
    from sppm_pipeline.engine.cli.arguments import commands_of_plugins
    from sppm_pipeline.engine.cli.commands import built_in_commands
    from sppm_pipeline.engine.plan.session import packaged_configurations

    commands = built_in_commands() | {verb: command for verb, (_, command) in commands_of_plugins()[0].items()}
    found = {}
    for verb, command in sorted(commands.items()):
        configure = command.configure
        if isinstance(configure, str):
            module, _, function = configure.partition(":")
            configure = getattr(importlib.import_module(module), function)
        parser = ArgumentParser(prog=verb)
        configure(parser)
        options: dict[str, str] = {}
        words: list[str] = []
        for action in parser._actions:
            options |= dict.fromkeys(action.option_strings, (action.help or "").replace("\n", " "))
            if not action.option_strings:
                words += [str(word) for word in action.choices or vars(action).get("completions", ())]
                words += sorted(packaged_configurations()) if action.metavar == "FILE" else []
        words += sorted(registry) if verb in _NAMING_STAGES else []
        found[verb] = _Verb(command.help, options, words)
    return found


_BASH = """\
_sppm() {{
    local line=${{COMP_LINE:0:COMP_POINT}} cur last before words
    cur=${{line##* }}
    read -ra before <<< "${{line%"$cur"}}"
    last=${{before[-1]}}
    if [[ $last == -s || $last == --set ]]; then
        words=$_sppm_settings
    else
        case "${{before[1]-}}" in
        "") words="{verbs}" ;;
{cases}
        esac
    fi
    COMPREPLY=($(compgen -W "$words" -- "$cur"))
    if [[ $cur == *=* && $COMP_WORDBREAKS == *=* ]]; then  # bash replaces only what follows the last "="
        COMPREPLY=("${{COMPREPLY[@]#"${{cur%=*}}="}}")
    elif [[ ${{#before[@]}} -gt 1 && $last != -s && $last != --set && $cur != -* ]]; then
        compopt -o filenames
        COMPREPLY+=($(compgen -f -- "$cur"))
    fi
    [[ ${{#COMPREPLY[@]}} -gt 1 || ${{COMPREPLY[0]-}} == *= ]] && compopt -o nospace
}}
_sppm_settings="{settings}"
complete -F _sppm sppm
"""

_ZSH = """\
#compdef sppm
_sppm() {{
    local last=${{words[CURRENT-1]}}
    if (( CURRENT == 2 )); then
        compadd -- {verbs}
    elif [[ $last == -s || $last == --set ]]; then
        compadd -S "" -- ${{=_sppm_settings}}
    else
        local -a found
        case "${{words[2]}}" in
{cases}
        esac
        [[ ${{words[CURRENT]}} == -* ]] && compadd -- ${{(M)found:#-*}} || {{ compadd -- ${{found:#-*}}; _files; }}
    fi
}}
_sppm_settings="{settings}"
if [[ ${{funcstack[1]-}} == _sppm ]]; then _sppm "$@"; else compdef _sppm sppm; fi
"""


def _script(shell: str, verbs: dict[str, _Verb], settings: list[str]) -> str:
    """The script for bash or zsh."""
    words = {verb: " ".join([*after.words, *after.options]) for verb, after in verbs.items()}
    template, case = (_BASH, '        {}) words="{}" ;;') if shell == "bash" else (_ZSH, "        {}) found=({}) ;;")
    cases = "\n".join(case.format(verb, after) for verb, after in words.items())
    return template.format(verbs=" ".join(verbs), cases=cases, settings=" ".join(settings))


def _fish(verbs: dict[str, _Verb], settings: list[str]) -> str:
    """The script for fish, which shows a sentence beside each word."""
    lines = [f"set -g _sppm_settings {' '.join(settings)}"]
    for verb, after in verbs.items():
        lines.append(f"complete -c sppm -n __fish_use_subcommand -f -a {verb} -d {_quoted(after.help)}")
        begun = f"complete -c sppm -n '__fish_seen_subcommand_from {verb}'"
        for option, help in after.options.items():
            kind = f"-l {option[2:]}" if option.startswith("--") else f"-s {option[1:]}"
            values = " -x -a '$_sppm_settings'" if option in ("-s", "--set") else ""
            lines.append(f"{begun} {kind}{values} -d {_quoted(help)}")
        if after.words:
            lines.append(f"{begun} -a {_quoted(' '.join(after.words))}")
    return "\n".join(lines) + "\n"


def _quoted(words: str) -> str:
    escaped = words.replace("\\", "\\\\").replace("'", "\\'").replace("%%", "%")
    return f"'{escaped}'"
