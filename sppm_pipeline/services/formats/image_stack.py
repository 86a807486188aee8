"""Stacks of pictures: TIFF files of many pages (by tifffile) and folders of PNG or TIFF files, one picture a layer.

As in `write.png`, the first row of a picture is the side of largest y, the first column that of smallest x, and the
first picture is the lowest layer.
"""

from __future__ import annotations

import io
import math
import re
import warnings
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import InputError
from sppm_pipeline.services.formats.input_file import content_of, library, third_party_reader
from sppm_pipeline.services.formats.voxel_image import LARGEST_IMAGE, VoxelImage, checked_shape

ENDINGS = (".png", ".tif", ".tiff")

MAX_LAYERS = 1 << 16

_DESCRIPTION, _X_RESOLUTION, _Y_RESOLUTION, _UNIT, _CENTIMETER = 270, 282, 283, 296, 3  # tags of TIFF
_MM = {
    "nm": 1e-6, "nanometer": 1e-6, "um": 1e-3, "micron": 1e-3, "microns": 1e-3, "micrometer": 1e-3, "mm": 1.0,
    "millimeter": 1.0, "cm": 10.0, "centimeter": 10.0, "m": 1e3, "meter": 1e3, "in": 25.4, "inch": 25.4,
}  # fmt: skip
"""Millimeters of the units that ImageJ writes; any other, such as "pixel", is none of length."""
_RESOLUTION_UNITS = {2: 25.4, _CENTIMETER: 10.0}
_ROUNDED = 1e-4
"""Edges whose relative difference is no larger are equal: files round pixels per unit."""

_DEFLATED = (8, 32946)  # compression schemes of TIFF
_HIGHEST_RATIO, _ALWAYS_ALLOWED = 1032, 2**26
"""Bytes that deflate can make of one byte, and bytes that a strip may unpack to without a closer look."""


def decode_tiff(data: bytes, name: str) -> VoxelImage:
    """Read a TIFF file of one or many pages, and the size of its voxels in mm where it states all three edges."""
    tifffile = library("tifffile", "images")
    hint = "is it cut off, in color, or compressed in a way that needs `pip install imagecodecs`?"
    with third_party_reader("tifffile", name, hint), tifffile.TiffFile(io.BytesIO(data)) as file:
        # a file written page by page is one of several series
        kinds = {(series.shape[-2:], series.dtype, series.keyframe.photometric) for series in file.series}
        if len(kinds) != 1:
            raise InputError(f"{name} has pages of {len(kinds)} kinds; a voxel image has pages of one size and type")
        for series in file.series:
            _require_gray(series, name)
        ((height, width), dtype, photometric) = kinds.pop()
        layers = sum(math.prod(series.shape[:-2]) for series in file.series)
        if layers > MAX_LAYERS:
            raise InputError(f"{name} has {layers} pages; the limit is {MAX_LAYERS}")
        checked_shape((width, height, layers), dtype.itemsize, name)
        for series in file.series:
            for page in series.pages:
                _require_bounded(page, data, name)
        pages = np.concatenate([series.asarray().reshape(-1, height, width) for series in file.series])
        spacing = _spacing(file)
    if photometric == 0:  # white is zero
        pages = ~pages if pages.dtype.kind in "bu" else -pages
    return _stacked(pages, layers, name, spacing)


def _spacing(file: Any) -> tuple[float, float, float] | None:
    """Edges of a voxel, mm, of a file that states all three: the resolution of pages, and the distance of layers.

    TIFF has no tag for that distance, so ImageJ's is needed; the resolution alone is often one for a printer or a
    screen that some program has put in.
    """
    about, tags = file.imagej_metadata or {}, file.pages[0].tags
    unit = str(about.get("unit", "")).replace("\\u00B5", "u").replace("\u00b5", "u").replace("\u03bc", "u")
    code = tags[_UNIT].value if _UNIT in tags else 0
    mm = _MM.get(unit.lower()) if unit else _RESOLUTION_UNITS.get(code)
    if mm is None:
        return None
    try:
        (nx, dx), (ny, dy) = tags[_X_RESOLUTION].value, tags[_Y_RESOLUTION].value
        x, y, z = (float(edge) * mm for edge in (dx / nx, dy / ny, about["spacing"]))
    except (KeyError, TypeError, ValueError, ZeroDivisionError):
        return None
    if not all(0 < edge < math.inf for edge in (x, y, z)):
        return None
    return (z, z, z) if max(x, y, z) <= (1 + _ROUNDED) * min(x, y, z) else (x, y, z)


