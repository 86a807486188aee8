"""Zarr stores, which xarray, dask and napari open piece by piece: a folder of blocks that are compressed apart.

The format: https://zarr-specs.readthedocs.io/en/latest/v3/core/index.html, version 3. What is written here are its
metadata, and blocks in little-endian order through gzip, which every reader has.
"""

from __future__ import annotations

import gzip
import itertools
import json
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

BLOCK = 64
"""Voxels along an edge of a block; blocks at the upper sides are filled up with zeros, as the format wants."""


def encode(
    values: NDArray[Any],
    spacing: tuple[float, float, float],
    unit: str | None,
    name: str,
    attributes: Mapping[str, Any],
) -> Iterator[tuple[str, bytes]]:
    """Files of a store and what they hold: an array (nx, ny, nz) of uint8 or float32, and the centers of its voxels.

    `spacing` is the edges of a voxel in `unit`, which may be None; `attributes` are those of the array.
    """
    about = {**attributes, "spacing": list(spacing), "spacing_unit": unit or "1"}
    arrays: dict[str, tuple[NDArray[Any], tuple[str, ...], dict[str, Any]]] = {name: (values, ("x", "y", "z"), about)}
    for axis, n, edge in zip("xyz", values.shape, spacing, strict=True):
        arrays[axis] = (edge * (np.arange(n) + 0.5), (axis,), {"units": unit or "1", "long_name": "centers of voxels"})
    known = {key: _metadata(*array) for key, array in arrays.items()}
    # so that a reader need not look for the arrays, one file after the other
    consolidated = {"kind": "inline", "must_understand": False, "metadata": known}
    group = {"zarr_format": 3, "node_type": "group", "attributes": {}, "consolidated_metadata": consolidated}
    yield "zarr.json", _text(group)
    for key, (data, _, _) in arrays.items():
        yield f"{key}/zarr.json", _text(known[key])
        for place in itertools.product(*(range(-(-n // BLOCK)) for n in data.shape)):
            part = data[tuple(slice(BLOCK * i, BLOCK * (i + 1)) for i in place)]
            block = np.zeros((BLOCK,) * data.ndim, data.dtype.newbyteorder("<"))
            block[tuple(map(slice, part.shape))] = part
            yield f"{key}/c/{'/'.join(map(str, place))}", gzip.compress(block.tobytes(), 1, mtime=0)


def _metadata(data: NDArray[Any], axes: tuple[str, ...], attributes: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "zarr_format": 3,
        "node_type": "array",
        "shape": list(data.shape),
        "data_type": data.dtype.name,
        "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": [BLOCK] * data.ndim}},
        "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
        "fill_value": 0,
        "codecs": [
            {"name": "bytes", "configuration": {"endian": "little"}},
            {"name": "gzip", "configuration": {"level": 1}},
        ],
        "dimension_names": list(axes),
        "attributes": dict(attributes),
    }


def _text(metadata: Mapping[str, Any]) -> bytes:
    return f"{json.dumps(metadata, indent=1)}\n".encode()
