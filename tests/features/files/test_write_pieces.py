"""Output files that are written piece by piece."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest

from sppm_pipeline.method.families.file_writer import write_pieces


class Slow:
    """A file that takes a few bytes at a time, as one does on a disk that is nearly full."""

    def __init__(self):
        self.taken = b""

    def open(self, mode, buffering):
        return self

    def __enter__(self):
        return self

    def __exit__(self, *error): ...

    def write(self, data):
        self.taken += bytes(data)[:13]
        return min(13, memoryview(data).nbytes)


class Told:
    def __init__(self, threads):
        self.threads, self.file, self.told = threads, Slow(), None

    def output(self, path):
        return self.file

    def hashed(self, path, digest):
        self.told = digest


@pytest.mark.parametrize("threads", [1, 2])
def test_what_a_write_takes_is_counted_in_bytes(threads):
    pieces = [b"head", memoryview(np.arange(9.0)), memoryview(np.zeros((0, 3))), memoryview(np.eye(3, dtype=np.int32))]
    context = Told(threads)
    whole = b"".join(map(bytes, pieces))
    assert write_pieces(context, "file", pieces) == len(whole)
    assert context.file.taken == whole
    assert hashlib.sha256(whole).hexdigest() in str(context.told)
