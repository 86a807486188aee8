"""``write.sheet``: the pictures of all runs of a sweep on one sheet."""

from __future__ import annotations

import hashlib
import io
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from sppm_pipeline import ConfigError, Context, InputError, Stage, Table, option, options
from sppm_pipeline.nouns.table import RunFile
from sppm_pipeline.services.arrays import U8

MAX_PICTURES = 400
"""Pictures on a sheet."""


@dataclass(frozen=True, kw_only=True)
class WriteSheet(Stage):
    """Place a picture that each run of a sweep wrote on one sheet, with a column of the table beneath it.

    Runs that did not write it are left out, with a warning.
    """

    name: ClassVar[str] = "write.sheet"
    advice: ClassVar[str] = "lower `width`"

    path: str = options.write_path("sheet.png", suffixes=(".png",))
    picture: str = option("picture.png", help="name of the picture in the folder of each run", run_file=True)
    label: str = options.label("run", note="its values stand beneath the pictures")
    per_row: int | None = option(
        None, help="pictures in a row; about as many as rows if omitted", minimum=1, maximum=100, formerly="columns"
    )
    width: int = option(
        300, help="wider pictures are scaled down to this width", unit="pixels", minimum=16, maximum=2048
    )
    title: str = options.title("", note="above the sheet")

    def run(self, context: Context, table: Table) -> None:
        """Collect the pictures."""
        from PIL import Image

        from sppm_pipeline.services.pictures.sheets import contact_sheet

        if self.picture not in table.files:
            known = ", ".join(sorted(table.files)) or "no files"
            raise ConfigError(f"no run wrote a picture {self.picture!r}", hint=f"the runs wrote {known}")
        files = table.files[self.picture]
        labels = table.texts(self.label)
        there = [(file, label) for file, label in zip(files, labels, strict=True) if file is not None]
        if len(there) > MAX_PICTURES:
            raise ConfigError(f"{len(there)} pictures are too many for a sheet; at most {MAX_PICTURES} fit")
        if len(there) < len(files):
            missing = [label for file, label in zip(files, labels, strict=True) if file is None]
            context.warn(f"{len(missing)} runs wrote no {self.picture!r}: {', '.join(missing[:10])}")
        pictures = [self._read(file) for file, _ in there]
        context.report(pictures=len(pictures))
        sheet = contact_sheet(pictures, [label for _, label in there], columns=self.per_row, title=self.title)
        Image.fromarray(sheet).save(context.output(self.path))

    def _read(self, file: RunFile) -> U8:
        from PIL import Image, UnidentifiedImageError

        try:
            data = Path(file.path).read_bytes()
        except OSError as error:
            raise InputError(f"cannot read {file.path}: {error.strerror}") from error
        # the sheet must show what the recorded runs made
        if hashlib.sha256(data).hexdigest() != file.sha256:
            raise InputError(f"{file.path} was changed since its run wrote it", hint="run the sweep again")
        try:
            with Image.open(io.BytesIO(data)) as opened:
                image = opened.convert("RGB")
        except (UnidentifiedImageError, OSError, ValueError) as error:
            raise InputError(f"{file.path} is no picture: {error}") from error
        if image.width > self.width:
            height = max(1, round(image.height * self.width / image.width))
            image = image.resize((self.width, height), Image.Resampling.BOX)
        return np.asarray(image, np.uint8)
