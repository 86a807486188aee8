"""Entries of the cache that several processes write: what is kept stays kept, wherever one of them is killed."""

from __future__ import annotations

import os

import numpy as np
import pytest

import sppm_pipeline as sppm
from sppm_pipeline.engine.cache import store as module
from sppm_pipeline.engine.cache.store import Store

KEY = "0" * 64
VALUE = sppm.Voxels.from_array(np.ones((4, 4, 4), bool))


def put(store, tmp_path, *, value, files):
    (tmp_path / "made.txt").write_text("made")
    outputs = [("made.txt", tmp_path / "made.txt")] if files else []
    store.put(KEY, {"facts": {}, "seconds": 1.0}, value=VALUE if value else None, outputs=outputs)


def whole(store, tmp_path):
    """What of the entry can be had."""
    entry = store.find(KEY)
    assert entry is not None
    if entry.has_value:
        assert store.load(entry).digest() == VALUE.digest()
    if entry.has_outputs:
        store.restore(entry, lambda name: tmp_path / f"again-{name}")
        assert (tmp_path / "again-made.txt").read_text() == "made"
    return entry.has_value, entry.has_outputs


@pytest.mark.parametrize(
    ("first", "second", "then"),
    [
        ((True, False), (False, True), (True, True)),
        ((False, True), (True, False), (True, True)),
        ((False, False), (True, True), (True, True)),
        ((True, True), (False, False), (True, True)),
        ((True, False), (True, True), (True, True)),
    ],
)
def test_an_entry_gets_what_it_lacks_and_is_whole_all_the_time(tmp_path, monkeypatch, first, second, then):
    one, other = Store(tmp_path / "cache"), Store(tmp_path / "cache")
    put(one, tmp_path, value=first[0], files=first[1])
    steps = []

    def watched(name):
        real = getattr(os, name)

        def call(*paths):
            try:
                real(*paths)
            finally:
                # a process that was killed here would leave this
                found = whole(one, tmp_path)
                assert all(now >= before for now, before in zip(found, first, strict=True))
                steps.append(name)

        return call

    for name in ("rename", "replace"):
        monkeypatch.setattr(module.os, name, watched(name))
    put(other, tmp_path, value=second[0], files=second[1])
    assert steps
    monkeypatch.undo()
    assert whole(one, tmp_path) == then
    for store in (one, other):
        store.close()
    assert list((tmp_path / "cache" / "tmp").iterdir()) == []
