"""Bytes of files that stages read and write.

A public sub-face of `sppm_pipeline`: names here stay, and are loaded when they are first used.
"""

from __future__ import annotations

from sppm_pipeline import lazily

TYPE_CHECKING = False  # as type checkers understand it
if TYPE_CHECKING:  # the same names as in `_PLACES`, which a test compares
    from sppm_pipeline.method.families.file_writer import extension_of as extension_of
    from sppm_pipeline.services.formats.input_file import content_of as content_of
    from sppm_pipeline.services.formats.vtu import encode_hexahedra as encode_hexahedra

_PLACES = {
    "method.families.file_writer": "extension_of",
    "services.formats.input_file": "content_of",
    "services.formats.vtu": "encode_hexahedra",
}
"""Modules below `sppm_pipeline`, and what is taken from each: ``name``, or ``public name=name there``."""

__all__, __getattr__, __dir__ = lazily(__name__, _PLACES)
