"""Which part of each row lies in a domain, so that nothing is evaluated outside of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.compiled import jit


def row_spans(mask: NDArray[np.uint8]) -> NDArray[np.int32]:
    """First sample of each row that is set and the one after the last; (0, 0) for an empty row.

    Parameters
    ----------
    mask : (nz, ny, nx) uint8

    Returns
    -------
    (nz, ny, 2) int32
    """
    spans = np.zeros((*mask.shape[:2], 2), np.int32)
    _spans(mask, spans)
    return spans


@jit
def _spans(mask: NDArray[np.uint8], spans: NDArray[np.int32]) -> None:
    nz, ny, nx = mask.shape
    for z in range(nz):
        for y in range(ny):
            first = 0
            while first < nx and mask[z, y, first] == 0:
                first += 1
            if first < nx:
                last = nx - 1
                while mask[z, y, last] == 0:
                    last -= 1
                spans[z, y, 0] = first
                spans[z, y, 1] = last + 1
