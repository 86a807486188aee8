"""Stacks of pictures: TIFF files of many pages and folders of PNG or TIFF files, one picture a layer.

As in `write.png`, the first row of a picture is the side of largest y, the first column that of smallest x, and the
first picture is the lowest layer.
"""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import InputError
from sppm_pipeline.formats.voxel_image import VoxelImage, checked_shape

if TYPE_CHECKING:
    from PIL.Image import Image

ENDINGS = (".png", ".tif", ".tiff")

MOST_LAYERS = 1 << 16


def decode_pages(data: bytes, name: str) -> VoxelImage:
    """Read a TIFF file of one or many pages.

    Raises
    ------
    InputError
        If it is no TIFF file, is cut, in color, or its pages differ in size.
    """
    with _opened(io.BytesIO(data), name) as image:
        try:
            count = int(getattr(image, "n_frames", 1))
        except Exception as error:  # Pillow raises whatever a damaged page makes it stumble over
            raise InputError(f"the pages of {name} can't be counted: {_short(error)}") from error
        if count > MOST_LAYERS:
            raise InputError(f"{name} has {count} pages; the limit is {MOST_LAYERS}")
        return _stacked(_pages(image, count, name), count, name)


def read_folder(folder: Path) -> VoxelImage:
    """Read all pictures of a folder, in order of the numbers in their names.

    Raises
    ------
    InputError
        If there are none, they have different endings or sizes, or one is no picture in gray.
    """
    files = [path for path in folder.iterdir() if path.suffix.lower() in ENDINGS and path.is_file()]
    endings = sorted({path.suffix.lower() for path in files})
    if len(endings) != 1:
        raise InputError(
            f"{folder} holds {'files ending in ' + ' and '.join(endings) if files else 'no pictures'}",
            hint=f"a stack is a folder of files of one kind: {', '.join(ENDINGS)}",
        )
    if len(files) > MOST_LAYERS:
        raise InputError(f"{folder} has {len(files)} pictures; the limit is {MOST_LAYERS}")
    files.sort(key=lambda path: ([int(word) for word in re.findall(r"\d+", path.name)][-1:], path.name))

    def layers() -> Iterator[NDArray[Any]]:
        for path in files:
            with _opened(path, path.name) as image:
                yield from _pages(image, 1, path.name)

    return _stacked(layers(), len(files), str(folder))


def encode_tiff(values: NDArray[Any]) -> bytes:
    """A TIFF file with one page a layer, losslessly compressed, (nx, ny, nz) bool, uint8 or float32."""
    from PIL import Image

    if values.dtype == bool:
        values = values.astype(np.uint8) * np.uint8(255)
    # picture rows run along x, from the largest y down
    pages = [Image.fromarray(np.ascontiguousarray(values[:, ::-1, k].T)) for k in range(values.shape[2])]
    stream = io.BytesIO()
    pages[0].save(stream, "TIFF", save_all=True, append_images=pages[1:], compression="tiff_adobe_deflate")
    return stream.getvalue()


def _opened(source: Path | io.BytesIO, name: str) -> Image:
    from PIL import Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            return Image.open(source, formats=("PNG", "TIFF"))
    except Exception as error:
        raise InputError(f"{name} is no picture that can be read: {_short(error)}") from error


def _pages(image: Image, count: int, name: str) -> Iterator[NDArray[Any]]:
    for page in range(count):
        try:
            if count > 1:
                image.seek(page)
            if image.mode not in ("1", "L", "I;16", "I;16B", "I", "F"):
                raise InputError(
                    f"page {page} of {name} has the mode {image.mode}; a voxel image is black and white or gray"
                )
            yield np.asarray(image)
        except InputError:
            raise
        except Exception as error:
            raise InputError(f"page {page} of {name} can't be read: {_short(error)}") from error


def _stacked(pages: Iterable[NDArray[Any]], count: int, name: str) -> VoxelImage:
    values: NDArray[Any] | None = None
    for k, page in enumerate(pages):
        if values is None:
            ny, nx = page.shape
            dtype = page.dtype.newbyteorder("=")
            values = np.empty(checked_shape((nx, ny, count), dtype.itemsize, name), dtype, order="F")
        if page.shape != values.shape[1::-1]:
            raise InputError(
                f"layer {k} of {name} has {page.shape[1]} x {page.shape[0]} pixels, the first one "
                f"{values.shape[0]} x {values.shape[1]}"
            )
        values[:, :, k] = page[::-1].T
    if values is None:
        raise InputError(f"{name} holds no layers")
    return VoxelImage(values, None)


def _short(error: Exception) -> str:
    return (str(error).splitlines() or [""])[0][:120] or type(error).__name__
