"""For sppm_pipeline: my_purpose."""

from __future__ import annotations

from sppm_pipeline import hookimpl

SPPM_API_VERSION = 1  # a program where `sppm_pipeline.API` is another number refuses this plugin


@hookimpl
def sppm_stages() -> dict[str, str]:
    """Our stages, by the place of their class, which is imported only when it is used."""
    return {"my_family.my_word": "my_plugin.my_module:MyClass"}
