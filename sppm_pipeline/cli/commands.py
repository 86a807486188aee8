"""The built-in verbs through the hook `sppm_commands`, so that no plugin can take one of their names."""

from __future__ import annotations

from sppm_pipeline.cli.main import VERBS, place_of
from sppm_pipeline.hookspecs import Command, hookimpl


@hookimpl
def sppm_commands() -> dict[str, Command]:
    """All built-in verbs, by the places of their functions."""
    return {verb: Command(words, *(":".join(place) for place in place_of(verb))) for verb, words in VERBS.items()}