def _require_gray(series: Any, name: str) -> None:
    """Refuse what is no stack of gray pages: color, or more axes than three."""
    photometric, axes = series.keyframe.photometric, series.axes
    longer = [axis for length, axis in zip(series.shape[:-2], axes, strict=False) if length > 1]
    if axes[-2:] != "YX" or len(longer) > 1 or photometric not in (0, 1):
        raise InputError(
            f"{name} has the axes {axes} of lengths {series.shape} and the color type "
            f"{getattr(photometric, 'name', photometric)}; a voxel image is a stack of black and white or gray pages"
        )


def _require_bounded(page: Any, data: bytes, name: str) -> None:
    """Refuse a strip that is deflated and unpacks to more than it stands for, before tifffile unpacks it."""
    if page is None or page.compression not in _DEFLATED:
        return
    room = math.prod(page.chunks) * page.dtype.itemsize
    for start, count in zip(page.dataoffsets, page.databytecounts, strict=True):
        if count * _HIGHEST_RATIO > _ALWAYS_ALLOWED + room:
            strip = zlib.decompressobj().decompress(data[start : start + count], room + 1)
            if len(strip) > room:
                raise InputError(
                    f"{name}: a strip of {count} bytes unpacks to more than the {room} bytes of its pixels"
                )


def read_folder(folder: Path) -> VoxelImage:
    """Read all pictures of a folder, in gray and of one size, in order of the numbers in their names."""
    files = [path for path in folder.iterdir() if path.suffix.lower() in ENDINGS and path.is_file()]
    endings = sorted({path.suffix.lower() for path in files})
    if len(endings) != 1:
        raise InputError(
            f"{folder} holds {'files ending in ' + ' and '.join(endings) if files else 'no pictures'}",
            hint=f"a stack is a folder of files of one kind: {', '.join(ENDINGS)}",
        )
    if len(files) > MAX_LAYERS:
        raise InputError(f"{folder} has {len(files)} pictures; the limit is {MAX_LAYERS}")
    files.sort(key=lambda path: ([int(word) for word in re.findall(r"\d+", path.name)][-1:], path.name))

    if endings != [".png"]:
        return _stacked(map(_tiff_page, files), len(files), str(folder))
    return _stacked(map(_picture, files), len(files), str(folder))


def encode_tiff(values: NDArray[Any], spacing: tuple[float, float, float] | None = None) -> bytes:
    """A TIFF file of values (nx, ny, nz) of bool, uint8 or float32, with one page a layer, losslessly compressed.

    Edges of a voxel are in mm. Resolutions are per centimeter, a unit of TIFF; the distance of layers, for which TIFF
    has no tag, stands in a description as ImageJ writes it, in the same unit.
    """
    from PIL import Image

    if values.dtype == bool:
        values = values.astype(np.uint8) * np.uint8(255)
    # picture rows run along x, from the largest y down
    pages = [Image.fromarray(np.ascontiguousarray(values[:, ::-1, k].T)) for k in range(values.shape[2])]
    stream = io.BytesIO()
    tags: dict[int, Any] = {}
    if spacing is not None:
        count = len(pages)
        about = f"ImageJ=1.54\nimages={count}\nslices={count}\nunit=cm\nspacing={spacing[2] / 10!r}\n"
        tags = {_DESCRIPTION: about, _X_RESOLUTION: 10 / spacing[0], _Y_RESOLUTION: 10 / spacing[1], _UNIT: _CENTIMETER}
    for page in pages:
        page.encoderinfo = {"tiffinfo": tags, "compression": "tiff_adobe_deflate"}
    pages[0].save(
        stream, "TIFF", save_all=True, append_images=pages[1:], compression="tiff_adobe_deflate", tiffinfo=tags
    )
    return stream.getvalue()


def _tiff_page(path: Path) -> NDArray[Any]:
    """The pixels of a TIFF file of one page."""
    values = decode_tiff(content_of(path, LARGEST_IMAGE), path.name).values
    if values.shape[2] != 1:
        raise InputError(f"{path.name} has {values.shape[2]} pages; in a folder, each file is one layer")
    return values[:, ::-1, 0].T


def _picture(path: Path) -> NDArray[Any]:
    """The pixels of a PNG file."""
    from PIL import Image

    with third_party_reader("PIL", path.name):
        warnings.simplefilter("error", Image.DecompressionBombWarning)
        with Image.open(path, formats=("PNG",)) as image:
            if image.mode not in ("1", "L", "I;16", "I;16B", "I", "F"):
                raise InputError(f"{path.name} has the mode {image.mode}; a voxel image is black and white or gray")
            return np.asarray(image)


def _stacked(
    pages: Iterable[NDArray[Any]], count: int, name: str, spacing: tuple[float, float, float] | None = None
) -> VoxelImage:
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
    return VoxelImage(values, spacing)
