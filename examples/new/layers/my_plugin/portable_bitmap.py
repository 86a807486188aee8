"""``write.my_word``: layers as portable bitmaps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import ConfigError, Context, LayerWriter, SliceStack, options


@dataclass(frozen=True, kw_only=True)
class WriteBitmaps(LayerWriter):
    """Write each layer as a portable bitmap (PBM, P4), in which a set bit is solid, into a folder with a manifest."""

    name: ClassVar[str] = "write.my_word"
    suffix: ClassVar[str] = ".pbm"

    path: str = options.write_path("layers", suffixes=("/",))

    def run(self, context: Context, stack: SliceStack) -> None:
        """What can't be written is refused before the first layer is computed."""
        if stack.gray:
            raise ConfigError("a bitmap holds no gray", hint="slice with `gray: 1`")
        super().run(context, stack)

    def encode(self, image: NDArray[np.uint8], stack: SliceStack) -> bytes:
        """One layer; several threads do this at the same time."""
        height, width = image.shape
        return f"P4\n{width} {height}\n".encode() + np.packbits(image > 0, axis=1).tobytes()

    def encoding(self, stack: SliceStack) -> dict[str, Any]:
        """Entries of the manifest."""
        return {"bits": 1}
