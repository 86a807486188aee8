"""For sppm_pipeline: my_purpose."""

from __future__ import annotations

from sppm_pipeline import hookimpl


@hookimpl
def sppm_stages() -> dict[str, str]:
    """Our stages, by the place of their class, which is imported only when it is used."""
    return {"my_family.my_word": "my_plugin.my_module:MyClass"}
